"""Time of one prediction, mean and variance of three outputs, by every predictor on the same trained set.

    python tests/benchmarks/bench_prediction.py [POINTS]

One run, one thread, one process; times are processor time, the least of several repeats. `single` asks one query a
call, as a controller does; `batch` asks 256. Rival: scikit-learn's GaussianProcessRegressor, three of them with
the same hyperparameters, where it is installed. What is compared are ratios; machines differ.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from split_cli.learning.training_set import TrainingSet  # noqa: E402
from split_cli.prediction import make_predictor  # noqa: E402
from tests.factories import make_training_set, valid_features  # noqa: E402

BATCH = 256
SINGLES = 100
REPEATS = 5
Predict = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def scikit_learn(trained: TrainingSet) -> Predict | None:
    """Return scikit-learn's exact process with the set's hyperparameters, one a state."""
    try:
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import RBF, ConstantKernel
    except ImportError:
        return None
    models = []
    for output in range(3):
        kernel = ConstantKernel(trained.kernel.signal_variance[output]) * RBF(trained.kernel.length_scales)
        model = GaussianProcessRegressor(kernel, alpha=trained.kernel.noise_variance[output], optimizer=None)
        models.append(model.fit(trained.z, trained.y[:, output]))

    def predict(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        mean, deviation = zip(*(model.predict(z, return_std=True) for model in models), strict=True)
        return np.stack(mean, axis=1), np.square(np.stack(deviation, axis=1))

    return predict


def ours(name: str, trained: TrainingSet, context: np.ndarray | None = None) -> Predict:
    """Return one of the project's predictors; with a context it is situated anew for every call."""
    predictor = make_predictor(name, trained)

    def predict(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = (predictor if context is None else predictor.at(context)).predict(z)
        return found.mean, found.variance

    return predict


def situated(trained: TrainingSet, context: np.ndarray) -> Predict:
    """Return FITC in a situation prepared before: what further queries of one horizon cost."""
    predictor = make_predictor("fitc", trained).at(context)

    def predict(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = predictor.predict(z)
        return found.mean, found.variance

    return predict


def seconds_a_query(predict: Predict, queries: np.ndarray, size: int) -> float:
    """Return the least processor time a query over repeats, asked `size` at a time [s]."""
    parts = [queries[first : first + size] for first in range(0, len(queries), size)]
    predict(parts[0])
    times = []
    for _ in range(REPEATS):
        begin = time.process_time()
        for part in parts:
            predict(part)
        times.append((time.process_time() - begin) / len(queries))
    return min(times)


def main() -> None:
    """Print the table."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    points = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    trained = make_training_set(points=points)
    queries = valid_features(trained.vehicle, trained.region, BATCH, seed=9)
    # Ten states of a horizon: a smooth path through the middle of the region.
    path = np.linspace(-0.4, 0.4, 10)[:, None] * [trained.region.alpha_max, trained.region.alpha_max, 1.0]
    rivals: dict[str, Predict | None] = {
        "bcm (numba)": ours("bcm", trained),
        "full (NumPy)": ours("full", trained),
        "fitc, once situated": situated(trained, path),
        "fitc, situation and query": ours("fitc", trained, path),
        "scikit-learn GPR": scikit_learn(trained),
    }
    exact_mean, exact_variance = rivals["full (NumPy)"](queries)
    scale = np.sqrt(trained.kernel.signal_variance)
    print(f"{trained.size} points in {trained.cell_count} cells, length scales of two cells, three outputs\n")
    print("| predictor | single, us | over bcm | batch, us | over bcm | mean from exact | variance from exact |")
    print("|---|---|---|---|---|---|---|")
    base: tuple[float, float] | None = None
    for name, predict in rivals.items():
        if predict is None:
            print(f"| {name} | not installed | | | | | |")
            continue
        single = seconds_a_query(predict, queries[:SINGLES], 1)
        batch = seconds_a_query(predict, queries, BATCH)
        base = base or (single, batch)
        mean, variance = predict(queries)
        off = np.abs((mean - exact_mean) / scale).max()
        off_variance = np.abs((variance - exact_variance) / scale**2).max()
        print(
            f"| {name} | {1e6 * single:.1f} | {single / base[0]:.2f} | {1e6 * batch:.2f} | {batch / base[1]:.2f} "
            f"| {off:.2g} | {off_variance:.2g} |"
        )
    print("\nDeviations are the largest over the batch, over the signal's deviation and variance.")
    print("Queries lie all over the valid region; fitc knows only the surroundings of its ten states.")


if __name__ == "__main__":
    main()
