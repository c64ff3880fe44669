"""The stream that all contestants of `bench_rivals` get, and how they are timed and scored."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from split_cli.learning.cells import learn
from split_cli.learning.features import Z2
from split_cli.learning.hyperparameters import fit_kernel
from split_cli.learning.in_memory import train_in_memory
from split_cli.learning.kernel import Kernel
from split_cli.learning.labels import compute_labels
from split_cli.learning.training_set import TrainingSet
from split_cli.logs.drive import read_drive
from split_cli.scoring.evaluation import HeldOutSamples
from split_cli.scoring.splits import hold_out_blocks
from split_cli.vehicle.parameters import Vehicle
from tests.factories import make_labels, make_training_set, smooth_residual, valid_features

NOISE = 0.1
#: Labels to which the others' hyperparameters are fitted: a likelihood costs their number cubed.
FITTED_LABELS = 600
QUERIES = 400
SLOW_QUERIES = 40


@dataclass(frozen=True)
class Timed:
    """What one contestant did at one size; times in microseconds, None where it has no such thing.

    `spread` is the range of a median over repeats, as a share of it, where that is largest.
    """

    name: str
    size: int
    points: int | None = None
    build_s: float | None = None
    update_p50: float | None = None
    update_p99: float | None = None
    query_p50: float | None = None
    query_p99: float | None = None
    jacobian_p50: float | None = None
    jacobian_p99: float | None = None
    rmse: float | None = None
    nlpd: float | None = None
    coverage_95: float | None = None
    from_full: float | None = None
    megabytes: float | None = None
    code_kb: float | None = None
    compile_s: float | None = None
    spread: float | None = None


@dataclass(frozen=True)
class RivalKernel:
    """Hyperparameters of the others, an output each: they need not share length scales."""

    length_scales: np.ndarray  # (3, D)
    signal_variance: np.ndarray  # (3,)
    noise_variance: np.ndarray  # (3,)

    @classmethod
    def of(cls, kernel: Kernel) -> "RivalKernel":
        """Return those of our kernel."""
        return cls(np.tile(kernel.length_scales, (3, 1)), kernel.signal_variance, kernel.noise_variance)

    @classmethod
    def fitted(cls, z: np.ndarray, y: np.ndarray, kernel: Kernel) -> "RivalKernel":
        """Return those that scikit-learn fits by maximum likelihood to labels, begun at our kernel."""
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

        some = np.linspace(0, len(z) - 1, min(len(z), FITTED_LABELS)).astype(int)
        found = []
        for output in range(3):
            start = ConstantKernel(kernel.signal_variance[output], (1e-8, 1e8))
            scales = RBF(kernel.length_scales, [(0.1 * s, 100.0 * s) for s in kernel.length_scales])
            noise = WhiteKernel(kernel.noise_variance[output], (1e-10, 1e6))
            model = GaussianProcessRegressor(start * scales + noise, random_state=0).fit(z[some], y[some, output])
            found.append(model.kernel_)
        return cls(
            np.stack([k.k1.k2.length_scale for k in found]),
            np.array([k.k1.k1.constant_value for k in found]),
            np.array([k.k2.noise_level for k in found]),
        )


@dataclass(frozen=True)
class Samples:
    """Samples in order and what is asked afterwards.

    Errors are divided by `scale`. `noise` is the variance of what is asked beyond the process: that of labels
    where no truth is known. Exact processes of others get the `points`.
    """

    z: np.ndarray
    y: np.ndarray
    queries: np.ndarray
    truth: np.ndarray
    trained: TrainingSet
    rivals: RivalKernel
    points: tuple[np.ndarray, np.ndarray]
    scale: np.ndarray
    noise: tuple[np.ndarray, np.ndarray]  # of our kernel and of the rivals'


def stream_of(size: int, length_scale: float, tuned: bool = False) -> Samples:
    """Return `size` samples, the set SPLIT keeps of them, and queries with the truth.

    Where they are `tuned`, ours and the others fit their own hyperparameters, and exact processes get all samples.
    """
    start = make_training_set(0, 50, length_scale_cells=length_scale, noise=NOISE)
    z = valid_features(start.vehicle, start.region, size, seed=size)
    rng = np.random.default_rng(size)
    truth = smooth_residual(z)
    y = truth + NOISE * rng.normal(size=truth.shape)
    kernel = type(start.kernel)(start.kernel.length_scales, np.mean(truth**2, axis=0), np.full(3, NOISE**2))
    # Room for all of them, as a set of that size has by its own settings.
    capacity = 10 if size <= 10_000 else 60
    if tuned:
        kernel = fit_kernel(z, y, start.grid, kernel).kernel
    trained = learn(
        [make_labels(z, y, start.vehicle)], vehicle=start.vehicle, grid=start.grid, kernel=kernel, capacity=capacity
    )
    queries = valid_features(start.vehicle, start.region, QUERIES, seed=7)
    rivals = RivalKernel.fitted(z, y, kernel) if tuned else RivalKernel.of(kernel)
    points, nothing = (z, y) if tuned else (trained.z, trained.y), np.zeros(3)
    scale = np.sqrt(np.mean(truth**2, axis=0))
    return Samples(z, y, queries, smooth_residual(queries), trained, rivals, points, scale, (nothing, nothing))


def recorded_stream(recording: Path, vehicle: Vehicle) -> Samples:
    """Return the labels of a drive's training blocks in order; asked are the labels of its held-out blocks.

    Ours has the kernel that `split train` fits, the others their own. Errors are relative to the nominal model's.
    """
    drive = read_drive(recording)
    labels, split = compute_labels(drive, vehicle, Z2), hold_out_blocks(drive)
    training = labels.within(split.train)
    trained = train_in_memory([training], vehicle)
    known = training.inside(trained.grid)
    known = known.take(known.accepted)
    tested = labels.take(HeldOutSamples(drive, split, labels, labels.z).tested)
    tested = tested.take(tested.accepted)
    rivals = RivalKernel.fitted(known.z, known.y, trained.kernel)
    scale = np.sqrt(np.mean(tested.y**2, axis=0))
    noise = (trained.kernel.noise_variance, rivals.noise_variance)
    return Samples(known.z, known.y, tested.z, tested.y, trained, rivals, (known.z, known.y), scale, noise)


def percentiles(times: list[float]) -> tuple[float, float]:
    """Return the 50th and 99th percentile in microseconds."""
    return float(np.percentile(times, 50) * 1e6), float(np.percentile(times, 99) * 1e6)


def spent(call: Callable[[], object]) -> float:
    """Return the processor time of one call [s]: what else the machine does while it waits is not counted."""
    begin = time.thread_time()
    call()
    return max(0.0, time.thread_time() - begin - _CLOCK)


def _clock_cost() -> float:
    """Return the median time between two readings of the clock with nothing between them [s]."""
    readings = [(time.thread_time(), time.thread_time()) for _ in range(2001)]
    return float(np.median([after - before for before, after in readings]))


_CLOCK = _clock_cost()


def each(call: Callable, items: list) -> tuple[float, float]:
    """Return percentiles of the time of a call over items."""
    call(items[0])
    return percentiles([spent(lambda at=item: call(at)) for item in items])


def accuracy(
    mean: np.ndarray, variance: np.ndarray, stream: Samples, full: np.ndarray | None, ours: bool = True
) -> dict:
    """Return error, density and coverage against the truth, and against the full GP."""
    count = len(mean)
    error = (mean - stream.truth[:count]) / stream.scale
    spread = (variance + stream.noise[0 if ours else 1]) / stream.scale**2
    found = {
        "rmse": float(np.sqrt(np.mean(error**2))),
        "nlpd": float(np.mean(0.5 * np.log(2.0 * np.pi * spread) + 0.5 * error**2 / spread)),
        "coverage_95": float(np.mean(error**2 <= 3.841 * spread)),
    }
    if full is not None:
        found["from_full"] = float(np.sqrt(np.mean(((mean - full[:count]) / stream.scale) ** 2)))
    return found
