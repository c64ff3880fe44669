"""Drivers: how fast they think a track can be driven, and how they hold the car on it.

A driver steers the road's own curvature a moment ahead and an arc that leads back to the line, corrected for
understeer and for the yaw rate that comes out; steers no further than the front tyres' grip; follows a speed
profile with feed-forward torque; and eases off when wheels slip. Seeded wander of line, pace, hand and foot makes
laps and drivers differ.
"""

from collections import namedtuple
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from split_cli.errors import SplitError, nearest_names
from split_cli.plant.cars import CarParameters
from split_cli.plant.tire import tire_force
from split_cli.plant.tracks import Track
from split_cli.signals import STANDARD_GRAVITY

_DriverTables = namedtuple(
    "_DriverTables",
    "preview_time turn_in_time slip_difference lateral_spacing downforce calm_speed yaw_gain slip_angle_limit "
    "rear_angle_limit slip_ratio_limit speed_gain speed_preview steer_rate torque_rate",
)
_PlanTables = namedtuple("_PlanTables", "spacing line_offset speed_scale steer_noise torque_noise")


@dataclass(frozen=True)
class DriverStyle:
    """How somebody drives. Times are for a full-size car and shrink with the square root of the wheelbase."""

    name: str
    preview_time: float = 1.1  # within which the driver means to be back on the line [s]
    # Exponent p of (a_x/a_x,max)^p + (a_y/a_y,max)^p <= 1: 1 brakes before and accelerates after the corner, 2
    # brakes into it and accelerates out of it along the friction ellipse [1].
    overlap: float = 1.6
    # braking, driving: share of the car's braking and driving ability that is used, before aggressiveness [1].
    braking: float = 0.9
    driving: float = 0.9
    # Standard deviation of the distance from the centreline, as a share of the track's half width [1].
    line_wander: float = 0.15
    pace_wander: float = 0.015  # standard deviation of the pace along the lap [1]
    steer_noise: float = 0.0015  # standard deviation of the hand's unrest at the road wheels [rad]
    torque_noise: float = 0.05  # standard deviation of the foot's unrest as a share of the torque [1]
    pedal_time: float = 0.30  # time from no to full torque [s]


DRIVER_STYLES = {
    style.name: style
    for style in (
        DriverStyle("smooth", preview_time=1.3, overlap=1.3, braking=0.75, driving=0.8, pedal_time=0.5),
        DriverStyle("brisk"),
        DriverStyle(
            "racer",
            preview_time=1.0,
            overlap=2.0,
            braking=1.0,
            driving=1.0,
            line_wander=0.10,
            pace_wander=0.01,
            pedal_time=0.18,
        ),
        DriverStyle(
            "novice",
            preview_time=1.1,
            overlap=1.1,
            braking=0.85,
            driving=0.7,
            line_wander=0.22,
            pace_wander=0.04,
            steer_noise=0.004,
            torque_noise=0.15,
        ),
    )
}


def find_driver(name: str) -> DriverStyle:
    """Return the driver style called `name`.

    Raises
    ------
    SplitError
        If there is none; names the nearest.
    """
    if name not in DRIVER_STYLES:
        advice = nearest_names(name, DRIVER_STYLES)
        raise SplitError(f"no driver is called {name!r}", where="--driver", advice=advice)
    return DRIVER_STYLES[name]


@dataclass(frozen=True)
class Grip:
    """What the car can do, as a driver would learn it on a dry level road."""

    # lateral, braking, driving: greatest specific forces [m/s^2].
    lateral: float
    braking: float
    driving: float
    downforce: float  # relative gain of all three with speed squared [1/(m/s)^2]
    # Slip angle at which a tyre's lateral force is greatest at its static load, at most 0.25 [rad].
    slip_angle: float
    # (K,): alpha_f - alpha_r of a steady turn at lateral specific forces 0, spacing, 2 spacing ... [rad].
    slip_difference: np.ndarray
    lateral_spacing: float  # [m/s^2]


@lru_cache(maxsize=64)
def grip_of(car: CarParameters) -> Grip:
    """Return what a car can do on a dry road: the axle that saturates first decides, with load transfer."""
    angles = np.linspace(0.0, 0.25, 101)
    roll_axis = (
        car.cg_to_rear_axle * car.roll_center_front + car.cg_to_front_axle * car.roll_center_rear
    ) / car.wheelbase
    spacing = 0.02 * STANDARD_GRAVITY
    differences = [0.0]
    while len(differences) < 200:
        trial = len(differences) * spacing
        needed = []
        for static, share, height, track, tire in (
            (
                car.static_load_front,
                car.roll_stiffness_front_share,
                car.roll_center_front,
                car.track_front,
                car.front_tire,
            ),
            (
                car.static_load_rear,
                1 - car.roll_stiffness_front_share,
                car.roll_center_rear,
                car.track_rear,
                car.rear_tire,
            ),
        ):
            part = static / (car.mass * STANDARD_GRAVITY)
            moment = car.mass * trial * (part * height + share * (car.cg_height - roll_axis))
            shift = min(moment / track, 0.5 * static)
            loads = np.array([[0.5 * static - shift], [0.5 * static + shift]])
            force = tire_force(tire, 0.0, angles, loads)[1].sum(axis=0)
            peak = int(np.argmax(force))
            if force[peak] < trial * static / STANDARD_GRAVITY:
                break
            needed.append(np.interp(trial * static / STANDARD_GRAVITY, force[: peak + 1], angles[: peak + 1]))
        if len(needed) < 2:
            break
        differences.append(float(needed[0] - needed[1]))
    peak_angle = max(
        angles[np.argmax(tire_force(tire, 0.0, angles, static / 2)[1])]
        for tire, static in ((car.front_tire, car.static_load_front), (car.rear_tire, car.static_load_rear))
    )
    area = car.downforce_area_front + car.downforce_area_rear
    downforce = 0.5 * car.air_density * area / (car.mass * STANDARD_GRAVITY)
    return Grip(
        lateral=float((len(differences) - 1) * spacing),
        braking=_longitudinal(car, -1.0, car.brake_split_front),
        driving=_longitudinal(car, 1.0, car.drive_split_front),
        downforce=float(max(downforce, 0.0)),
        slip_angle=float(peak_angle),
        slip_difference=np.array(differences),
        lateral_spacing=spacing,
    )


def _longitudinal(car: CarParameters, sign: float, split: float) -> float:
    """Return the specific force at which the first axle runs out of grip [m/s^2]."""
    slips = sign * np.linspace(0.01, 0.3, 59)
    best = 0.0
    for trial in np.linspace(0.1, 2.5, 97) * STANDARD_GRAVITY:
        shift = sign * car.mass * trial * car.cg_height / car.wheelbase
        front = max(car.static_load_front - shift, 0.0)
        rear = max(car.static_load_rear + shift, 0.0)
        for load, part, tire in ((front, split, car.front_tire), (rear, 1.0 - split, car.rear_tire)):
            force = 2.0 * np.abs(tire_force(tire, slips, 0.0, 0.5 * load)[0]).max()
            if part * car.mass * trial > force:
                return float(best)
        best = trial
    return float(best)


@dataclass(frozen=True)
class SpeedProfile:
    """Speed [m/s] and its longitudinal acceleration [m/s^2] at the track's samples, each shape (N,)."""

    speed: np.ndarray
    acceleration: np.ndarray


def speed_profile(
    car: CarParameters, track: Track, style: DriverStyle, aggressiveness: float, grip: Grip | None = None
) -> SpeedProfile:
    """Return the speed at which a driver means to go round.

    Parameters
    ----------
    aggressiveness : float
        Share of the car's grip that is used, above 0 to 1 [1].
    grip : Grip, optional
        What the driver believes the car can do; `grip_of` the car by default.

    Notes
    -----
    Corner speed from curvature, then one pass against travel for braking and one along it for driving, each
    limited by (a_x/a_x,max)^p + (a_y/a_y,max)^p <= 1, both run twice round so that the lap closes.
    """
    grip = grip or grip_of(car)
    count = len(track.x)
    lateral = aggressiveness * grip.lateral
    bend = _smooth_periodic(np.abs(track.curvature), max(1, int(1.0 * car.wheelbase / track.spacing)))
    bend = np.maximum(bend, 0.0)  # smoothing by Fourier sums leaves -1e-12 on straights
    # v^2 kappa <= a (1 + c v^2), solved for v; where wings outgrow the curve there is no limit.
    denominator = np.maximum(bend - lateral * grip.downforce, 1e-6)
    top = 0.95 * (car.max_power / (0.5 * car.air_density * car.drag_area)) ** (1.0 / 3.0)
    corner = np.minimum(np.sqrt(lateral / denominator), top)

    def forward(speed: float, curvature: float, most: float, limit: float) -> float:
        gain = 1.0 + grip.downforce * speed**2
        used = min(speed**2 * curvature / (lateral * gain), 1.0)
        return min(most * gain, limit) * (1.0 - used**style.overlap) ** (1.0 / style.overlap)

    speed = corner.copy()
    braking = aggressiveness * style.braking * min(grip.braking, car.max_brake_torque / car.wheel_radius / car.mass)
    for i in range(2 * count, 0, -1):
        here, before = i % count, (i - 1) % count
        ability = forward(speed[here], bend[here], braking, np.inf)
        speed[before] = min(speed[before], np.sqrt(speed[here] ** 2 + 2.0 * ability * track.spacing))
    driving = aggressiveness * style.driving * grip.driving
    for i in range(2 * count):
        here, after = i % count, (i + 1) % count
        drag = 0.5 * car.air_density * car.drag_area * speed[here] ** 2 / car.mass
        push = min(car.max_torque / car.wheel_radius, car.max_power / max(speed[here], 1.0)) / car.mass - drag
        ability = forward(speed[here], bend[here], driving, aggressiveness * style.driving * push)
        speed[after] = min(speed[after], np.sqrt(max(speed[here] ** 2 + 2.0 * ability * track.spacing, 1.0)))
    window = max(1, int(0.15 * speed.mean() / track.spacing))
    speed = _smooth_periodic(speed, window)
    slope = (np.roll(speed, -1) - np.roll(speed, 1)) / (2.0 * track.spacing)
    return SpeedProfile(speed=speed, acceleration=speed * slope)


def _smooth_periodic(values: np.ndarray, window: int) -> np.ndarray:
    """Return a periodic Gaussian average with a standard deviation of `window` samples."""
    waves = np.fft.rfftfreq(len(values)) * 2.0 * np.pi
    return np.fft.irfft(np.fft.rfft(values) * np.exp(-0.5 * (waves * window) ** 2), len(values))


def wander(rng: np.random.Generator, count: int, correlation: float, deviation: float) -> np.ndarray:
    """Return smooth random values, shape (count,), of a standard deviation and a correlation length in samples."""
    margin = int(4 * correlation) + 1
    white = rng.standard_normal(count + 2 * margin)
    lags = np.arange(-margin, margin + 1)
    kernel = np.exp(-0.5 * (lags / correlation) ** 2)
    smooth = np.convolve(white, kernel / np.sqrt(np.sum(kernel**2)), mode="same")
    return deviation * np.clip(smooth[margin : margin + count], -2.5, 2.5)


def driver_tables(car: CarParameters, style: DriverStyle, grip: Grip) -> _DriverTables:
    """Return a driver's constants as compiled code takes them."""
    pace = np.sqrt(car.wheelbase / 2.7)
    return _DriverTables(
        preview_time=float(style.preview_time * pace),
        turn_in_time=float(car.steer_lag + 0.12 * pace),
        slip_difference=grip.slip_difference,
        lateral_spacing=grip.lateral_spacing,
        downforce=grip.downforce,
        calm_speed=float(20.0 * pace),
        yaw_gain=0.3,
        slip_angle_limit=min(grip.slip_angle, 0.20),
        rear_angle_limit=min(0.75 * grip.slip_angle, 0.15),
        slip_ratio_limit=0.10,
        speed_gain=float(1.2 / pace),
        speed_preview=float(car.drive_lag + 0.05 * pace),
        steer_rate=car.steer_rate,
        torque_rate=float(car.max_brake_torque / (style.pedal_time * pace)),
    )


def driver_plan(
    car: CarParameters, style: DriverStyle, half_width: float, distance: float, steps: int, period: float, seed: int
) -> _PlanTables:
    """Return a driver's seeded unrest: over distance for line and pace, over time for hand and foot."""
    rng = np.random.default_rng([seed, 1])
    size = car.wheelbase / 2.7
    spacing = 2.0 * size
    places = int(distance / spacing) + 50
    pace = np.sqrt(size)
    from_the_centre = np.minimum(1.0, np.arange(places) / 60.0)  # where every drive starts
    return _PlanTables(
        spacing=float(spacing),
        line_offset=from_the_centre * wander(rng, places, 45.0, style.line_wander * half_width),
        speed_scale=1.0 - np.abs(wander(rng, places, 40.0, style.pace_wander)),
        steer_noise=wander(rng, steps, 0.25 * pace / period, style.steer_noise),
        torque_noise=wander(rng, steps, 0.30 * pace / period, style.torque_noise),
    )


def varied(style: DriverStyle, seed: int) -> DriverStyle:
    """Return a person of that style: preview, overlap, pedals and unrest differ by some per cent with the seed."""
    rng = np.random.default_rng([seed, 2])
    factor = np.exp(0.08 * rng.standard_normal(6))
    return replace(
        style,
        preview_time=style.preview_time * float(np.clip(factor[0], 0.85, 1.15)),
        overlap=max(1.0, min(2.0, style.overlap * float(factor[1]))),
        braking=min(1.0, style.braking * float(factor[2])),
        driving=min(1.0, style.driving * float(factor[3])),
        line_wander=style.line_wander * float(factor[4]),
        pedal_time=style.pedal_time * float(factor[5]),
    )
