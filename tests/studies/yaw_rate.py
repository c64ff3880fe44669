"""What a yaw rate from the lateral acceleration is worth: the measured one is thrown away, derived, and compared.

Example: ``python -m tests.studies.yaw_rate road_car.yaml a.parquet b.parquet``. Prints a row a drive: rms of the
measured yaw rate and of the errors of a_y/v_x, of `turning_of_rear_tires` and, with the measured v_y, of
`turning_of_measured_lateral_velocity`; then rms of v_y and of the error of the v_y that the rear tyres give. a_y is
taken less its median on straights with ``--centred``.
"""

import argparse

import numpy as np

from split_cli.logs.assembling.turning import turning_of_measured_lateral_velocity, turning_of_rear_tires
from split_cli.logs.drive import Drive, read_drive
from split_cli.vehicle.parameters import Vehicle, read_vehicle

_STRAIGHT = 0.02  # [rad/s] of the yaw rate, below which the car goes straight


def _row(drive: Drive, vehicle: Vehicle, centred: bool) -> str:
    columns = {name: np.array(drive[name], dtype=float) for name in ("vx", "vy", "r", "ay")}
    rows = np.arange(len(drive))
    for values in columns.values():
        known = np.isfinite(values)
        values[~known] = np.interp(rows[~known], rows[known], values[known])
    vx, r = columns["vx"], columns["r"]
    straight = (np.abs(r) < _STRAIGHT) & (vx > vehicle.minimum_speed)
    if centred and straight.any():
        columns["ay"] = columns["ay"] - np.median(columns["ay"][straight])
        columns["vy"] = columns["vy"] - vx * np.median((columns["vy"] / np.maximum(vx, 1.0))[straight])
    tires = turning_of_rear_tires(columns, drive.period, drive.segments(), vehicle)
    measured = turning_of_measured_lateral_velocity(columns, drive.period, drive.segments(), vehicle)
    known = np.isfinite(tires.r) & np.isfinite(measured.r)
    plain = columns["ay"] / np.where(known, vx, 1.0)
    errors = (r, plain - r, tires.r - r, measured.r - r, columns["vy"], tires.vy - columns["vy"])
    cells = [f"{np.sqrt(np.mean(values[known] ** 2)):.4f}" for values in errors]
    return f"| {drive.name} | {known.mean():.0%} | {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("vehicle", help="file or name of a preset")
    parser.add_argument("drives", nargs="+", help="with a measured r, v_y and a_y")
    parser.add_argument("--centred", action="store_true", help="take a_y and v_y/v_x less their median on straights")
    given = parser.parse_args()
    vehicle = read_vehicle(given.vehicle)
    print("| drive | kept | r | a_y/v_x | rear tyres | measured v_y | v_y | v_y of rear tyres |")
    print("|---|---|---|---|---|---|---|---|")
    for path in given.drives:
        print(_row(read_drive(path), vehicle, given.centred), flush=True)


if __name__ == "__main__":
    main()
