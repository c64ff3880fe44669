"""A car of commonroad-vehicle-models as reality, a gently calibrated single track as simulation.

    python -m tests.studies.multibody -o multibody
    python -m tests.studies.multibody --faults all -o faults
    python -m tests.studies.multibody --model drift --faults all -o drift

The car is driven hard; what is found is judged on another hard drive. With ``--faults`` it gets one known fault
at a time, and the car without it, on another track, is the simulation.
"""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from split_cli.errors import SplitError
from split_cli.files import atomic_directory
from split_cli.logs.drive import Drive, write_drive
from split_cli.proof.tracks import random_track
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.diagnose import diagnose_files
from split_cli.workflows.proving.prove_recording import InjectionResult, diagnose_pair, injection_result
from tests.studies.drift_car import load_drift_car
from tests.studies.multibody_car import MultiBody, calibrated_vehicle, gentle_drives, hard_drive, load_car
from tests.studies.multibody_faults import multibody_faults

FOREIGN_MODELS = {"multibody": load_car, "drift": load_drift_car}
"""Someone else's equations of motion, by name; each takes the number of a car."""

_TRIES = 12
_CALMER = (1.0, 0.85, 0.7)  # of the lateral acceleration that is asked for: a tall car tips
_HARD_SECONDS = 120.0  # of a hard drive; another half as long on another track is held out
_FAULT_SECONDS = 80.0  # of each drive with and without a fault
_TRACKS_APART = 20  # more than the tracks that may be tried for one drive


def prove_multibody(output: Path, *, seed: int = 1, car: int = 2, model: str = "multibody"):
    """Calibrate, drive hard, diagnose; everything is written to a folder.

    Parameters
    ----------
    output : Path
        Gets ``vehicle.yaml``, ``real.parquet``, ``holdout.parquet`` and the folder ``diagnosis``.
    seed : int
        Of tracks, driver and noise.
    car : int
        Of the package: 1 Ford Escort, 2 BMW 320i, 3 VW Vanagon.
    model : str
        One of `FOREIGN_MODELS`.

    Raises
    ------
    SplitError
        If the package is not installed or its car cannot be kept on any of twelve tracks.
    """
    body = FOREIGN_MODELS[model](car)
    vehicle = calibrated_vehicle(body, gentle_drives(body, seed))
    real, used = _kept_on_track(body, seed, 0, _HARD_SECONDS, "real.parquet")
    holdout, _ = _kept_on_track(body, seed, used + 1, 0.5 * _HARD_SECONDS, "holdout.parquet")
    with atomic_directory(output) as folder:
        write_vehicle(vehicle, folder / "vehicle.yaml")
        write_drive(real, folder / "real.parquet")
        write_drive(holdout, folder / "holdout.parquet")
    return diagnose_files(
        [output / "real.parquet"], output / "vehicle.yaml", output / "diagnosis", holdout=[output / "holdout.parquet"]
    )


def prove_multibody_faults(
    output: Path, *, seed: int = 1, car: int = 2, model: str = "multibody", only: Sequence[str] | None = None
) -> list[InjectionResult]:
    """Put known faults into the car; without them, on another track, it is the simulation.

    The nominal model is the calibrated single track, so that both share what a single track lacks. The simulation
    has no sensor noise.

    Parameters
    ----------
    output : Path
        Folder; gets ``vehicle.yaml``, the pairs of drives and a diagnosis each.
    seed, car, model
        As for `prove_multibody`.
    only : sequence of str, optional
        Names of `multibody_faults.MULTIBODY_FAULTS`.

    Raises
    ------
    SplitError
        As `prove_multibody`, or if a name is no fault.
    """
    faults = multibody_faults(only)
    body = FOREIGN_MODELS[model](car)
    output.mkdir(parents=True, exist_ok=True)
    write_vehicle(calibrated_vehicle(body, gentle_drives(body, seed)), output / "vehicle.yaml")
    drive = partial(_kept_on_track, seed=seed, seconds=_FAULT_SECONDS)
    reference, used = drive(body, first=100, name="sim.parquet", lateral=6.5, noisy=False)
    results = []
    for number, fault in enumerate(faults):
        first = used + 1 + _TRACKS_APART * fault.track
        real, _ = drive(fault.alter(body), first=first, name="real.parquet", lateral=5.5)
        said, words = diagnose_pair(
            output / f"{number + 1:03d}", output / "vehicle.yaml", reference, fault.record(real)
        )
        results.append(
            injection_result(
                f"car {car}",
                fault.name,
                fault.term,
                fault.parameters(body),
                said,
                words,
                in_catalogue=fault.in_catalogue,
            )
        )
        print(results[-1], flush=True)
    return results


def _kept_on_track(
    body: MultiBody, seed: int, first: int, seconds: float, name: str, lateral: float = 5.0, noisy: bool = True
) -> tuple[Drive, int]:
    """Return a hard drive on a random track on which the car is not lost, and the track's number.

    Twelve tracks are tried, then the same with less lateral acceleration.
    """
    for share in _CALMER:
        for number in range(first, first + _TRIES):
            track = random_track(np.random.default_rng([seed, number]), 1000.0, 0.5, 5.0)
            try:
                return hard_drive(
                    body,
                    track,
                    lateral=share * lateral,
                    braking=4.0,
                    seconds=seconds,
                    seed=seed + number,
                    name=name,
                    noisy=noisy,
                ), number
            except SplitError:
                continue
    advice = "Take another seed."
    raise SplitError("the foreign car left each of twelve tracks, even when driven calmly", advice=advice)


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1, help="of tracks, driver and noise")
    parser.add_argument("--car", type=int, choices=(1, 2, 3), default=2, help="number in the package")
    parser.add_argument("--model", choices=FOREIGN_MODELS, default="multibody", help="29 states or a single track")
    parser.add_argument("--faults", help="add only these faults, separated by commas, or all")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the results")
    given = vars(parser.parse_args())
    faults, output = given.pop("faults"), given.pop("output")
    if faults:
        prove_multibody_faults(output, only=None if faults == "all" else faults.split(","), **given)
    else:
        print(prove_multibody(output, **given).summary)


if __name__ == "__main__":
    main()
