"""Findings in words a reader can act on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from split_cli.diagnosis.result import Finding, Location, RemainderTest
from split_cli.vehicle.effects import CATALOGUE

__all__ = ["sentence_for", "summarise"]

_PATTERNS = {
    "combined_slip": "driving and braking forces take lateral grip, with strength {strength:.2f}",
    "friction_scale": "the road's grip is {scale:.3f} of the nominal",
    "friction_patch": "between s = {s_start:.0f} and {s_end:.0f} m the grip is {scale:.2f} of the nominal",
    "grip_fade": "grip drifts with time by {final_loss:.3f} in the end, with a time constant of {tau:.0f} s",
    "tire_relaxation": "lateral force builds up over {length:.2f} m",
    "load_transfer": "accelerating and braking move axle load, as a centre of gravity {cg_height:.2f} m high does",
    "tire_stiffness": "tyre stiffness is {front_scale:.3f} (front) and {rear_scale:.3f} (rear) of the nominal",
    "aero_downforce": "axle load grows with speed, by {front:.2f} (front) and {rear:.2f} (rear) N/(m/s)^2",
    "aero_drag": "there is {drag:.3f} N/(m/s)^2 more drag",
    "rolling_resistance": "there is {force:.1f} N more resistance, or a constant grade",
    "yaw_moment_differential": "a moment of {yaw_damping:.0f} N m s/rad resists turning",
    "wind": "the air moves over the ground with {wx:.1f}, {wy:.1f} m/s in X, Y",
    "drive_delay": "torque arrives {delay:.3f} s late",
    "drive_gain": "driving torque arrives scaled by {drive_gain:.3f}, braking torque by {brake_gain:.3f}",
    "drive_lag": "torque builds up with a time constant of {tau:.3f} s",
    "steer_backlash": "the steering has a play of {width:.4f} rad",
    "steer_delay": "steering answers {delay:.3f} s late",
    "steer_gain": "the wheels turn {gain:.3f} of the steer command",
    "steer_lag": "steering builds up with a time constant of {tau:.3f} s",
    "steer_offset": "the steering's zero is off by {offset:.4f} rad",
    "cg_shift": "the centre of gravity lies {dx:.3f} m further forward",
    "mass": "the car has {scale:.3f} of the nominal mass",
    "yaw_inertia": "the car has {scale:.3f} of the nominal yaw inertia",
    "sensor_delay": "every measured channel is {delay:.3f} s late against the commands",
    "sensor_lever_arm": "the velocity sensor sits {dx:.3f} m ahead of where it is said to be",
    "sensor_misalignment": "the velocity sensor is turned by {angle:.4f} rad, counter-clockwise",
}
_INCLINE = {
    "": "the road {axis} by {angle:.4f} rad",
    "wave": "the road {axis} by up to {amplitude:.4f} rad, in waves of {wavelength:.0f} m",
    "stretch": "the road {axis} by {angle:.4f} rad between s = {s_start:.0f} and {s_end:.0f} m",
}
_AXES = {"road_grade": "climbs", "road_bank": "rises to the left"}


def sentence_for(term: str, variant: str, values: Mapping[str, float], alternatives: Sequence[str]) -> str:
    """Return what a finding means, with what it cannot be told from and what would tell it."""
    if term in _AXES:
        text = _INCLINE[variant].format(axis=_AXES[term], **values)
    else:
        text = _PATTERNS[term].format(**values)
    kind = "The measurement" if not CATALOGUE[term].exported else "In reality"
    sentence = (
        f"{kind}: {text}" if kind == "The measurement" else f"{kind} {text}; the simulation does not have it"
    )
    if alternatives:
        sentence += f". On this data it cannot be told from {', '.join(alternatives)}"
        hints = separations(term, alternatives)
        if hints:
            sentence += f"; {hints[0]} would tell them apart"
    return sentence + "."


def separations(term: str, alternatives: Sequence[str]) -> tuple[str, ...]:
    """Return the excitations that would separate a term from its alternatives."""
    hints = []
    for own, other in ((term, alternatives), *((one, (term,)) for one in alternatives if one in CATALOGUE)):
        for mimic in CATALOGUE[own].mimics:
            if mimic.separated_by and any(name in other for name in (mimic.terms, *mimic.terms.split("+"))):
                hints.append(mimic.separated_by)
    return tuple(dict.fromkeys(hints))


def summarise(
    verdict: str,
    findings: Sequence[Finding],
    unexplained: bool,
    location: Location | None,
    remainder: RemainderTest | None,
    reasons: Sequence[str],
) -> str:
    """Return the diagnosis in one paragraph."""
    if verdict == "undecided":
        return "It cannot be decided whether simulation and reality differ: " + " ".join(reasons)
    if verdict == "match":
        return "Simulation and reality agree within noise wherever both have been."
    parts = ["Simulation and reality differ."]
    parts += [finding.sentence for finding in findings]
    if location is not None:
        channel = max(location.forces, key=location.forces.get).replace("_", " ")
        parts.append(f"The gap is mostly in {channel} force ({max(location.forces.values()):.0%} of it).")
    if unexplained and remainder is not None:
        share = f"{remainder.share:.0%} of the gap" if findings else "The gap"
        lead = f"; it depends on {remainder.by_group[0][0]}" if remainder.by_group else ""
        formula = f" A formula as a lead: {remainder.formula}." if remainder.formula else ""
        parts.append(f"{share} has no name in the catalogue{lead}.{formula}")
    return " ".join(parts)
