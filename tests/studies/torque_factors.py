"""Multiply T of drives by a factor, or take a part of it: what ingest says, and from which factor on it is reported.

Example: ``python -m tests.studies.torque_factors road.parquet sample_logs/road_car.yaml``. Drives and vehicle files
go in turn. Each line is a drive, with its shares as recorded and the verdict on each alteration: *-* nothing, *!* a
fault, *?* a remark.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from split_cli.logs.checking.consistency import check_consistency
from split_cli.logs.drive import Drive, read_drive
from split_cli.vehicle.parameters import Vehicle, read_vehicle

_FACTORS = (0.5, 0.61, 0.7, 0.74, 0.8, 0.85, 0.9, 1.1, 1.15, 1.2, 1.25, 1.35, 1.65, 2.0)
_MARKS = {"scale": "!", "sign": "!", "uneven": "?", "factor": "?"}


def _parts(car: Vehicle) -> dict[str, Callable[[np.ndarray], np.ndarray]]:
    front, brakes = car.drive_split_front, car.brake_split_front
    return {
        "no brakes": lambda T: np.maximum(T, 0.0),
        "no drive": lambda T: np.minimum(T, 0.0),
        "front axle": lambda T: np.where(T > 0.0, front, brakes) * T,
        "rear axle": lambda T: np.where(T > 0.0, 1.0 - front, 1.0 - brakes) * T,
    }


def said(drive: Drive, car: Vehicle, alter: Callable[[np.ndarray], np.ndarray]) -> tuple[str, str]:
    """Return the mark of what is said of T, and the words."""
    altered = replace(drive, columns={**drive.columns, "T": alter(drive.columns["T"])})
    findings = [f for f in check_consistency(altered, car, drive.metadata.kinds).findings if f.channel == "T"]
    return "".join(_MARKS.get(f.check, f.check) for f in findings) or "-", " ".join(f.text for f in findings)


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("drives", nargs="+", help="a drive, its vehicle, the next drive ...")
    parser.add_argument("--words", action="store_true", help="also print what is said of each part")
    options = parser.parse_args()
    for path, vehicle in zip(options.drives[::2], options.drives[1::2], strict=True):
        drive, car = read_drive(path), read_vehicle(vehicle)
        cases = {"as it is": np.asarray} | {f"{f:g}": (lambda T, f=f: f * T) for f in _FACTORS} | _parts(car)
        told = {name: said(drive, car, alter) for name, alter in cases.items()}
        print(f"{path}: {', '.join(f'{name} {mark}' for name, (mark, _) in told.items())}")
        for name in (n for n in told if options.words or n == "as it is"):
            print(f"  {name}: {told[name][1] or 'nothing'}")


if __name__ == "__main__":
    main()
