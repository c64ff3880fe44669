"""Where the search for each term starts, how far it may go, and what one step is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from split_cli.diagnosis.baseline.common import natural_unit
from split_cli.diagnosis.recording.series import Series
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.parameters import Vehicle

__all__ = ["Candidate", "Range", "build_candidates"]

_ENDS_IN_NATURE = ("drag", "force")  # no car pushes itself: all there is may be taken off
_WIDE = (1.0, 4.0, 12.0, -1.0, -4.0, -12.0)


@dataclass(frozen=True)
class Range:
    """Of one parameter: bounds and the step its derivative is taken with, all in its unit."""

    lower: float
    upper: float
    step: float


@dataclass(frozen=True)
class Candidate:
    """One term, in one variant, with where to look for its parameters.

    Attributes
    ----------
    term, variant : str
    ranges : mapping of str to Range
    starts : tuple of mapping of str to float
        Several where the cost has several valleys.
    located : bool
        Whether start and end along the track, or a wavelength, have to be scanned for.
    complexity : float
        Parameters that were effectively searched for; a place counts more than a scale.
    """

    term: str
    variant: str
    ranges: Mapping[str, Range]
    starts: tuple[Mapping[str, float], ...]
    located: str = ""
    complexity: float = 1.0

    def build(self, values: Mapping[str, float]) -> Term:
        """Return the term with values held inside their bounds."""
        inside = {
            name: float(np.clip(values[name], limit.lower, limit.upper)) for name, limit in self.ranges.items()
        }
        return CATALOGUE[self.term](inside, self.variant)

    def everywhere(self) -> tuple[Term, float]:
        """Return a located term that acts all along the road, and by how much its size differs from none."""
        kind = CATALOGUE[self.term]
        if self.located == "patch":
            return kind({"scale": 0.97, "s_start": 0.0, "s_end": 1e12}, self.variant), -0.03
        return kind({"angle": 0.005}, ""), 0.005

    def widely_started(self) -> Candidate:
        """Return the candidate with starts to both sides and up to a dozen times as far, if it has but one."""
        if len(self.starts) != 1:
            return self
        (start,) = self.starts
        wide = [self.moved(start, factor) for factor in _WIDE]
        return replace(self, starts=tuple(one for one in wide if self.allows(one)))

    def moved(self, start: Mapping[str, float], factor: float) -> dict[str, float]:
        """Return a start so many times as far from no effect; what no effect leaves open stays."""
        neutral = CATALOGUE[self.term].neutral
        return {
            name: value if neutral.get(name) is None else neutral[name] + factor * (value - neutral[name])
            for name, value in start.items()
        }

    def allows(self, values: Mapping[str, float]) -> bool:
        """Return whether values are inside the ranges."""
        return all(limit.lower <= values[name] <= limit.upper for name, limit in self.ranges.items())

    def at_limit(self, values: Mapping[str, float]) -> bool:
        """Return whether the size of a value is where the search ends: it wants more than makes sense."""
        neutral, reach = CATALOGUE[self.term].neutral, 0.1
        return any(
            values[name] >= limit.upper - reach * limit.step or values[name] <= limit.lower + reach * limit.step
            for name, limit in self.ranges.items()
            if neutral.get(name) is not None and name not in _ENDS_IN_NATURE
            and abs(values[name] - neutral[name]) > reach * limit.step
        )  # fmt: skip

    @property
    def label(self) -> str:
        """``term`` or ``term (variant)``."""
        return f"{self.term} ({self.variant})" if self.variant else self.term


def build_candidates(vehicle: Vehicle, series: Series) -> list[Candidate]:
    """Return every term and variant that makes sense for a vehicle and a recording."""
    duration = max(float(series.t[-1]), 1.0)
    reach = series.lap_length or float(series.s.max())
    tables = _tables(vehicle, duration, reach)
    out = []
    for (term, variant), (ranges, starts, located, complexity) in tables.items():
        scaled = {
            name: Range(*(value * natural_unit(vehicle, term, name) for value in limits))
            for name, limits in ranges.items()
        }
        begin = tuple(
            {name: value * natural_unit(vehicle, term, name) for name, value in start.items()} for start in starts
        )
        if term == "wind" and vehicle.drag_coefficient == 0.0:
            continue
        out.append(Candidate(term, variant, scaled, begin, located, complexity or float(len(ranges))))
    return out


def _tables(vehicle: Vehicle, duration: float, reach: float) -> dict:
    """Limits are (lower, upper, step) in natural units; see `natural_unit`."""
    scale = (0.3, 2.0, 0.01)
    least_drag = vehicle.drag_coefficient / natural_unit(vehicle, "aero_drag", "drag")
    rolling = vehicle.rolling_resistance_front + vehicle.rolling_resistance_rear
    least_force = rolling / natural_unit(vehicle, "rolling_resistance", "force")
    place = (0.0, reach, 0.002 * reach)
    patch = {"scale": (0.25, 2.0, 0.01), "s_start": place, "s_end": place}
    fade = {"final_loss": (-0.9, 0.9, 0.01), "tau": (0.02 * duration, 10.0 * duration, 0.02 * duration)}
    fade_starts = [{"final_loss": 0.05, "tau": share * duration} for share in (0.1, 0.3, 1.0)]
    wave = {
        "amplitude": (-0.4, 0.4, 0.001),
        "wavelength": (0.03 * reach, 4.0 * reach, 0.002 * reach),
        "phase": (-40.0, 40.0, 0.02),
    }
    stretch = {"angle": (-0.4, 0.4, 0.001), "s_start": place, "s_end": place}
    # What is late by ten times as much promises nothing, so starts stand close.
    delay = {"delay": (0.0, 0.6, 0.001)}
    delay_starts = [{"delay": value} for value in (0.001, 0.004, 0.015, 0.045, 0.13)]
    lag = {"tau": (0.0, 1.0, 0.001)}
    lag_starts = [{"tau": value} for value in (0.001, 0.004, 0.015, 0.05, 0.16)]
    tables = {
        ("combined_slip", ""): ({"strength": (0.0, 4.0, 0.02)}, [{"strength": 0.3}]),
        ("grip_fade", ""): (fade, fade_starts),
        ("grip_fade", "curve"): (fade, fade_starts),
        ("tire_relaxation", ""): ({"length": (0.0, 5.0, 0.02)}, [{"length": v} for v in (0.1, 0.5, 1.5)]),
        ("tire_stiffness", ""): (
            {"front_scale": (0.3, 3.0, 0.01), "rear_scale": (0.3, 3.0, 0.01)},
            [{"front_scale": 0.97, "rear_scale": 0.97}],
        ),
        # No car pushes itself: what is taken off is at most what the nominal has.
        ("aero_drag", ""): ({"drag": (-least_drag, 10.0, 0.01)}, [{"drag": 0.1}]),
        ("rolling_resistance", ""): ({"force": (-least_force, 0.3, 0.001)}, [{"force": 0.005}]),
        ("road_grade", "wave"): (wave, [], "wave", 6.0),
        ("road_grade", "stretch"): (stretch, [], "stretch", 6.0),
        ("road_bank", ""): ({"angle": (-0.4, 0.4, 0.001)}, [{"angle": 0.005}]),
        ("road_bank", "wave"): (wave, [], "wave", 6.0),
        ("road_bank", "stretch"): (stretch, [], "stretch", 6.0),
        ("drive_delay", ""): (delay, delay_starts),
        ("drive_gain", ""): (
            {"drive_gain": (0.2, 3.0, 0.01), "brake_gain": (0.2, 3.0, 0.01)},
            [{"drive_gain": 0.97, "brake_gain": 0.97}],
        ),
        ("drive_lag", ""): (lag, lag_starts),
        ("steer_backlash", ""): (
            {"width": (0.0, 0.15, 0.0001)},
            [{"width": value} for value in (0.0003, 0.001, 0.003, 0.01, 0.03)],
        ),
        ("steer_delay", ""): (delay, delay_starts),
        ("steer_gain", ""): ({"gain": (0.4, 2.0, 0.005)}, [{"gain": 0.98}]),
        ("steer_lag", ""): (lag, lag_starts),
        ("steer_offset", ""): ({"offset": (-0.15, 0.15, 0.0005)}, [{"offset": 0.002}]),
        ("yaw_inertia", ""): ({"scale": (0.3, 3.0, 0.01)}, [{"scale": 1.03}]),
        ("sensor_delay", ""): (delay, delay_starts),
        ("sensor_lever_arm", ""): ({"dx": (-1.0, 1.0, 0.002)}, [{"dx": 0.02}]),
        ("sensor_misalignment", ""): ({"angle": (-0.3, 0.3, 0.0005)}, [{"angle": 0.003}]),
    }
    for variant in ("", "curve"):
        tables["friction_scale", variant] = ({"scale": scale}, [{"scale": 0.97}])
        tables["friction_patch", variant] = (patch, [], "patch", 6.0)
    for variant in ("", "peak", "degressive"):
        tables["load_transfer", variant] = ({"cg_height": (0.0, 1.0, 0.005)}, [{"cg_height": 0.05}])
        limits = (-2.0, 5.0, 0.02)
        tables["aero_downforce", variant] = ({"front": limits, "rear": limits}, [{"front": 0.1, "rear": 0.1}])
    for variant in ("", "loaded", "degressive"):
        tables["mass", variant] = ({"scale": (0.4, 2.5, 0.01)}, [{"scale": 1.03}])
        tables["cg_shift", variant] = ({"dx": (-0.3, 0.3, 0.002)}, [{"dx": 0.005}])
    for variant in ("", "driven"):
        damping = {"yaw_damping": (0.0, 5.0, 0.01)}
        tables["yaw_moment_differential", variant] = (damping, [{"yaw_damping": 0.05}])
    for variant in ("", "side", "broadside"):
        tables["wind", variant] = ({"wx": (-2.0, 2.0, 0.01), "wy": (-2.0, 2.0, 0.01)}, [{"wx": 0.1, "wy": 0.1}])
    return {key: (*entry, *("", 0.0)[len(entry) - 2 :]) for key, entry in tables.items()}
