"""What a lateral velocity from accelerations is worth: measured v_y is thrown away, derived, and compared.

Example: ``python -m tests.studies.lateral_velocity road_car.yaml a.parquet b.parquet``. Prints a row a drive: rms
of the measured v_y and of three errors. They are of the derived v_y, of the steady sideslip of the nominal single
track, and of v_y = 0 (the rms itself). The measured v_y is taken less its direction on straights.
"""

import argparse

import numpy as np

from split_cli.errors import MapError
from split_cli.logs.assembling.derivation import DerivationInputs
from split_cli.logs.assembling.derivations import derivation_named
from split_cli.logs.drive import Drive, read_drive
from split_cli.vehicle.parameters import Vehicle, read_vehicle

_NAME = "lateral-velocity-from-accelerations"
_HARD = 3.0  # [m/s^2] of v_x r


def _inputs(drive: Drive, vehicle: Vehicle, names: tuple[str, ...]) -> DerivationInputs:
    columns = {name: np.array(drive[name], dtype=float) for name in names}
    rows = np.arange(len(drive))
    for values in columns.values():
        known = np.isfinite(values)
        values[~known] = np.interp(rows[~known], rows[known], values[known])
    return DerivationInputs(columns, drive.period, drive.segments(), vehicle, {}, drive["t"])


def _row(drive: Drive, vehicle: Vehicle) -> str:
    measured = _inputs(drive, vehicle, ("vx", "vy", "r"))
    try:
        true = derivation_named("lateral-velocity-from-straights").run(measured).columns["vy"]
    except MapError:
        true = measured.columns["vy"]
    try:
        derived = derivation_named(_NAME).run(_inputs(drive, vehicle, ("vx", "r", "ay")))
    except MapError as error:
        return f"| {drive.name} | refused: {error} |"
    vy, std = derived.columns["vy"], derived.columns["vy_std"]
    vx, r = measured.columns["vx"], measured.columns["r"]
    axle = vehicle.mass * vehicle.cg_to_front_axle / vehicle.wheelbase / vehicle.rear_tire.cornering_stiffness
    steady = (vehicle.cg_to_rear_axle - axle * vx**2) * r
    known = np.isfinite(vy)
    cells = []
    for rows in (known, known & (np.abs(vx * r) > _HARD)):
        cells += [_rms(values[rows]) for values in (true, vy - true, steady - true)]
    inside = np.mean(np.abs(vy - true)[known] < 1.96 * std[known])
    return f"| {drive.name} | {known.mean():.0%} | {' | '.join(cells)} | {np.median(std):.2f} | {inside:.0%} |"


def _rms(values: np.ndarray) -> str:
    return f"{np.sqrt(np.mean(values**2)):.3f}" if len(values) else ""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("vehicle", help="file or name of a preset")
    parser.add_argument("drives", nargs="+", help="with a measured v_y and a_y")
    given = parser.parse_args()
    vehicle = read_vehicle(given.vehicle)
    print("| drive | kept | v_y = 0 | derived | steady | v_y = 0, hard | derived | steady | std | within 95 % |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for path in given.drives:
        print(_row(read_drive(path), vehicle), flush=True)


if __name__ == "__main__":
    main()
