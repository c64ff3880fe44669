"""A drive whose every channel is known at every instant, and recordings of it with planted faults."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from split_cli.logs.assembling.derived_torque import torque_from_acceleration
from split_cli.logs.map_entries import SignalMap
from split_cli.logs.raw import RawSignal, TableRecording
from split_cli.logs.signal_map import map_from_mapping
from split_cli.signals import CHANNELS
from split_cli.vehicle.parameters import Vehicle
from tests.factories import road_car

#: Columns of a logger's table: the channel, its size in the logger's unit, and that unit.
LOGGED = {"Speed": ("vx", 3.6, "km/h"), "YawRate": ("r", 180.0 / np.pi, "deg/s"), "LatAcc": ("ay", 1.0, "m/s^2")}
UNITS = {name: channel.unit for name, channel in CHANNELS.items() if name != "t"} | {"wheel_speed_fl": "m/s"}


class PlantedDrive:
    """Smooth speed and yaw rate from a few sines; everything else follows from kinematics and linear tyres.

    v_y = l_r r - q v_x^2 r is the steady sideslip of linear rear tyres, delta the single track's steer angle for
    linear front tyres, T what the nominal model needs.
    """

    def __init__(self, vehicle: Vehicle | None = None, seconds: float = 120.0, seed: int = 1, yaw: float = 0.3) -> None:
        self.vehicle = car = vehicle or road_car()
        self.seconds = seconds
        rng = np.random.default_rng(seed)
        t = np.arange(-3.0, seconds + 3.0, 0.002)
        vx, dvx = _sines(rng, t, [0.07, 0.15, 0.31], [3.0, 1.5, 0.5])
        r, dr = _sines(rng, t, [0.05, 0.13, 0.34, 0.6], [0.10, 0.10, 0.06, 0.03])
        # Straights, as every road has: yaw rate is gated by a smooth window that is shut a fifth of the time.
        gate, dgate = _gate(t)
        r, dr = r * gate, dr * gate + r * dgate
        vx = vx + 14.0
        q = car.mass * car.cg_to_front_axle / (car.wheelbase * car.rear_tire.cornering_stiffness)
        vy = car.cg_to_rear_axle * r - q * vx**2 * r
        dvy = car.cg_to_rear_axle * dr - q * (2.0 * vx * dvx * r + vx**2 * dr)
        yaw = CubicSpline(t, r).antiderivative()(t) + yaw
        ax, ay = dvx - vy * r, dvy + vx * r
        force = (car.mass * car.cg_to_rear_axle * ay + car.yaw_inertia * dr) / car.wheelbase
        delta = (vy + car.cg_to_front_axle * r) / vx + force / car.front_tire.cornering_stiffness
        dX, dY = vx * np.cos(yaw) - vy * np.sin(yaw), vx * np.sin(yaw) + vy * np.cos(yaw)
        tracks = {
            "vx": vx,
            "vy": vy,
            "r": r,
            "yaw": yaw,
            "ax": ax,
            "ay": ay,
            "delta": delta,
            "wheel_speed_fl": vx,
            "X": CubicSpline(t, dX).antiderivative()(t),
            "Y": CubicSpline(t, dY).antiderivative()(t),
            "T": torque_from_acceleration(ax, vx, vy, r, delta, car),
        }
        self._splines = {name: CubicSpline(t, values) for name, values in tracks.items()}

    def at(self, channel: str, t: np.ndarray) -> np.ndarray:
        """Return a channel at times t [s], SI."""
        return self._splines[channel](t)

    def recording(
        self,
        channels: tuple[str, ...] = tuple(UNITS),
        *,
        rate: float = 100.0,
        rates: Mapping[str, float] | None = None,
        delays: Mapping[str, float] | None = None,
        noise: Mapping[str, float] | None = None,
        altered: Mapping[str, Callable[[np.ndarray], np.ndarray]] | None = None,
        jitter: float = 0.0,
        seed: int = 7,
    ) -> TableRecording:
        """Return a recording in which each channel has a clock of its own.

        `delays` [s]: a late channel shows at t what was true at t - delay. `altered` is applied to the SI values.
        """
        rng = np.random.default_rng(seed)
        signals = {}
        for channel in channels:
            step = 1.0 / (rates or {}).get(channel, rate)
            time = np.arange(0.0, self.seconds, step)
            time = time + jitter * step * rng.uniform(-0.5, 0.5, len(time))
            values = self.at(channel, time - (delays or {}).get(channel, 0.0))
            values = values + (noise or {}).get(channel, 0.0) * rng.standard_normal(len(time))
            if altered and channel in altered:
                values = altered[channel](values)
            signals[channel] = RawSignal(channel, time, values, UNITS[channel])
        return TableRecording("planted", Path("planted"), signals)


def planted_map(channels: tuple[str, ...] = tuple(UNITS), **over: object) -> SignalMap:
    """Return the map that reads a planted recording; `over` replaces entries or adds map keys."""
    entries: dict[str, object] = {channel: {"source": channel} for channel in channels}
    for name in [name for name in over if name in entries]:
        entries[name] = {**entries[name], **over.pop(name)}  # type: ignore[dict-item]
    return map_from_mapping({"channels": entries, "kinds": {}, **over}, where="planted map")


def _sines(rng, t: np.ndarray, frequencies: list[float], sizes: list[float]) -> tuple[np.ndarray, np.ndarray]:
    value, slope = np.zeros_like(t), np.zeros_like(t)
    for frequency, size in zip(frequencies, sizes, strict=True):
        omega, phase = 2.0 * np.pi * frequency, rng.uniform(0, 2 * np.pi)
        value += size * np.sin(omega * t + phase)
        slope += size * omega * np.cos(omega * t + phase)
    return value, slope


def _gate(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    wave = np.sin(2.0 * np.pi * t / 30.0)
    argument = 12.0 * (wave + 0.8)
    gate = 0.5 * (1.0 + np.tanh(argument))
    slope = 0.5 * 12.0 * (2.0 * np.pi / 30.0) * np.cos(2.0 * np.pi * t / 30.0) / np.cosh(argument) ** 2
    return gate, slope


def write_table(path: Path, columns: Mapping[str, np.ndarray], **how: str) -> None:
    """Write columns by title as CSV; `how` is passed on to NumPy."""
    table = np.stack(list(columns.values()), 1)
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", **how)
