"""How fast a lap of the road car can be at all: a point that has the plant's own grip and knows all of it.

Example: ``python -m tests.studies.fastest_lap``. For both tracks of the closed-loop experiments it prints the time
of the fastest lap. The point follows any line within the track. It may use what both axles give in a steady state
at each longitudinal acceleration, at once and without a lag. So its time bounds what a better model can gain.
Further rows hold the point to what controllers hold their plans to: a margin to the border, and the ellipse.
"""

import casadi
import numpy as np

from split_cli.control.policy import MARGIN, RACE_P_LONG, SHARE_LEARNED, SHARE_NOMINAL
from split_cli.plant.cars import ROAD_CAR, CarParameters
from split_cli.plant.tire import tire_force
from split_cli.plant.tracks import find_track
from split_cli.signals import STANDARD_GRAVITY
from split_cli.workflows.racing.closed_loop import body_width, path_of

TRACKS = {"small": 22.0, "handling": 30.0}
"""Largest speed on each track [m/s], as in the experiments."""

DRIVING = 1000.0
"""Largest driving torque of the experiments [N m]."""

LAST_MARGIN = 0.34
"""What plans kept to the border in lap 10 with SPLIT [m], on both tracks and with each seed."""

SPACING = 4.0
"""Of the collocation along the centre line [m]; with 2 m the times are 0.02 to 0.06 s longer."""


def axle_force(car: CarParameters, front: bool, along: float, across: float, share: float | None) -> float:
    """Return the largest steady lateral force of an axle [N] at the car's accelerations [m/s^2].

    With a `share` of the peak it is what the controllers' ellipse leaves of it, else what the plant's tyres give.
    """
    ahead = car.static_load_front / (car.mass * STANDARD_GRAVITY)
    track, length = (car.track_front if front else car.track_rear), car.wheelbase
    roll_axis = ahead * car.roll_center_front + (1.0 - ahead) * car.roll_center_rear
    pitch = car.mass * along * car.cg_height / length
    load = car.static_load_front - pitch if front else car.static_load_rear + pitch
    center, part = (
        (car.roll_center_front * ahead, car.roll_stiffness_front_share)
        if front
        else (car.roll_center_rear * (1.0 - ahead), 1.0 - car.roll_stiffness_front_share)
    )
    shift = car.mass * across * (center + part * (car.cg_height - roll_axis)) / track
    split = car.drive_split_front if along >= 0.0 else car.brake_split_front
    force = car.mass * along * (split if front else 1.0 - split)
    wanted = 0.5 * force if share is None else 0.0
    kappa, alpha = np.linspace(-0.2, 0.2, 201), np.linspace(0.0, 0.3, 151)
    total = np.zeros_like(alpha)
    for wheel in (0.5 * load - shift, 0.5 * load + shift):
        tire = car.front_tire if front else car.rear_tire
        fx, fy = tire_force(tire, kappa[:, None], alpha[None], max(wheel, 1.0))
        enough = np.abs(fx - wanted)
        nearest = enough.argmin(axis=0)
        got = fy[nearest, np.arange(len(alpha))]
        total += np.where(enough.min(axis=0) < 0.02 * car.mass, got, -np.inf)
    peak = float(total.max())
    if share is None:
        return peak
    return float(np.sqrt(max((share * peak) ** 2 - (RACE_P_LONG * force) ** 2, 0.0)))


def envelope(car: CarParameters, along: np.ndarray, share: float | None) -> np.ndarray:
    """Return the largest steady lateral acceleration [m/s^2] at each longitudinal one [m/s^2]."""
    found = []
    for a in along:
        low, high = 0.0, 12.0
        while high - low > 1e-3:
            middle = 0.5 * (low + high)
            need = car.mass * middle / car.wheelbase
            holds = axle_force(car, True, a, middle, share) >= need * car.cg_to_rear_axle
            holds = holds and axle_force(car, False, a, middle, share) >= need * car.cg_to_front_axle
            low, high = (middle, high) if holds else (low, middle)
        found.append(low)
    return np.array(found)


def fastest(track: str, along: np.ndarray, across: np.ndarray, margin: float) -> float:
    """Return the time of the fastest lap [s]: direct collocation by the trapezoidal rule, solved by IPOPT."""
    car, path = ROAD_CAR, path_of(find_track(track))
    count = int(round(path.length / SPACING))
    h = path.length / count
    s = h * np.arange(count)
    at = path.at(s)
    room = at.left - 0.5 * body_width(car) - margin
    drag = 0.5 * car.air_density * car.drag_area / car.mass
    rolling = car.front_tire.rolling_resistance * STANDARD_GRAVITY
    opti = casadi.Opti()
    n, angle, v, bend, push = (opti.variable(count) for _ in range(5))
    stretch = (1.0 - n * at.curvature) / casadi.cos(angle)
    slopes = (
        (n, stretch * casadi.sin(angle)),
        (angle, stretch * bend - at.curvature),
        (v, stretch * (push - rolling - drag * v**2) / v),
    )
    following = [*range(1, count), 0]
    for state, slope in slopes:
        opti.subject_to(state[following] - state == 0.5 * h * (slope + slope[following]))
    limit = casadi.interpolant("limit", "bspline", [along], across)
    opti.subject_to(opti.bounded(-limit(push.T).T, bend * v**2, limit(push.T).T))
    opti.subject_to(opti.bounded(along[0], push, DRIVING / car.wheel_radius / car.effective_mass))
    opti.subject_to(opti.bounded(-room, n, room))
    opti.subject_to(opti.bounded(3.0, v, TRACKS[track]))
    opti.subject_to(opti.bounded(-1.0, angle, 1.0))
    opti.set_initial(v, np.minimum(TRACKS[track], np.sqrt(6.0 / np.maximum(np.abs(at.curvature), 1e-3))))
    opti.set_initial(bend, at.curvature)
    opti.minimize(casadi.sum1(h * stretch / v))
    opti.solver("ipopt", {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.max_iter": 2000})
    return float(opti.solve().value(opti.f))


def main() -> None:
    """Run from the command line."""
    along = np.arange(-9.0, 3.01, 0.5)
    for share in (None, SHARE_LEARNED, SHARE_NOMINAL):
        across = envelope(ROAD_CAR, along, share)
        possible = across > 0.0
        held = "the plant's grip" if share is None else f"the ellipse with {share} of the peak"
        print(f"{held}: a_y of {across.max() / STANDARD_GRAVITY:.3f} g at most")
        for track in TRACKS:
            for margin in (0.0, MARGIN, LAST_MARGIN):
                time = fastest(track, along[possible], across[possible], margin)
                print(f"  {track}, {margin} m to the border: {time:.2f} s", flush=True)


if __name__ == "__main__":
    main()
