"""Someone else's multi-body car as reality, a gently calibrated single track as simulation: what is said of it?"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from split_cli.errors import SplitError
from split_cli.files import atomic_directory
from split_cli.logs.drive import write_drive
from split_cli.proof.multibody import calibrated_vehicle, gentle_drives, hard_drive, load_car
from split_cli.proof.tracks import random_track
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.diagnose import diagnose_files

__all__ = ["prove_multibody"]


def prove_multibody(output: Path, *, seed: int = 1, car: int = 2, seconds: float = 120.0):
    """Calibrate, drive hard, diagnose; everything is written to a folder.

    Parameters
    ----------
    output : Path
        Gets ``vehicle.yaml``, ``real.parquet``, ``holdout.parquet`` and the folder ``diagnosis``.
    seed : int
        Of tracks, driver and noise.
    car : int
        Of the package: 1 Ford Escort, 2 BMW 320i, 3 VW Vanagon.
    seconds : float
        Length of the hard drive; another half as long on another track is held out [s].

    Returns
    -------
    split_cli.diagnosis.result.Diagnosis

    Raises
    ------
    SplitError
        If the package is not installed or its car cannot be kept on any of twelve tracks.
    """
    body = load_car(car)
    vehicle = calibrated_vehicle(body, gentle_drives(body, seed))
    real, used = _kept_on_track(body, seed, 0, seconds, "real.parquet")
    holdout, _ = _kept_on_track(body, seed, used + 1, 0.5 * seconds, "holdout.parquet")
    with atomic_directory(output) as folder:
        write_vehicle(vehicle, folder / "vehicle.yaml")
        write_drive(real, folder / "real.parquet")
        write_drive(holdout, folder / "holdout.parquet")
    return diagnose_files(
        [output / "real.parquet"],
        output / "vehicle.yaml",
        output / "diagnosis",
        holdout=[output / "holdout.parquet"],
    )


def _kept_on_track(body, seed: int, first: int, seconds: float, name: str):
    """Return a hard drive on the first of twelve random tracks on which the car is not lost."""
    for number in range(first, first + 12):
        track = random_track(np.random.default_rng([seed, number]), 1000.0, 0.5, 5.0)
        try:
            return hard_drive(
                body, track, lateral=5.0, braking=4.0, seconds=seconds, seed=seed + number, name=name
            ), number
        except SplitError:
            continue
    raise SplitError("the multi-body car was lost on twelve tracks", advice="Take another seed.")
