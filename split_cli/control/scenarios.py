"""Manoeuvres between cones: ISO 3888-1, ISO 3888-2, and braking while avoiding."""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from split_cli.control.path import Path, resampled
from split_cli.errors import SplitError, nearest_names

CONE_RADIUS = 0.15
"""Of a cone's base on a course of full size [m]; cones touch the lane's border from outside."""

APPROACH = 40.0
"""Straight before the first cone [m], on which controller and tyres settle."""

_FREE = 30.0


@dataclass(frozen=True)
class Lane:
    """A stretch with cones on both sides."""

    # begin, end: along the track, 0 at the first cone [m].
    begin: float
    end: float
    # right, width: right border across the track, left positive, and distance to the left one [m].
    right: float
    width: float

    @property
    def middle(self) -> float:
        """Across the track [m]."""
        return self.right + 0.5 * self.width


@dataclass(frozen=True)
class Scenario:
    """A manoeuvre ready to be driven."""

    name: str
    path: Path  # the line to track, open, its borders those of the lanes where `borders`, far away elsewhere
    lanes: tuple[Lane, ...]
    cones: np.ndarray  # (K, 2): centres [m]
    # entry_speed, exit_speed: wanted up to the first cone and at the last lane [m/s].
    entry_speed: float
    exit_speed: float
    # brake_begin, brake_end: arc length between which the speed falls [m]; equal when it does not.
    brake_begin: float
    brake_end: float
    horizon: int
    step: float  # [s]
    # steering_alone, borders: whether torque is left to a speed controller, and whether lanes are constraints of
    # the controller.
    steering_alone: bool
    borders: bool
    finish: float  # arc length of the end [m]
    scale: float = 1.0  # of all lengths, against the course for full-size cars [1]

    def speed(self, s: np.ndarray) -> np.ndarray:
        """Return the wanted speed [m/s] at arc lengths [m]: constant deceleration between its two places."""
        if self.brake_end <= self.brake_begin:
            return np.full(np.shape(s), self.entry_speed)
        share = np.clip((np.asarray(s) - self.brake_begin) / (self.brake_end - self.brake_begin), 0.0, 1.0)
        return np.sqrt(self.entry_speed**2 + share * (self.exit_speed**2 - self.entry_speed**2))


def _iso_3888_1(width: float) -> tuple[Lane, ...]:
    entry, side, leave = 1.1 * width + 0.25, 1.2 * width + 0.25, 1.3 * width + 0.25
    right = -0.5 * entry
    return (Lane(0.0, 15.0, right, entry), Lane(45.0, 70.0, right + 3.5, side), Lane(95.0, 125.0, right, leave))


def _iso_3888_2(width: float) -> tuple[Lane, ...]:
    entry, side, leave = 1.1 * width + 0.25, width + 1.0, max(1.3 * width + 0.25, 3.0)
    right = -0.5 * entry
    return (Lane(0.0, 12.0, right, entry), Lane(25.5, 36.5, right + entry + 1.0, side), Lane(49.0, 61.0, right, leave))


def _brake_avoid(width: float) -> tuple[Lane, ...]:
    entry, side = 1.1 * width + 0.25, 1.2 * width + 0.25
    right = -0.5 * entry
    return (Lane(0.0, 12.0, right, entry), Lane(32.0, 47.0, right + 3.5, side))


SCENARIOS = {
    "iso3888-1": (_iso_3888_1, 14.0, 50, True, False, 5.0),
    "iso3888-2": (_iso_3888_2, 10.0, 50, True, True, 3.0),
    "brake-avoid": (_brake_avoid, 14.0, 25, False, True, 3.0),
}
"""Lanes; entry speed [m/s]; horizon; steering alone; lanes as constraints; distance between cones [m]."""


def build_scenario(name: str, width: float, speed: float | None = None, scale: float = 1.0) -> Scenario:
    """Return the manoeuvre called `name` for a car of `width` [m], entered at `speed` [m/s].

    A `scale` [1] other than 1 multiplies all lengths of the course, times and usual speeds going with its root.

    Raises
    ------
    SplitError
        If there is no such manoeuvre, or width or speed make no sense.

    Notes
    -----
    Lengths and offsets are those of the SPLIT paper's table of scenarios; widths follow from the car's by the
    rules of ISO 3888 that give the table's numbers at 1.6 m: 1.1 w + 0.25, 1.2 w + 0.25, 1.3 w + 0.25 m of part 1;
    1.1 w + 0.25, w + 1 and max(1.3 w + 0.25, 3) m of part 2, whose lanes are 1 m apart. Offsets are between right
    borders: with the table's 3.01 m part 2 then has its 1 m. The table has no lanes for braking while avoiding:
    here an entry lane, 20 m in which to brake from 14 to 5 m/s (other speeds: in proportion) and to move by 3.5 m,
    and an exit lane.

    A scaled course asks for the same accelerations as the full one (Froude): a car whose size, tyres and reactions
    are scaled so drives the same line in it.
    """
    if name not in SCENARIOS:
        raise SplitError(f"no manoeuvre is called {name!r}", advice=nearest_names(name, SCENARIOS))
    if not 0.1 < width < 4.0:
        raise SplitError(f"a car {width:g} m wide was named, 0.1 to 4 m was expected", where="--width")
    if not 0.05 <= scale <= 10.0:
        raise SplitError(f"is {scale:g}, a scale of 0.05 to 10 was expected", where="--scale")
    lanes_of, usual, horizon, alone, borders, spacing = SCENARIOS[name]
    speed = round(usual * sqrt(scale), 1) if speed is None else speed
    if not 1.0 <= speed <= 60.0:
        raise SplitError(f"an entry speed of 1 to 60 m/s was expected, got {speed:g} m/s", where="--speed")
    lanes = lanes_of(width / scale)
    path = _line(name, lanes, borders, scale)
    lanes = tuple(Lane(*(scale * np.array([lane.begin, lane.end, lane.right, lane.width]))) for lane in lanes)
    braking = name == "brake-avoid"
    begin = scale * APPROACH + lanes[0].end
    return Scenario(
        name=name,
        path=path,
        lanes=lanes,
        cones=_cones(lanes, scale * spacing, scale * CONE_RADIUS),
        entry_speed=speed,
        exit_speed=speed * 5.0 / 14.0 if braking else speed,
        brake_begin=begin,
        brake_end=begin + 20.0 * scale if braking else begin,
        horizon=horizon,
        step=round(0.04 * sqrt(scale), 2),
        steering_alone=alone,
        borders=borders,
        finish=lanes[-1].end + scale * (APPROACH + 5.0),
        scale=scale,
    )


def _line(name: str, lanes: tuple[Lane, ...], borders: bool, scale: float) -> Path:
    """Return the middle of the full-size lanes, scaled, joined by curves that begin and end without curvature."""
    x = np.arange(-APPROACH, lanes[-1].end + 80.0, 0.25)
    y = np.full(len(x), lanes[0].middle)
    for before, after in zip(lanes[:-1], lanes[1:], strict=True):
        share = np.clip((x - before.end) / (after.begin - before.end), 0.0, 1.0)
        blend = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        y = np.where(x > before.end, before.middle + blend * (after.middle - before.middle), y)
    left, right = np.full(len(x), _FREE), np.full(len(x), _FREE)
    if borders:
        for lane in lanes:
            inside = (x >= lane.begin - 0.5) & (x <= lane.end + 0.5)
            left[inside], right[inside] = (lane.right + lane.width - y)[inside], (y - lane.right)[inside]
    points = scale * np.stack([x, y], axis=1)
    return resampled(name, points, scale * left, scale * right, closed=False, spacing=0.25 * scale)


def _cones(lanes: tuple[Lane, ...], spacing: float, radius: float) -> np.ndarray:
    """Return pairs of cones from the begin to the end of every lane."""
    centres = []
    for lane in lanes:
        count = int(np.ceil((lane.end - lane.begin) / spacing - 1e-9)) + 1
        for x in np.linspace(lane.begin, lane.end, count):
            centres.append((x, lane.right - radius))
            centres.append((x, lane.right + lane.width + radius))
    return np.array(centres)


def cones_hit(
    cones: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    yaw: np.ndarray,
    front: float,
    rear: float,
    width: float,
    radius: float = CONE_RADIUS,
) -> np.ndarray:
    """Return which cones a moving rectangle touches, bool shape (K,).

    Parameters
    ----------
    cones : ndarray, shape (K, 2)
        Centres [m].
    x, y, yaw : ndarray, shape (N,)
        Of the CG [m], [m], [rad].
    front, rear : float
        From the CG to the bumpers, both positive [m].
    width : float
        Of the body [m].
    radius : float
        Of a cone's base [m].
    """
    dx, dy = cones[:, 0][None] - x[:, None], cones[:, 1][None] - y[:, None]
    sine, cosine = np.sin(yaw)[:, None], np.cos(yaw)[:, None]
    along, across = dx * cosine + dy * sine, -dx * sine + dy * cosine
    out_along = np.maximum(np.maximum(along - front, -rear - along), 0.0)
    out_across = np.maximum(np.abs(across) - 0.5 * width, 0.0)
    # A gap that rounding alone makes smaller than the radius is no hit.
    return (np.hypot(out_along, out_across) < radius - 1e-9).any(axis=0)
