"""What a race's kernel makes of lap 0, with white errors and with errors that last over several labels.

Example: ``python -m tests.studies.lasting lap0.parquet --vehicle sample_logs/road_car.yaml``, the drive written by
``split race --learner none --laps 0 -o lap0.parquet``. For z2, and for z2 with slip angles and torque behind a lag
of 80 ms, it prints length scales in cells, deviations of signal and noise, what of the noise lasts and how long,
and the errors of labels in five held-out blocks of time, asked of a dense process.
"""

import argparse

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from split_cli.learning.features import parse_features
from split_cli.learning.hyperparameters import default_kernel, fit_kernel, scatter_variance
from split_cli.learning.kernel import Kernel
from split_cli.learning.labels import compute_labels
from split_cli.learning.region import build_grid
from split_cli.logs.drive import read_drive
from split_cli.vehicle.parameters import EffectSpec, read_vehicle
from split_cli.workflows.racing.first_lap import blank_header
from split_cli.workflows.racing.settings import LEARNING

BLOCKS = 5
_LAG = EffectSpec("feature_lag", {"tau": 0.08})


def held_out(kernel: Kernel, z: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return root mean squares of what a dense process leaves of labels in blocks of time it did not see, (3,)."""
    block = np.arange(len(z)) * BLOCKS // len(z)
    left = np.zeros_like(y)
    for number in range(BLOCKS):
        asked, known = block == number, block != number
        correlation, cross = kernel.correlation(z[known], z[known]), kernel.correlation(z[asked], z[known])
        for output in range(3):
            ratio = kernel.noise_variance[output] / kernel.signal_variance[output]
            factor = cho_factor(correlation + ratio * np.eye(len(correlation)))
            left[asked, output] = y[asked, output] - cross @ cho_solve(factor, y[known, output])
    return np.sqrt(np.square(left).mean(axis=0))


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("drives", nargs="+")
    parser.add_argument("--vehicle", required=True)
    given = parser.parse_args()
    plain = read_vehicle(given.vehicle)
    for drive in given.drives:
        for vehicle, names in ((plain, "z2"), (plain.with_effects(_LAG), "z2,feature_lag")):
            blank, features = blank_header(vehicle, LEARNING), parse_features(names)
            labels = compute_labels(read_drive(drive), vehicle, features, blank.region, horizon=blank.horizon)
            good = labels.accepted
            z, y = labels.z[good], labels.y[good]
            grid = build_grid(features, vehicle, blank.region, z)
            start = default_kernel(grid, y, scatter_variance(labels))
            for errors, times in (("white", None), ("lasting", labels.t[good])):
                fit = fit_kernel(z, y, grid, start, times=times)
                told = {
                    "cells": fit.kernel.length_scales / np.array(grid.edges),
                    "signal": np.sqrt(fit.kernel.signal_variance), "noise": np.sqrt(fit.kernel.noise_variance),
                    "lasts": np.sqrt(fit.lasting_variance), "held out": held_out(fit.kernel, z, y),
                }  # fmt: skip
                words = "; ".join(f"{key} {' '.join(f'{v:.3f}' for v in value)}" for key, value in told.items())
                print(f"{drive}, {names}, {errors}: {words}; memory {fit.memory:.3f} s", flush=True)


if __name__ == "__main__":
    main()
