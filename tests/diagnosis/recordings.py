"""Recordings of a car that differs from its nominal model by known terms, as evidence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from split_cli.diagnosis.common import build_common_physics
from split_cli.diagnosis.evidence import Evidence, gather_evidence
from split_cli.diagnosis.series import build_series
from split_cli.logs.drive import Drive
from split_cli.vehicle.effects import Term
from tests.factories import make_drive, road_car

#: Standard deviation of a sample of v_x, v_y [m/s] and r [rad/s].
SIGMA = np.array([0.02, 0.02, 0.004])


def recorded(seed: int, terms: Sequence[Term] = (), *, segments: int = 20, seconds: float = 4.0) -> Evidence:
    """Return evidence of runs of some seconds at 100 Hz with white sensor noise, against the nominal car."""
    car = road_car()
    drive = make_drive(seed, segments=segments, seconds=seconds, period=0.01, vehicle=car, terms=terms)
    rng = np.random.default_rng(seed + 100)
    noisy = {
        name: drive[name] + rng.normal(0.0, level, len(drive))
        for name, level in zip(("vx", "vy", "r"), SIGMA, strict=True)
    }
    drive = Drive(drive.name, {**drive.columns, **noisy}, drive.segment, drive.period)
    s = np.concatenate([[0.0], np.cumsum(0.01 * drive["vx"][1:])])
    series = build_series(drive, "real", s)
    return gather_evidence(car, series, build_common_physics(car, series))
