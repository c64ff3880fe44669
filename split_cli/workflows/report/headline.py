"""A finding as a headline: the part of the car first, then by how much; never what is as it should be."""

import math
from collections.abc import Sequence

from split_cli.diagnosis.statement.result import Finding, ParameterEstimate
from split_cli.diagnosis.statement.wording import number
from split_cli.vehicle.effects import CATALOGUE
from split_cli.workflows.report.words import term_title

#: Parameters that are factors: the part of the car, and the words for above and below 1.
_FACTORS = {
    ("drive_gain", "drive_gain"): ("Drive torque", "strong", "weak"),
    ("drive_gain", "brake_gain"): ("Brakes", "strong", "weak"),
    ("steer_gain", "gain"): ("Steering", "more than commanded", "less than commanded"),
    ("mass", "scale"): ("Mass", "more", "less"),
    ("yaw_inertia", "scale"): ("Yaw inertia", "more", "less"),
    ("friction_scale", "scale"): ("Tyre grip", "more", "less"),
    ("friction_scale/front", "scale"): ("Grip of the front tyres", "more", "less"),
    ("friction_scale/rear", "scale"): ("Grip of the rear tyres", "more", "less"),
    ("friction_patch", "scale"): ("Grip on one stretch", "more", "less"),
    ("tire_stiffness", "front_scale"): ("Front tyres", "stiffer", "softer"),
    ("tire_stiffness", "rear_scale"): ("Rear tyres", "stiffer", "softer"),
    ("speed_scale", "scale"): ("Speed sensor", "high", "low"),
    ("yaw_rate_scale", "scale"): ("Yaw rate sensor", "high", "low"),
}
#: The part of the car where a term's own name, or that of its variant, says something else.
_PARTS = {
    "drive_delay": "Drive torque late",
    "drive_lag": "Drive torque lags",
    "steer_delay": "Steering late",
    "steer_lag": "Steering lags",
    "steer_offset": "Steering off centre",
    "steer_backlash": "Steering play",
    "cg_shift": "Centre of gravity off along the car",
    "aero_drag": "More or less drag",
    "rolling_resistance": "Rolling resistance off",
    "rotating_mass": "Wheels and drive line heavy to spin up",
    "grip_fade": "Tyre grip fades",
    "combined_slip": "Tyres share their grip",
    "tire_relaxation": "Tyres build up force late",
    "load_transfer": "Load moves between the axles",
    "aero_downforce": "Downforce",
    "yaw_moment_differential": "Locked differential",
    "road_grade": "Road slopes along",
    "road_bank": "Road slopes across",
    "wind": "Wind",
    "sensor_delay": "Sensors late",
    "steer_signal_delay": "Steering logged late",
    "channel_delay/r": "Yaw rate late",
    "channel_delay/vx": "Longitudinal velocity late",
    "channel_delay/vy": "Lateral velocity late",
    "channel_delay/velocity": "Velocities late",
    "channel_delay/imu": "Inertial unit late",
    "channel_delay/ax": "Longitudinal acceleration late",
    "channel_delay/ay": "Lateral acceleration late",
    "sensor_lever_arm": "Velocity sensor off its place",
    "sensor_misalignment": "Velocity sensor turned",
    "velocity_bias": "Lateral velocity biased",
    "acceleration_bias": "Acceleration biased",
    "yaw_rate_bias": "Yaw rate biased",
}
_THOUSANDTHS = {"s": ("ms", 1.0), "m": ("mm", 0.1), "rad": ("mrad", 0.1)}
_SHOWN = 3


def findings_headline(findings: Sequence[Finding], unexplained: str = "") -> str:
    """Return what was found as a headline, strongest first: ``Brakes 14.5 % weak.``

    Parameters
    ----------
    unexplained : str
        How much has no name; empty where nothing is left.
    """
    parts = [finding_headline(finding) for finding in findings[:_SHOWN]]
    more = len(findings) - len(parts)
    if more > 0:
        parts.append(f"{more} more")
    if unexplained:
        parts.append(unexplained)
    return f"{'; '.join(parts)}." if parts else ""


def finding_headline(finding: Finding) -> str:
    """Return one finding: the parameters that differ from what they should be, the others left out."""
    kind = CATALOGUE[finding.term]
    names = f"{finding.term}/{finding.variant}", finding.term
    factors, sizes = [], []
    for name, estimate in finding.parameters.items():
        neutral = kind.neutral.get(name)
        if neutral is None or not _differs(estimate, neutral):
            continue
        words = next((_FACTORS[one, name] for one in names if (one, name) in _FACTORS), None)
        if words:
            part, above, below = words
            share = 100.0 * (estimate.value - 1.0)
            factors.append(f"{part} {_significant(abs(share))} % {above if share > 0.0 else below}")
        else:
            sizes.append(_size(estimate))
    if factors:
        return ", ".join(factors)
    title = next((_PARTS[one] for one in names if one in _PARTS), term_title(finding.term))
    return f"{title}: {', '.join(sizes)}" if sizes else title


def _differs(estimate: ParameterEstimate, neutral: float) -> bool:
    low, high = estimate.interval_95
    return not low <= neutral <= high


def _size(estimate: ParameterEstimate) -> str:
    unit, below = _THOUSANDTHS.get(estimate.unit, ("", 0.0))
    value, unit = (1e3 * estimate.value, unit) if abs(estimate.value) < below else (estimate.value, estimate.unit)
    return f"{_significant(value)} {'' if unit == '1' else unit}".strip().replace("-", "−")


def _significant(value: float) -> str:
    """Return three digits at most, no more than one behind the point from 10 on."""
    if not math.isfinite(value):
        return "unknown"
    return number(value, 3 if abs(value) >= 10.0 else 2)
