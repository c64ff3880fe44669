"""Limits of acceleration over speed, as the planners of TUM and of race_stack read them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from split_cli.errors import SplitError
from split_cli.learning.region import Region
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack

_ANGLES = 181  # slip angles at which a curve's largest force is looked for
_FASTEST, _STEP = 100.0, 1.0  # highest speed of the table, and between speeds [m/s]


@dataclass(frozen=True)
class SpeedLimits:
    """Largest accelerations at each speed."""

    speed: np.ndarray  # (N,): v_x [m/s]
    # longitudinal, lateral: (N,): what the tyres allow, each alone [m/s^2].
    longitudinal: np.ndarray
    lateral: np.ndarray
    # (N,): what `max_torque` allows on the level, drag and rolling resistance taken off [m/s^2].
    machine: np.ndarray


def limits_over_speed(vehicle: Vehicle, region: Region) -> SpeedLimits:
    """Return the limits from the minimum speed to where torque no longer beats the resistances, at most 100 m/s.

    Raises
    ------
    SplitError
        If the region begins where the table ends.

    Notes
    -----
    Steady turning loads the front axle with m a_y l_r/L and the rear with m a_y l_f/L; the lateral limit is
    reached when the first of them needs the largest force of its curve within +-alpha_max, named effects included
    (aero downforce, friction). The longitudinal limit is the sum of both axles' largest forces, grip being taken
    as the same along and across, over the mass. The residual is left out: it says nothing at the limit.
    """
    if region.minimum_speed > _FASTEST - _STEP:
        what = f"the valid region begins at {region.minimum_speed:g} m/s, and a table of limits ends at {_FASTEST:g}"
        raise SplitError(what, where=vehicle.name, advice="See with `split verify` where the set was changed.")
    model = SingleTrack(vehicle)
    speed = np.arange(region.minimum_speed, _FASTEST + _STEP, _STEP)
    angle = np.linspace(-region.alpha_max, region.alpha_max, _ANGLES)
    v, alpha = (part.ravel() for part in np.meshgrid(speed, angle, indexing="ij"))
    zero = np.zeros_like(v)
    # Steered by alpha the front slips by it; drifting by -alpha v the rear does.
    front = model.flow(v, zero, zero, zero, alpha).front.lateral_force
    rear = model.flow(v, -np.tan(alpha) * v, zero, zero, zero).rear.lateral_force
    front, rear = (np.abs(np.broadcast_to(f, v.shape)).reshape(len(speed), -1).max(axis=1) for f in (front, rear))
    length = vehicle.wheelbase
    lateral = np.minimum(front * length / vehicle.cg_to_rear_axle, rear * length / vehicle.cg_to_front_axle)
    one = np.zeros_like(speed)
    machine = np.broadcast_to(model.velocity_derivative(speed, one, one, one + vehicle.max_torque, one)[0], speed.shape)
    used = slice(0, max(2, int(np.count_nonzero(machine > 0.0))))
    mass = vehicle.mass
    return SpeedLimits(speed[used], ((front + rear) / mass)[used], (lateral / mass)[used], machine[used])


def write_ggv(limits: SpeedLimits, folder: Path, name: str) -> tuple[str, str]:
    """Write ``NAME_ggv.csv`` and ``NAME_ax_max_machines.csv``; return their names."""
    tables = {
        f"{name}_ggv.csv": ("# v_mps,ax_max_mps2,ay_max_mps2", (limits.longitudinal, limits.lateral)),
        f"{name}_ax_max_machines.csv": ("# vx_mps,ax_max_machines_mps2", (limits.machine,)),
    }
    for file, (header, columns) in tables.items():
        rows = zip(limits.speed.tolist(), *(column.tolist() for column in columns), strict=True)
        lines = [header, *(",".join(f"{value:.4f}" for value in row) for row in rows)]
        (folder / file).write_text("\n".join(lines) + "\n", encoding="ascii")
    friction, machine = tables
    return friction, machine
