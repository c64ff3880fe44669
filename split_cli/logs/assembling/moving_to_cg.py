"""Sensors that sit off the CG: what they would read at it."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from split_cli.errors import MapError
from split_cli.logs.assembling import transform
from split_cli.logs.assembling.noise import sum_of_noise
from split_cli.logs.assembling.smoothing import derivative
from split_cli.logs.drive import NoiseEstimate
from split_cli.logs.map_entries import ChannelMap, Position
from split_cli.logs.scratch import set_aside
from split_cli.vehicle.parameters import Vehicle


def _place(position: Position, vehicle: Vehicle | None) -> tuple[float, float]:
    if position.axle == "cg":
        return position.x, position.y
    if vehicle is None:
        raise MapError(
            f"a sensor is placed at the {position.axle}, whose distance the vehicle file knows",
            advice="Give it with --vehicle.",
        )
    reach = {"front_axle": vehicle.cg_to_front_axle, "rear_axle": -vehicle.cg_to_rear_axle}[position.axle]
    return position.x + reach, position.y


def move_to_cg(
    columns: dict[str, np.ndarray],
    maps: Mapping[str, ChannelMap],
    vehicle: Vehicle | None,
    period: float,
    slices: list[slice],
    noise: dict[str, NoiseEstimate],
    conversions: list[str],
    *,
    before: bool,
) -> None:
    """Move position (before derivations, which start from it) or velocity and acceleration (after) to the CG."""
    groups = {"X": ("X", "Y")} if before else {"vx": ("vx", "vy"), "ax": ("ax", "ay")}
    for pair in groups.values():
        for axis, channel in enumerate(pair):
            position = maps[channel].position if channel in maps and channel in columns else None
            if position is None:
                continue
            x, y = _place(position, vehicle)
            support = "yaw" if before else "r"
            if support not in columns:
                what = f"{channel} is measured off the CG, and {support} is needed to move it"
                advice = f"Map {support}, or leave out `position` if the sensor is near the CG."
                raise MapError(what, advice=advice)
            shift = _shift(pair, axis, columns, period, slices, x, y)
            columns[channel] = set_aside(columns[channel] + shift)
            conversions.append(f"{channel}: moved from the sensor at x {x:g} m, y {y:g} m to the CG")
            lever = (y, x)[axis]
            if pair[0] == "vx" and {channel, "r"} <= set(noise):
                noise[channel] = sum_of_noise(channel, [noise[channel], _scaled(noise["r"], lever)])


def _shift(
    pair: tuple[str, str],
    axis: int,
    columns: Mapping[str, np.ndarray],
    period: float,
    slices: list[slice],
    x: float,
    y: float,
) -> np.ndarray:
    if pair[0] == "X":
        zero = np.zeros_like(columns["yaw"])
        return transform.position_of_cg(zero, zero, columns["yaw"], x, y)[axis]
    r = columns["r"]
    zero = np.zeros_like(r)
    if pair[0] == "vx":
        return transform.velocity_at_cg(zero, zero, r, x, y)[axis]
    yaw_acceleration = np.empty_like(r)
    for run in slices:
        yaw_acceleration[run] = derivative(r[run], period)
    return transform.acceleration_at_cg(zero, zero, r, yaw_acceleration, x, y)[axis]


def _scaled(estimate: NoiseEstimate, factor: float) -> NoiseEstimate:
    if estimate.sigma is None:
        return estimate if factor else NoiseEstimate(estimate.channel, 0.0, 0.0)
    return replace(estimate, sigma=abs(factor) * estimate.sigma, sigma_raw=abs(factor) * estimate.sigma_raw)
