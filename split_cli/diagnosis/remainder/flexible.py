"""Basis functions of the flexible fit: of operating point, left against right, memory, time and place."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice, product

import numpy as np

from split_cli.diagnosis.baseline.discrepancy import SharedDiscrepancy, scaled_features, spread
from split_cli.diagnosis.innovations.effect_to_noise import windowed
from split_cli.diagnosis.innovations.evidence import Evidence, integrated
from split_cli.diagnosis.parallel import cores, map_in_threads
from split_cli.diagnosis.recording.series import Series
from split_cli.vehicle.effects.recording import first_order_response
from split_cli.vehicle.parameters import Vehicle

#: Time constants of first-order lags [s], from those of servos to those of a body. Judgement.
LAGS = (0.02, 0.06, 0.2, 0.7)
#: Time constants of heating and cooling [s], from those of a tread to those of a brake disc. Judgement.
HEAT_SECONDS = (2.0, 6.0, 20.0)
_HARMONICS = 8  # waves over the track, alone; half as many times slip angle [1]. Judgement.
_KNOTS = 9  # knots of piecewise linear functions of time [1]. Judgement: eight parts of a drive.


@dataclass(frozen=True)
class FlexiblePiece:
    """Rows of a few basis functions of one group on one recording."""

    whitened: np.ndarray  # (G, 3, c)
    windows: np.ndarray  # (G, 3, c): prediction errors over 0.05 s about each row [m/s], [m/s], [rad/s]
    group: str  # such as ``memory``


def flexible_rows(one: Evidence, discrepancy: SharedDiscrepancy) -> Iterator[FlexiblePiece]:
    """Yield the rows of all basis functions, a few at a time, since all of them may exceed the memory."""
    series, vehicle = one.series, one.vehicle
    groups = {
        "operating point": discrepancy.blocks(series),
        "left against right": _asymmetric(series, vehicle),
        "memory": _memory(series, vehicle),
        "time": _time(series, vehicle),
        "place": _place(series, vehicle),
    }

    def piece(asked: tuple[str, np.ndarray]) -> FlexiblePiece:
        group, block = asked
        defects = integrated(series, block, one.linear)
        return FlexiblePiece(one.whitener(defects), windowed(series, defects, one.at), group)

    for group, blocks in groups.items():
        while some := list(islice(blocks, cores())):
            yield from map_in_threads(piece, [(group, block) for block in some])


def rates_by_forces(vehicle: Vehicle) -> np.ndarray:
    """Return the rates by 3 % of an axle's peak force: longitudinal, front and rear lateral, in columns, (3, 3)."""
    return vehicle.force_matrix() * 0.03 * 0.5 * (vehicle.front_tire.D + vehicle.rear_tire.D)


def _asymmetric(series: Series, vehicle: Vehicle) -> Iterator[np.ndarray]:
    """Yield polynomials of the scaled features that break mirror symmetry, and functions of the sign of torque."""
    a, b, c, v = np.clip(scaled_features(series, vehicle), -1.5, 1.5).T
    odd, even = [], []
    for i, j, k, m in product(range(4), range(4), range(3), range(3)):
        if i + j + k + m <= 3:
            (odd if (i + j) % 2 else even).append(a**i * b**j * c**k * v**m)
    even += [np.abs(a), np.abs(b), np.maximum(c, 0.0), np.maximum(-c, 0.0) * np.abs(b)]
    odd += [a * np.maximum(c, 0.0), a * np.maximum(-c, 0.0)]
    return spread([(0, odd), (1, even), (2, even)], rates_by_forces(vehicle))


def _memory(series: Series, vehicle: Vehicle) -> Iterator[np.ndarray]:
    """Yield functions of the past: filtered inputs, heat of work, braking and sliding, and rates of inputs."""
    a, b, c, v = scaled_features(series, vehicle).T
    delta = series.steer_angle / max(float(np.quantile(np.abs(series.steer_angle), 0.99)), 1e-6)
    clock = series.recording
    along, front, rear = [], [], []
    for tau in LAGS:
        late_delta = first_order_response(delta, 1.0 / tau, clock) - delta
        late_torque = first_order_response(c, 1.0 / tau, clock) - c
        along.append(late_torque)
        front.append(late_delta)
        rear.append(first_order_response(b, 1.0 / tau, clock) - b)
    for tau in HEAT_SECONDS:
        work = first_order_response(np.abs(c) * v, 1.0 / tau, clock)
        brake = first_order_response(np.maximum(-c, 0.0) * v, 1.0 / tau, clock)
        slide = first_order_response(a * a + b * b, 1.0 / tau, clock)
        along += [work * c, brake * np.minimum(c, 0.0), brake]
        front += [slide * a, work * a]
        rear += [slide * b, work * b]
    braked = first_order_response(np.maximum(-c, 0.0), 1.0, clock)
    along += [braked, np.gradient(c), np.gradient(delta) * delta]
    front += [braked, np.gradient(delta), np.tanh(np.gradient(delta) / (np.std(np.gradient(delta)) + 1e-12))]
    rear += [braked, np.gradient(b)]
    return spread([(0, along), (1, front), (2, rear)], rates_by_forces(vehicle))


def _time(series: Series, vehicle: Vehicle) -> Iterator[np.ndarray]:
    """Yield piecewise linear functions of time, alone and times torque or slip angle."""
    a, b, c, _ = scaled_features(series, vehicle).T
    position = series.t / max(series.t[-1], 1e-9) * (_KNOTS - 1)
    hats = [np.maximum(0.0, 1.0 - np.abs(position - k)) for k in range(_KNOTS)]
    up, down = np.maximum(c, 0.0), np.minimum(c, 0.0)
    along, front, rear = ([h * f for h in hats for f in some] for some in ((1.0, up, down), (1.0, a), (1.0, b)))
    return spread([(0, along), (1, front), (2, rear)], rates_by_forces(vehicle))


def _place(series: Series, vehicle: Vehicle) -> Iterator[np.ndarray]:
    """Yield harmonics of the track position, alone and times slip angle."""
    a, b, _, _ = scaled_features(series, vehicle).T
    angle = 2.0 * np.pi * series.s / (series.lap_length or max(float(series.s.max()), 1.0))
    waves = [f(k * angle) for k in range(1, _HARMONICS + 1) for f in (np.sin, np.cos)]
    few = waves[: 2 * (_HARMONICS // 2)]
    front, rear = (waves + [w * slip for w in few] for slip in (a, b))
    return spread([(0, waves), (1, front), (2, rear)], rates_by_forces(vehicle))
