"""What surrounds the car: friction, grade and bank along the road, friction and wind over time."""

from collections import namedtuple
from dataclasses import dataclass, field

import numpy as np

from split_cli.errors import SplitError

_RoadTables = namedtuple("_RoadTables", "spacing closed friction grade bank time_spacing grip wind_x wind_y")


def _one(value: float):
    return field(default_factory=lambda: np.array([value]))


@dataclass(frozen=True)
class Road:
    """Tables that are interpolated linearly; the default is level, dry and without wind."""

    spacing: float = 1.0  # distance between the entries over place, from s = 0 [m]
    closed: bool = False  # whether the tables over place repeat (a lap must be a whole number of spacings)
    # friction, grade, bank: (P,): friction against the tyres' own peak [1]; grade along the car, uphill positive
    # [rad]; bank across it, left side higher positive [rad].
    friction: np.ndarray = _one(1.0)
    grade: np.ndarray = _one(0.0)
    bank: np.ndarray = _one(0.0)
    time_spacing: float = 1.0  # time between the entries over time, from t = 0 [s]
    # grip, wind_x, wind_y: (Q,): a factor on friction [1]; velocity of the air in the world's X and Y [m/s].
    grip: np.ndarray = _one(1.0)
    wind_x: np.ndarray = _one(0.0)
    wind_y: np.ndarray = _one(0.0)

    def __post_init__(self) -> None:
        for name in ("friction", "grade", "bank", "grip", "wind_x", "wind_y"):
            table = np.asarray(getattr(self, name))
            if table.ndim != 1 or len(table) == 0 or not np.isfinite(table).all():
                raise SplitError(f"road table {name} must be a row of finite numbers, got {table!r}")
        if min(np.min(self.friction), np.min(self.grip)) <= 0:
            raise SplitError("road friction must be above 0")

    def tables(self) -> _RoadTables:
        """Return the tables as compiled code takes them."""
        return _RoadTables(
            float(self.spacing),
            float(self.closed),
            *(np.ascontiguousarray(getattr(self, n), dtype=float) for n in ("friction", "grade", "bank")),
            float(self.time_spacing),
            *(np.ascontiguousarray(getattr(self, n), dtype=float) for n in ("grip", "wind_x", "wind_y")),
        )
