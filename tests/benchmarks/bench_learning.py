"""Learning against the printed algorithm, and a million samples from drive to set.

Run ``python tests/benchmarks/bench_learning.py``. Both sides are compiled by numba and run on one core in one
process; times are processor time, so that neighbours on the machine count little.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numba import njit

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from split_cli.learning._compiled import _correlation, _refresh, update_cells  # noqa: E402
from split_cli.learning.cells import empty_set, extend, warm_up  # noqa: E402
from split_cli.learning.features import Z2  # noqa: E402
from split_cli.learning.hyperparameters import default_kernel, fit_kernel, scatter_variance  # noqa: E402
from split_cli.learning.labels import compute_labels, nominal_errors  # noqa: E402
from split_cli.learning.region import Region, z2_grid  # noqa: E402
from split_cli.learning.training_set import read_set, write_set  # noqa: E402
from split_cli.logs.drive import read_drive, write_drive  # noqa: E402
from split_cli.vehicle.single_track import SingleTrack  # noqa: E402
from tests.factories import MissingForce, make_drive, road_car, valid_features  # noqa: E402


@njit(cache=True)
def _invert(matrix, n, low, inverse):
    """Invert a symmetric positive matrix by Cholesky; the fastest plain loops for orders near ten."""
    for i in range(n):
        for j in range(i + 1):
            value = matrix[i, j]
            for k in range(j):
                value -= low[i, k] * low[j, k]
            low[i, j] = np.sqrt(value) if i == j else value / low[j, j]
    for j in range(n):
        for i in range(n):
            value = 1.0 if i == j else 0.0
            for k in range(i):
                value -= low[i, k] * inverse[k, j]
            inverse[i, j] = value / low[i, i]
        for i in range(n - 1, -1, -1):
            value = inverse[i, j]
            for k in range(i + 1, n):
                value -= low[k, i] * inverse[k, j]
            inverse[i, j] = value / low[i, i]


@njit(cache=True)
def printed_update(z, n, slot, inverse_scales, K, inverse, part, low, small, gamma):
    """Re-evaluate a cell after point `slot` changed: the inverse of K, and M inversions of order M - 1."""
    for i in range(n):
        K[i, slot] = _correlation(z[i], z[slot], inverse_scales)
        K[slot, i] = K[i, slot]
    _invert(K, n, low, inverse)
    for left in range(n):
        for i in range(n - 1):
            for j in range(n - 1):
                part[i, j] = K[i + (i >= left), j + (j >= left)]
        _invert(part, n - 1, low, small)
        value = 1.0
        for i in range(n - 1):
            for j in range(n - 1):
                value -= K[left, i + (i >= left)] * small[i, j] * K[left, j + (j >= left)]
        gamma[left] = value


@njit(cache=True)
def printed_updates(z, repeat, inverse_scales, gamma):
    """Re-evaluate full cells `repeat` times."""
    size = (z.shape[1], z.shape[1])
    K, inverse, part, low, small = np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size)
    for c in range(len(z)):
        for i in range(z.shape[1]):
            for j in range(z.shape[1]):
                K[i, j] = _correlation(z[c, i], z[c, j], inverse_scales)
        for _ in range(repeat):
            printed_update(z[c], z.shape[1], 0, inverse_scales, K, inverse, part, low, small, gamma[c])


@njit(cache=True)
def own_updates(z, repeat, inverse_scales, gamma):
    """The same by one factorisation from the points."""
    size = (z.shape[1], z.shape[1])
    low, inverse = np.zeros(size), np.zeros(size)
    for c in range(len(z)):
        for _ in range(repeat):
            _refresh(z[c], z.shape[1], 0, inverse_scales, low, inverse, gamma[c])


@njit(cache=True)
def printed_way(groups, cell_of_group, order, z_new, inverse_scales, threshold, count, z, gamma, kept):
    """Update cells as the SPLIT paper prints it: M inversions of order M - 1 an update; K and its inverse kept."""
    capacity = z.shape[1]
    size = (capacity, capacity)
    K, inverse, part, low, small = np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size)
    k = np.zeros(capacity)
    updates = 0
    for group in range(len(cell_of_group)):
        c = cell_of_group[group]
        for position in range(groups[group], groups[group + 1]):
            sample = order[position]
            n = count[c]
            gain = 1.0
            for i in range(n):
                k[i] = _correlation(z[c, i], z_new[sample], inverse_scales)
            for i in range(n):
                for j in range(n):
                    gain -= k[i] * inverse[i, j] * k[j]
            slot = n
            if n == capacity:
                slot = int(np.argmin(gamma[c]))
                if gain <= gamma[c, slot]:
                    continue
            elif gain <= threshold:
                continue
            else:
                count[c] = n + 1
            z[c, slot] = z_new[sample]
            kept[c, slot] = sample
            printed_update(z[c], count[c], slot, inverse_scales, K, inverse, part, low, small, gamma[c])
            updates += 1
    return updates


def grouped(grid, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return groups, cells and order of samples by cell."""
    numbers = grid.pack(grid.index(z)[0])
    order = np.argsort(numbers, kind="stable")
    first = np.unique(numbers[order], return_index=True)[1]
    return np.append(first, len(z)), np.arange(len(first)), order


def compare(name: str, grid, z: np.ndarray, capacity: int = 10, repeat: int = 5) -> list:
    """Run both ways over the same samples; return a row of the table."""
    groups, cells, order = grouped(grid, z)
    scales, clock = 1.0 / (2.0 * np.array(grid.edges)), np.zeros(len(z))
    shape = (len(cells), capacity)
    times = {"printed": np.inf, "ours": np.inf}
    for _ in range(repeat):
        points, gains, kept, count = (
            np.zeros((*shape, 3)),
            np.zeros(shape),
            np.full(shape, -1),
            np.zeros(len(cells), int),
        )
        begin = time.process_time()
        updates = printed_way(groups, cells, order, z, scales, 1e-3, count, points, gains, kept)
        times["printed"] = min(times["printed"], time.process_time() - begin)
        own, origin, number = (np.zeros((*shape, 5)), np.full(shape, -1), np.zeros(len(cells), int))
        sums, samples = np.zeros((*shape, capacity + 3)), np.concatenate([z, z[::-1]], axis=1)
        begin = time.process_time()
        update_cells(groups, cells, order, samples, clock, scales, 1e-3, 0.0, number, own, sums, origin)
        times["ours"] = min(times["ours"], time.process_time() - begin)
    assert np.array_equal(kept, origin), "the two ways kept different points"
    apart = np.abs(gains - own[:, :, 3]).max()
    row = [name, len(z), updates]
    for seconds in times.values():
        row += [f"{1e6 * seconds / len(z):.3f}", f"{updates / seconds:,.0f}"]
    return [*row, f"{times['printed'] / times['ours']:.1f}", f"{apart:.0e}"]


def full_cell_updates(capacity: int) -> list:
    """Time one accepted update of a full cell both ways; return a row of the table."""
    rng = np.random.default_rng(capacity)
    z = rng.uniform(0.0, 1.0, (200, capacity, 3))
    repeat, inverse_scales, seconds, gains = 50, np.full(3, 4.0), [], []
    for way in (printed_updates, own_updates):
        gamma = np.zeros(z.shape[:2])
        way(z[:1], 1, inverse_scales, gamma)
        begin = time.process_time()
        way(z, repeat, inverse_scales, gamma)
        seconds.append((time.process_time() - begin) / (len(z) * repeat))
        gains.append(gamma)
    times = [f"{1e6 * value:.2f}" for value in seconds]
    apart = np.abs(gains[0] - gains[1]).max()
    return [capacity, *times, f"{seconds[0] / seconds[1]:.1f}", f"{apart:.0e}"]


def print_rows(header: list, rows: list) -> None:
    texts = [[str(value) for value in row] for row in [header, *rows]]
    widths = [max(len(row[i]) for row in texts) for i in range(len(header))]
    for row in texts:
        print("  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True)))
    print()


def million(folder: Path) -> list:
    """Time a million samples from a drive on disk to a set on disk."""
    car = road_car()
    drive = make_drive(
        0, segments=500, seconds=20.0, period=0.01, vehicle=car, terms=[MissingForce({"front_grip_loss": 0.1})]
    )
    write_drive(drive, folder / "million.parquet")
    rows, marks = [], [time.process_time()]

    def mark(name: str, note: str = "") -> None:
        marks.append(time.process_time())
        rows.append([name, f"{marks[-1] - marks[-2]:.2f}", note])

    drive = read_drive(folder / "million.parquet")
    mark("read the drive", f"{len(drive):,} rows at 100 Hz")
    region = Region.of(car)
    labels = compute_labels(drive, car, Z2, region, stride=1)
    mark("label every row", f"{len(labels):,} labels over {labels.window} samples")
    grid = z2_grid(car, region)
    start = default_kernel(grid, labels.y[labels.accepted], scatter_variance(labels))
    kernel = fit_kernel(labels.z[labels.accepted], labels.y[labels.accepted], grid, start).kernel
    mark("fit hyperparameters")
    trained = extend(empty_set(car, Z2, region, grid, kernel, horizon=0.05), [labels])
    mark("learn", f"{trained.sources[0].insertions + trained.sources[0].replacements:,} updates")
    write_set(trained, folder / "million.split")
    mark("save", f"{trained.size:,} points in {trained.cell_count:,} cells")
    read_set(folder / "million.split")
    mark("load and check")
    total = marks[-2] - marks[0]
    rows.append(["total, read to save", f"{total:.2f}", f"{1e6 * total / len(labels):.2f} us a label"])
    starts = labels.row[labels.reason != 1][:20_000]
    begin = time.process_time()
    nominal_errors(SingleTrack(car), drive, starts, labels.window, compiled=False)
    plain = (time.process_time() - begin) / len(starts)
    begin = time.process_time()
    nominal_errors(SingleTrack(car), drive, starts, labels.window)
    compiled = (time.process_time() - begin) / len(starts)
    note = f"{1e6 * plain:.2f} against {1e6 * compiled:.2f} us a label, {plain / compiled:.1f} times"
    rows.append(["labels, plain NumPy against compiled", "", note])
    return rows


def main() -> None:
    """Print both tables."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    warm_up()
    car = road_car()
    region = Region.of(car)
    grid = z2_grid(car, region)
    rng = np.random.default_rng(0)
    everything_new = valid_features(car, region, 9000, seed=1, spread=0.6)
    crowded = rng.uniform(0.0, 1.0, (20_000, 3)) * [0.06, 0.06, 0.3]
    streaming = valid_features(car, region, 1_000_000, seed=2, spread=0.25)
    compare("warm-up", grid, crowded, repeat=1)
    print("One accepted update of a full cell, us\n")
    header = ["M", "printed", "ours", "ratio", "gains apart"]
    print_rows(header, [full_cell_updates(capacity) for capacity in (5, 10, 20, 40)])
    print("The update of cells, capacity 10, length scales of two cells, one core\n")
    print_rows(
        [
            "stream",
            "samples",
            "updates",
            "printed us/sample",
            "updates/s",
            "ours us/sample",
            "updates/s",
            "ratio",
            "gains apart",
        ],
        [
            compare("cells that fill", grid, everything_new),
            compare("27 full cells", grid, crowded),
            compare("a million samples", grid, streaming, repeat=2),
        ],
    )
    print("One million samples, one core\n")
    with tempfile.TemporaryDirectory() as folder:
        print_rows(["step", "cpu s", ""], million(Path(folder)))


if __name__ == "__main__":
    main()
