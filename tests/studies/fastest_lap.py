"""How fast a lap of the road car can be at all: a point that has the plant's own grip and knows all of it.

Example: ``python -m tests.studies.fastest_lap``. For both tracks of the closed-loop experiments it prints the time
of the fastest lap. The point follows any line within the track. It may use what both axles give in a steady state
at each longitudinal acceleration, at once and without a lag. So its time bounds what a better model can gain.
Further rows hold the point to what controllers hold their plans to: a margin to the border, and the ellipse.

``python -m tests.studies.fastest_lap car`` asks the same of the model in the controllers instead of the point: the
single track of the vehicle file with learned peaks, within all bounds of plans, over a whole lap at once.
"""

import sys
from dataclasses import replace

import casadi
import numpy as np

from split_cli.control.limits import load_shift
from split_cli.control.policy import (
    ALPHA_MAX,
    DALPHA_MAX,
    MARGIN,
    MAX_STEER,
    RACE_P_LONG,
    SHARE_LEARNED,
    SHARE_NOMINAL,
    STEER_RATE,
    TORQUE_RATE,
)
from split_cli.plant.cars import ROAD_CAR, CarParameters
from split_cli.plant.tire import tire_force
from split_cli.plant.tracks import find_track
from split_cli.signals import STANDARD_GRAVITY
from split_cli.vehicle.parameters import read_vehicle
from split_cli.workflows.racing.closed_loop import body_width, path_of

TRACKS = {"small": 22.0, "handling": 30.0}
"""Largest speed on each track [m/s], as in the experiments."""

DRIVING = 1000.0
"""Largest driving torque of the experiments [N m]."""

LAST_MARGIN = 0.34
"""What plans kept to the border in lap 10 with SPLIT [m], on both tracks and with each seed."""

LEARNED = {"small": (0.905, 0.93), "handling": (0.91, 0.935)}
"""Peaks of front and rear over the vehicle file's [1] that SPLIT had learned after lap 10 with seed 0."""

NOMINAL_MARGIN = 0.76
"""What the nominal controller kept to the border in its best lap of the small track [m]."""

SPACING = 4.0
"""Of the collocation along the centre line [m]; with 2 m the times are 0.02 to 0.06 s longer."""


def axle_state(car: CarParameters, front: bool, along: float, across: float) -> tuple[float, tuple[float, float]]:
    """Return an axle's force along and its wheels' loads [N] at the car's steady accelerations [m/s^2]."""
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
    return car.mass * along * (split if front else 1.0 - split), (0.5 * load - shift, 0.5 * load + shift)


def axle_force(car: CarParameters, front: bool, along: float, across: float, share: float | None) -> float:
    """Return the largest steady lateral force of an axle [N] at the car's accelerations [m/s^2].

    With a `share` of the peak it is what the controllers' ellipse leaves of it, else what the plant's tyres give.
    """
    force, loads = axle_state(car, front, along, across)
    wanted = 0.5 * force if share is None else 0.0
    kappa, alpha = np.linspace(-0.2, 0.2, 201), np.linspace(0.0, 0.3, 151)
    total = np.zeros_like(alpha)
    for wheel in loads:
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


def side_slopes(car: CarParameters, front: bool) -> tuple[float, float]:
    """Return by which share of an axle's side force a newton of drive and of braking raises it [1/N].

    Load moves to the rear or to the front, and the tyres' force along takes of the force across. Both are those of
    0.8 g to the side at a slip angle of 0.08 rad, near the plans' limit.
    """
    tire, kappa = (car.front_tire if front else car.rear_tire), np.linspace(-0.05, 0.05, 1001)
    found = []
    for along in (0.0, 2.0, -3.0):
        force, loads = axle_state(car, front, along, 8.0)
        side = 0.0
        for load in loads:
            fx, fy = tire_force(tire, kappa, np.full_like(kappa, 0.08), load)
            side += float(np.interp(0.5 * force, fx, fy))
        found.append(side)
    drive, brake = ((found[k] / found[0] - 1.0) / (car.mass * a) for k, a in ((1, 2.0), (2, -3.0)))
    return drive, brake


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


def fastest_car(
    track: str,
    grip: tuple[float, float],
    margin: float,
    share: float,
    spacing: float = 2.0,
    *,
    lags: bool = False,
    loads: bool = False,
) -> float:
    """Return the time of the fastest lap [s] of the single track within the controllers' bounds.

    `grip` are the peaks of front and rear over the vehicle file's [1], `share` of them plans may use. With `lags`
    torque, steer angle and slip angles follow late, as those of the plant do. With `loads` driving and braking
    change the side forces as they change those of the plant (`side_slopes`), and wheels have to be spun up.
    """
    vehicle = read_vehicle("sample_logs/road_car.yaml")
    front, rear = (
        replace(tire, B=tire.B / s, D=s * tire.D)
        for tire, s in zip((vehicle.front_tire, vehicle.rear_tire), grip, strict=True)
    )
    vehicle = replace(vehicle, front_tire=front, rear_tire=rear)
    path, shift = path_of(find_track(track)), load_shift(vehicle)
    count = int(round(path.length / spacing))
    h = path.length / count
    at = path.at(h * np.arange(count))
    room = at.left - 0.5 * body_width(ROAD_CAR) - margin
    opti = casadi.Opti()
    n, angle, vx, vy, r, torque, steer = (opti.variable(1, count) for _ in range(7))
    torque_rate, steer_rate = opti.variable(1, count), opti.variable(1, count)
    curvature = at.curvature[None]
    along = (vx * casadi.cos(angle) - vy * casadi.sin(angle)) / (1.0 - n * curvature)  # ds/dt
    l_f, l_r = vehicle.cg_to_front_axle, vehicle.cg_to_rear_axle
    slip = steer - casadi.atan((vy + l_f * r) / vx), -casadi.atan((vy - l_r * r) / vx)
    whole, arrived, angles, late = 1e3 * torque / vehicle.wheel_radius, steer, slip, ()
    if lags:
        pull, arrived, *angles = (opti.variable(1, count) for _ in range(4))
        kinematic, length = (slip[0] + arrived - steer, slip[1]), ROAD_CAR.front_tire.relaxation_lateral
        late = (
            (pull, (torque - pull) / ROAD_CAR.drive_lag),
            (arrived, (steer - arrived) / ROAD_CAR.steer_lag),
            *((own, (goal - own) * vx / length) for own, goal in zip(angles, kinematic, strict=True)),
        )
        whole = 1e3 * pull / vehicle.wheel_radius
        opti.set_initial(arrived, np.arctan(vehicle.wheelbase * curvature))
    side_f, side_r = (
        tire.D * casadi.sin(tire.C * casadi.atan(tire.B * alpha))
        for tire, alpha in zip((front, rear), angles, strict=True)
    )
    inertia = vehicle.mass
    if loads:
        inertia = ROAD_CAR.effective_mass
        driving = 0.5 * (whole + casadi.sqrt(whole**2 + 600.0**2))  # smooth within 600 N
        side_f, side_r = (
            side * (1.0 + slopes[0] * driving + slopes[1] * (whole - driving))
            for side, slopes in zip(
                (side_f, side_r), (side_slopes(ROAD_CAR, axle) for axle in (True, False)), strict=True
            )
        )
    brake, drive = vehicle.brake_split_front, vehicle.drive_split_front
    ahead = 0.5 * (drive + brake) + 0.5 * (drive - brake) * casadi.tanh(20.0 * torque)  # smooth within 50 N m
    force = ahead * whole, (1.0 - ahead) * whole
    rolling = vehicle.rolling_resistance_front + vehicle.rolling_resistance_rear
    push = whole - rolling - vehicle.drag_coefficient * vx**2 - side_f * casadi.sin(arrived)
    slopes = (
        (n, vx * casadi.sin(angle) + vy * casadi.cos(angle)),
        (angle, r - curvature * along),
        (vx, (push + vehicle.mass * vy * r) / inertia),
        (vy, (side_f * casadi.cos(arrived) + side_r) / vehicle.mass - vx * r),
        (r, (l_f * side_f * casadi.cos(arrived) - l_r * side_r) / vehicle.yaw_inertia),
        (torque, torque_rate),
        (steer, steer_rate),
        *late,
    )
    following = [*range(1, count), 0]
    for state, slope in slopes:
        a_metre = slope / along
        opti.subject_to(state[following] - state == 0.5 * h * (a_metre + a_metre[following]))
    for k, tire in enumerate((front, rear)):
        scale = 1.0 + shift[k] * whole
        angle_over = casadi.atan(tire.B / scale * slip[k])
        used = RACE_P_LONG * force[k] / (tire.D * scale)
        opti.subject_to(casadi.sin(tire.C * angle_over) ** 2 + used**2 <= share**2)
        opti.subject_to(opti.bounded(-1.0, tire.C * angle_over / (0.5 * np.pi), 1.0))
        opti.subject_to(opti.bounded(-ALPHA_MAX, slip[k], ALPHA_MAX))
    opti.subject_to(opti.bounded(-DALPHA_MAX, slip[0] - slip[1], DALPHA_MAX))
    opti.subject_to(opti.bounded(-1e-3 * vehicle.max_brake_torque, torque, 1e-3 * DRIVING))
    opti.subject_to(opti.bounded(-MAX_STEER, steer, MAX_STEER))
    opti.subject_to(opti.bounded(-1e-3 * TORQUE_RATE, torque_rate, 1e-3 * TORQUE_RATE))
    opti.subject_to(opti.bounded(-STEER_RATE, steer_rate, STEER_RATE))
    opti.subject_to(opti.bounded(-room[None], n, room[None]))
    opti.subject_to(opti.bounded(3.0, vx, TRACKS[track]))
    opti.subject_to(opti.bounded(-1.0, angle, 1.0))
    opti.set_initial(vx, 8.0)
    opti.set_initial(r, 8.0 * curvature)
    opti.set_initial(steer, np.arctan(vehicle.wheelbase * curvature))
    opti.minimize(casadi.sum2(h / along) + 1e-6 * casadi.sumsqr(steer_rate))
    opti.solver("ipopt", {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.max_iter": 2000})
    solution = opti.solve()
    return float(solution.value(casadi.sum2(h / along)))


def main(model: str = "point") -> None:
    """Run from the command line."""
    if model == "car":
        nominal, learned = (((1.0, 1.0), NOMINAL_MARGIN, SHARE_NOMINAL), (LEARNED["small"], LAST_MARGIN, SHARE_LEARNED))
        for called, track, bounds, more in (
            ("bounds of the nominal controller", "small", nominal, {}),
            ("bounds of SPLIT", "small", learned, {}),
            ("the same with lags", "small", learned, {"lags": True}),
            ("the same with the plant's loads", "small", learned, {"loads": True}),
            ("the same, no margin", "small", (learned[0], 0.0, learned[2]), {}),
            ("the same, the whole peak", "small", (*learned[:2], 0.9999), {}),
            ("bounds of SPLIT", "handling", (LEARNED["handling"], *learned[1:]), {}),
            ("the same with the plant's loads", "handling", (LEARNED["handling"], *learned[1:]), {"loads": True}),
        ):
            print(f"single track, {track}, {called}: {fastest_car(track, *bounds, **more):.2f} s", flush=True)
        return
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
    main(*sys.argv[1:])
