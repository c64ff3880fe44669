"""What a diagnosis evaluates most, each against the same done otherwise in one run.

One explanation while a fit moves one of its parameters, against the same anew. And the single track along a
recording by compiled loops, against NumPy's functions.

Run ``python -m tests.benchmarks.bench_diagnosis``. Times are the least of many in one process on one core, and
each row is a ratio of two of them, so that neighbours on the machine count little.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pickle
import time

import numpy as np

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.parallel import use_threads
from split_cli.vehicle.compiled_operations import COMPILED
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.operations import NUMPY
from split_cli.vehicle.single_track import SingleTrack
from tests.diagnosis.recordings import driven, noisy_objective
from tests.factories import road_car

_TURNS = 40
#: Term, parameter that moves, its step: a tyre beside sensors, an accelerometer, a sensor of velocity.
_MOVED = (("tire_stiffness", "front_scale", 1e-4), ("acceleration_bias", "ax", 1e-4), ("yaw_rate_bias", "r", 1e-6))
_BEGIN = {
    "tire_stiffness": {"front_scale": 0.9, "rear_scale": 1.1},
    "acceleration_bias": {"ax": 0.1, "ay": 0.1},
    "yaw_rate_bias": {"r": 0.002},
    "velocity_bias": {"angle": 0.004, "drift": 1e-4},
}


def explanation(term: str, parameter: str, by: float) -> list[Term]:
    """Return all terms, one of them with one parameter moved."""
    begin = {name: dict(values) for name, values in _BEGIN.items()}
    begin[term][parameter] += by
    return [CATALOGUE[name](values) for name, values in begin.items()]


def least_seconds(objective: MarginalLikelihood, moved: tuple[str, str, float], *, anew: bool) -> float:
    """Return the least time of an evaluation [s], each of other values; `anew` with nothing kept from before."""
    term, parameter, step = moved
    best = float("inf")
    for turn in range(_TURNS):
        terms = explanation(term, parameter, (turn + 1) * step)
        # What travels forgets; the flow without any term, which every search has, is made again.
        here = pickle.loads(pickle.dumps(objective)) if anew else objective
        if anew:
            here.raw_residual([])
        begun = time.perf_counter()
        here.raw_residual(terms)
        best = min(best, time.perf_counter() - begun)
    return best


def least_of_single_track(samples: int) -> dict[str, tuple[float, float]]:
    """Return the least times of forces and of their balance [s], by NumPy and compiled."""
    random = np.random.default_rng(0)
    vx = np.abs(random.normal(15.0, 4.0, samples)) + 1.0
    vy, r, delta = random.normal(0.0, [[0.3], [0.3], [0.05]], (3, samples))
    torque = random.normal(0.0, 500.0, samples)
    model, least = SingleTrack(road_car(), ()), {}
    for name in ("forces", "balance"):
        times = []
        for ops in (NUMPY, COMPILED):
            flow, best = model.flow(vx, vy, r, torque, delta, ops=ops), float("inf")
            for _ in range(_TURNS):
                begun = time.perf_counter()
                if name == "balance":
                    model.balance(flow)
                else:
                    model.flow(vx, vy, r, torque, delta, ops=ops)
                best = min(best, time.perf_counter() - begun)
            times.append(best)
        least[name] = times[0], times[1]
    return least


def main() -> None:
    """Print a row a parameter that moves."""
    use_threads(1)
    objective = noisy_objective(driven(41, []), 3)
    print("| moved | anew [ms] | beside what is kept [ms] | ratio |\n|---|---|---|---|")
    for moved in _MOVED:
        anew, kept = (1e3 * least_seconds(objective, moved, anew=one) for one in (True, False))
        print(f"| `{moved[0]}` | {anew:.2f} | {kept:.2f} | {kept / anew:.2f} |")
    print("\n| along 18,000 samples | NumPy [ms] | compiled [ms] | ratio |\n|---|---|---|---|")
    for name, (plain, compiled) in least_of_single_track(18_000).items():
        print(f"| {name} | {1e3 * plain:.2f} | {1e3 * compiled:.2f} | {compiled / plain:.2f} |")


if __name__ == "__main__":
    main()
