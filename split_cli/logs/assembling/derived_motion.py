"""Velocities, yaw rate and accelerations computed from other channels of the motion."""

import numpy as np

from split_cli.errors import MapError, nearest_names
from split_cli.logs.assembling.dead_reckoning import TOLERANCE, lateral_velocity_from_accelerations
from split_cli.logs.assembling.derivation import Derivation, DerivationInputs, Derived
from split_cli.logs.assembling.smoothing import derivative, smooth
from split_cli.logs.assembling.turning import turning_of_measured_lateral_velocity, turning_of_rear_tires
from split_cli.logs.checking.kinematics import Kinematics
from split_cli.logs.checking.straights import course_of, straight_rows, straight_stretches
from split_cli.logs.drive_metadata import MEASURED_SIDESLIP, OF_POSE, OF_REAR_TIRES, OF_WHEELS, WITHOUT_GYRO


def velocity_from_pose(
    X: np.ndarray, Y: np.ndarray, yaw: np.ndarray, period: float, segments: list[slice]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return v_x, v_y [m/s] and r [rad/s], shapes (N,), from a smoothed pose.

    Parameters
    ----------
    X, Y : ndarray, shape (N,)
        Position of the CG [m].
    yaw : ndarray, shape (N,)
        Unwrapped [rad].
    period : float
        [s].
    segments : list of slice
        Stretches without a gap.

    Notes
    -----
    Each of X, Y, yaw is smoothed as much as its own noise asks for (see `smooth`), differentiated by differences
    of fourth order, and turned into the vehicle's frame by the smoothed yaw.
    """
    out = np.empty((3, len(X)))
    for run in segments:
        smoothed = [smooth(channel[run]) for channel in (X, Y, yaw)]
        dX, dY, dyaw = (derivative(channel, period) for channel in smoothed)
        cosine, sine = np.cos(smoothed[2]), np.sin(smoothed[2])
        out[:, run] = cosine * dX + sine * dY, cosine * dY - sine * dX, dyaw
    return out[0], out[1], out[2]


def _run_velocity_from_pose(situation: DerivationInputs) -> Derived:
    c = situation.columns
    vx, vy, r = velocity_from_pose(c["X"], c["Y"], c["yaw"], situation.period, situation.segments)
    made = {"vx": vx, "vy": vy, "r": r}
    only = situation.settings.get("channels", [name for name in made if name not in c])
    for name in only:
        if name not in made:
            raise MapError(f"velocity_from_pose.channels names {name!r}", advice=nearest_names(str(name), made))
    return Derived(
        {name: made[name] for name in only},
        f"{OF_POSE} smoothed by their noise",
        f"{', '.join(only)} derived from pose: their noise is not white and not known",
    )


def _run_lateral_velocity_from_sideslip(situation: DerivationInputs) -> Derived:
    c = situation.columns
    return Derived({"vy": c["vx"] * np.tan(c["sideslip"])}, f"v_x times the tangent of {MEASURED_SIDESLIP}")


def _run_lateral_velocity_from_straights(situation: DerivationInputs) -> Derived:
    columns = situation.columns if situation.time is None else {**situation.columns, "t": situation.time}
    k = Kinematics(columns, situation.period, situation.segments)
    stretches = straight_stretches(
        k.times(), k.signal("vx"), k.signal("vy"), straight_rows(k), situation.period, situation.segments
    )
    course = course_of(stretches)
    if course is None:
        what = "--derive lateral-velocity-from-straights needs straights, and the car hardly goes straight"
        raise MapError(what, advice="Give an `offset` for vy in the map instead.")
    vx, vy = situation.columns["vx"], situation.columns["vy"]
    return Derived(
        {"vy": vy - vx * np.tan(course.at(k.times()))},
        f"v_y less its direction on straights ({course.words()}; {1e3 * course.scatter:.1f} mrad are left)",
        "" if course.count >= 6 else f"v_y was corrected on {course.count} straights: a course over time takes 6",
        keeps_noise=True,
    )


def _run_lateral_velocity_from_accelerations(situation: DerivationInputs) -> Derived:
    name = "lateral-velocity-from-accelerations"
    vehicle = situation.require_vehicle(name)
    made = lateral_velocity_from_accelerations(situation.columns, situation.period, situation.segments, vehicle)
    speed = np.maximum(np.abs(situation.columns["vx"]), vehicle.minimum_speed)
    sure = made.std <= TOLERANCE * speed if made is not None else np.zeros(len(speed), dtype=bool)
    if made is None or not sure.any():
        raise MapError(
            f"--derive {name} needs gentle driving, straight or nearly so, and finds too little",
            advice="Integrated accelerations drift between such moments. Record v_y, the sideslip or a pose.",
        )
    if not made.belongs:
        advice = (
            "Its unit, sign or frame is wrong, it is late against r, or it comes too slowly for this car. Where a pose "
            "is recorded, map X, Y and yaw, and pass --derive velocity-from-pose instead."
        )
        raise MapError(f"--derive {name}: a_y {made.doubt}", advice=advice)
    std = made.std[sure]
    rest = f"; {100.0 * (1.0 - sure.mean()):.0f} % of the rows left out, less sure than {TOLERANCE:g} rad"
    return Derived(
        {"vy": np.where(sure, made.vy, np.nan), "vy_std": made.std},
        "v_y from a_y - v_x r, held where driving is gentle; standard deviation "
        f"{np.median(std):.2g} m/s typical, {np.max(std):.2g} worst{rest if not sure.all() else ''}",
        f"v_y is derived from a_y ({made.words()}): its label repeats a_y and the tyre forces of the nominal "
        "model. Roll and bank that follow the turns, a clock between a_y and r, and the accelerometer's place "
        "stay in it",
    )


def _run_longitudinal_velocity_from_wheels(situation: DerivationInputs) -> Derived:
    """Take the axle that slips less: a driven wheel is faster than the road, a braked one slower.

    The mean of an axle is that of its middle: what turning adds to one wheel it takes from the other. The front
    wheels follow their own path, of speed hypot(v_x, L r) where the rear axle does not slide.
    """
    c, car = situation.columns, situation.vehicle
    rear = 0.5 * (c["wheel_speed_rl"] + c["wheel_speed_rr"])
    if car is None or not {"wheel_speed_fl", "wheel_speed_fr", "r"} <= set(c):
        how, vx, slip = "rear wheels", rear, "the slip of the rear wheels, where driven,"
    else:
        steered = 0.5 * (c["wheel_speed_fl"] + c["wheel_speed_fr"])
        front = np.copysign(np.sqrt(np.maximum(steered**2 - (car.wheelbase * c["r"]) ** 2, 0.0)), steered)
        force = np.empty(len(rear))
        for run in situation.segments:
            speed = smooth(0.5 * (front[run] + rear[run]))
            force[run] = car.mass * derivative(speed, situation.period) + car.drag_coefficient * speed**2
        force += car.rolling_resistance_front + car.rolling_resistance_rear
        vx = np.where(force > 0.0, np.minimum(front, rear), np.maximum(front, rear))
        how = "front or rear wheels, the slower where driven, the faster where braked"
        slip = "the slip of the axle that slips less"
    return Derived(
        {"vx": vx},
        f"mean {OF_WHEELS} {how}",
        f"v_x is derived from wheel speeds: {slip} and locked or worn tyres stay in it, and so does an error of "
        "their radius",
    )


def _run_yaw_rate_from_yaw(situation: DerivationInputs) -> Derived:
    made = np.empty(len(situation.columns["yaw"]))
    for run in situation.segments:
        made[run] = derivative(smooth(situation.columns["yaw"][run]), situation.period)
    return Derived({"r": made}, "from smoothed yaw")


def lateral_acceleration_of_path(X: np.ndarray, Y: np.ndarray, period: float, segments: list[slice]) -> np.ndarray:
    """Return (X' Y'' - Y' X'')/|v| of a smoothed path [m/s^2], shape (N,): speed times the rate of its course.

    It is across the path; across the car it differs by the sideslip angle times a_x.
    """
    made = np.empty(len(X))
    for run in segments:
        dX, dY = (derivative(smooth(channel[run]), period) for channel in (X, Y))
        turned = dX * derivative(dY, period) - dY * derivative(dX, period)
        made[run] = turned / np.maximum(np.hypot(dX, dY), _SLOWEST)
    return made


def _run_lateral_acceleration_from_path(situation: DerivationInputs) -> Derived:
    c = situation.columns
    made = lateral_acceleration_of_path(c["X"], c["Y"], situation.period, situation.segments)
    return Derived({"ay": made}, "speed times the rate of the course over ground, from smoothed X, Y")


def _run_yaw_rate_from_lateral_acceleration(situation: DerivationInputs) -> Derived:
    name, c = "yaw-rate-from-lateral-acceleration", situation.columns
    vehicle = situation.require_vehicle(name)
    if "r" in c:
        raise MapError(f"--derive {name}: r is recorded", advice="Leave the option out, or r out of the map.")
    given = c, situation.period, situation.segments, vehicle
    made = turning_of_measured_lateral_velocity(*given) if "vy" in c else turning_of_rear_tires(*given)
    known = np.isfinite(made.r)
    parts = {
        f"slower than {vehicle.minimum_speed:.3g} m/s or with an a_y that no car reaches": made.slow,
        f"near or above the peak of the rear tyres, which need {made.most:.0f} N and have D = "
        f"{vehicle.rear_tire.D:.0f} N in the vehicle file": made.beyond,
    }
    shares = [f"{100.0 * share:.0f} % {what}" for what, share in parts.items() if share >= 0.005]
    out = "; ".join(shares or ["the first moments of each run"])
    if not known.any():
        advice = "Check the units of v_x and a_y, and rear_tire of the vehicle file."
        raise MapError(f"--derive {name} finds no row to use: {out}", advice=advice)
    rest = f"; {100.0 * np.mean(~known):.0f} % of the rows left out: {out}" if np.mean(~known) >= 0.005 else ""
    if "vy" in c:
        return Derived(
            {"r": made.r},
            f"{WITHOUT_GYRO} and the change of v_y over v_x{rest}",
            "r is derived from a_y: bias of a_y, bank and roll of the body stay in it, and its label repeats a_y",
        )
    return Derived(
        {"r": made.r, "vy": made.vy},
        f"{WITHOUT_GYRO} {OF_REAR_TIRES}{rest}",
        "r and v_y are derived from a_y, and the rear tyres of the vehicle file are taken as right. The recording "
        "cannot contradict them: their error appears as one of the front axle. So the labels tell whether the car "
        "understeers more or less than the vehicle file says, and nothing of its sideslip. Bias of a_y, bank and roll "
        "of the body stay in r. A gyro (`r`) or a heading (`yaw`) would do without all this",
    )


def _run_acceleration_from_velocity(situation: DerivationInputs) -> Derived:
    c = situation.columns
    made = {"ax": np.empty(len(c["vx"])), "ay": np.empty(len(c["vx"]))}
    for run in situation.segments:
        vx, vy = smooth(c["vx"][run]), smooth(c["vy"][run])
        made["ax"][run] = derivative(vx, situation.period) - vy * c["r"][run]
        made["ay"][run] = derivative(vy, situation.period) + vx * c["r"][run]
    return Derived(
        {name: values for name, values in made.items() if name not in c}, "from smoothed velocity, flat road"
    )


_SLOWEST = 0.1
"""Speed below which a path has no course [m/s]: position noise turns it."""
MOTIONS = (
    Derivation("velocity-from-pose", ("vx", "vy", "r"), ("X", "Y", "yaw"), ("channels",), _run_velocity_from_pose),
    Derivation(
        "longitudinal-velocity-from-wheels",
        ("vx",),
        ("wheel_speed_rl", "wheel_speed_rr"),
        (),
        _run_longitudinal_velocity_from_wheels,
    ),
    Derivation("lateral-velocity-from-sideslip", ("vy",), ("vx", "sideslip"), (), _run_lateral_velocity_from_sideslip),
    Derivation("lateral-velocity-from-straights", ("vy",), ("vx", "vy", "r"), (), _run_lateral_velocity_from_straights),
    Derivation("yaw-rate-from-yaw", ("r",), ("yaw",), (), _run_yaw_rate_from_yaw),
    Derivation("lateral-acceleration-from-path", ("ay",), ("X", "Y"), (), _run_lateral_acceleration_from_path),
    Derivation(
        "yaw-rate-from-lateral-acceleration", ("r", "vy"), ("vx", "ay"), (), _run_yaw_rate_from_lateral_acceleration
    ),
    Derivation(
        "lateral-velocity-from-accelerations", ("vy",), ("vx", "r", "ay"), (), _run_lateral_velocity_from_accelerations
    ),
    Derivation("acceleration-from-velocity", ("ax", "ay"), ("vx", "vy", "r"), (), _run_acceleration_from_velocity),
)
"""In the order in which they run: velocities before what needs them."""
