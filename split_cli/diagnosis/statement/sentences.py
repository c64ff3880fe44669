"""Findings in words a reader can act on."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from split_cli.diagnosis.statement.result import Finding, Improvement, Location, ParameterEstimate, RemainderTest
from split_cli.diagnosis.statement.separation import separation
from split_cli.diagnosis.statement.wording import amount, number, percent, term_with_id, variable_name
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.parameters import Vehicle

__all__ = ["sentence_for", "separations", "statement_for", "summarise"]

# What a flexible fit calls its groups of functions, for a reader.
_KINDS = {
    "left against right": "the direction, left or right, driving or braking",
    "memory": "what happened before (memory)",
    "operating point": "the operating point",
}
Parameters = Mapping[str, ParameterEstimate]
_SOME_BRAKING = 0.6  # share of the largest braking torque that lost grip is told at
_CLEARLY = 0.02  # share of the gap from which on it is said to go with a variable
_STANDS_FOR = 0.4  # of what place explains, from which on another variable is named in its stead
_LONG_AGAINST = 0.5  # relative error of a time constant beyond which only its ratio to the loss is known


def sentence_for(
    term: str, variant: str, parameters: Parameters, alternatives: Sequence[str], vehicle: Vehicle | None = None
) -> str:
    """Return what a finding means, with what it cannot be told from and what would tell it.

    Parameters
    ----------
    term, variant : str
    parameters : mapping of str to ParameterEstimate
    alternatives : sequence of str
        Ids; a combination is written ``a+b``.
    vehicle : Vehicle, optional
        The nominal model, to tell effects in its forces.
    """
    lacks = "; the simulation does not have it" if CATALOGUE[term].exported else ""
    sentences = [f"{statement_for(term, variant, parameters, vehicle)}{lacks}."]
    for one in (separation(term, variant, alternative) for alternative in alternatives):
        name = term_with_id(one.alternative)
        if one.exact:
            sentences.append(f"No drive can tell it from {name}: {one.hint}.")
        else:
            sentences.append(f"On this data it cannot be told from {name}; what would tell: {one.hint}.")
    return " ".join(sentences)


def statement_for(term: str, variant: str, parameters: Parameters, vehicle: Vehicle | None = None) -> str:
    """Return what a finding says of the car or of the measurement, without a full stop."""
    text = _STATEMENTS[term](parameters, variant)
    if not CATALOGUE[term].exported:
        return f"The measurement, not the car: {text}"
    example = _EXAMPLES[term](parameters, vehicle) if term in _EXAMPLES and vehicle is not None else ""
    return f"In reality {text}{example}"


def separations(term: str, variant: str, alternatives: Sequence[str]) -> tuple[str, ...]:
    """Return, for every alternative, the excitation that would tell it from the term, or that nothing can."""
    return tuple(separation(term, variant, alternative).words for alternative in alternatives)


def summarise(
    verdict: str,
    findings: Sequence[Finding] = (),
    unexplained: bool = False,
    location: Location | None = None,
    remainder: RemainderTest | None = None,
    reasons: Sequence[str] = (),
    improvement: Improvement | None = None,
    vehicle: Vehicle | None = None,
) -> str:
    """Return the diagnosis in one paragraph: what differs, where, whether it helps, and what has no name.

    `reasons` are sentences: why nothing is decided, or what casts doubt on a mismatch.
    """
    if verdict == "undecided":
        return "It cannot be decided whether simulation and reality differ: " + " ".join(reasons)
    if verdict == "match":
        return "Simulation and reality agree within noise wherever both have been."
    parts = ["Simulation and reality differ."]
    parts += reasons
    for finding in findings:
        statement = statement_for(finding.term, finding.variant, finding.parameters, vehicle)
        others = " or ".join(term_with_id(one) for one in finding.alternatives)
        parts.append(f"{statement}." + (f" This data may as well be explained by {others}." if others else ""))
    lacking = sum(finding.exported for finding in findings)
    lacks = (
        "",
        "The simulation does not have it.",
        "The simulation has neither.",
        "The simulation has none of these.",
    )
    parts.append(lacks[min(lacking, 3)])
    if location is not None:
        parts.append(_where(location))
    if unexplained and remainder is not None:
        parts.append(_nameless(remainder, bool(findings)))
    if improvement is not None:
        parts.append(_help(improvement, "physics" if findings else "split_only"))
    return " ".join(part for part in parts if part)


def _where(location: Location) -> str:
    force = max(location.forces, key=location.forces.get)
    text = f"The gap is mostly in {force.replace('_', ' ')} force ({percent(location.forces[force])} of it)"
    name, score = _tells_most(location)
    if score > _CLEARLY:
        text += f" and goes with {variable_name(name)[0]}, which alone explains {percent(score)} of it"
    text += "."
    here = ""
    if location.place is not None:
        here = f"between s = {number(location.place.s_start)} and {number(location.place.s_end)} m"
    elif location.time is not None:
        here = f"between {number(location.time[0])} and {number(location.time[1])} s"
    if here:
        share = percent(location.share_of_gap)
        return f"{text} {share} of it lies {here}, in {percent(location.share_of_samples)} of the samples."
    if name in location.region:
        low, high = location.region[name]
        words, unit = variable_name(name)
        return f"{text} It is largest at a {words} of {number(low)} to {number(high)} {unit}."
    return text


def _tells_most(location: Location) -> tuple[str, float]:
    """Return the variable to name: on a lap that repeats itself, place stands for all the others."""
    best = location.depends_on[0] if location.depends_on else ("", 0.0)
    others = [pair for pair in location.depends_on if pair[0] not in ("s", "t")]
    if best[0] in ("s", "t") and location.place is None and others and others[0][1] > _STANDS_FOR * best[1]:
        return others[0]
    return best


def _help(improvement: Improvement, stage: str) -> str:
    model = "the named physics" if stage == "physics" else "SPLIT alone, which needs no name"
    if not improvement.tells:
        return f"Held-out time shows too little of the gap to tell whether {model.split(',')[0]} helps."
    removed = improvement.removed.get(stage)
    parts = []
    if removed is not None:
        share, low, high = removed
        interval = f"95 %: {100.0 * low:.0f} to {100.0 * high:.0f} %"
        told = percent(share) if share > 0.0 else "nothing"
        parts.append(f"it removes {told} of a step's squared error beyond sensor noise ({interval})")
    if improvement.rollouts:
        last = improvement.rollouts[-1]
        before, after, floor = last.before, getattr(last, stage), last.noise_floor
        k = max(range(3), key=lambda k: before[k] / max(floor[k], 1e-12))
        name, unit = (("v_x", "m/s"), ("v_y", "m/s"), ("r", "rad/s"))[k]
        parts.append(
            f"after {last.horizon:g} s of free running the error of {name} goes from {number(before[k], 2)} to "
            f"{number(after[k], 2)} {unit} (sensor noise alone: {number(floor[k], 2)})"
        )
    return f"With {model}, on held-out time: {'; '.join(parts)}." if parts else ""


def _nameless(remainder: RemainderTest, named: bool) -> str:
    share = f"{percent(remainder.share)} of the gap" if named else "The gap"
    kind = remainder.by_group[0][0] if remainder.by_group else ""
    lead = f"; it goes with {_KINDS.get(kind, kind)}" if kind else ""
    formula = f" A formula as a lead: {remainder.formula}." if remainder.formula else ""
    return f"{share} has no name in the catalogue{lead}.{formula}"


def _scaled(what: str, name: str, more: str, less: str) -> Callable[[Parameters, str], str]:
    """Return the statement that a scale, 1 in the simulation, is so many per cent more or less."""
    return lambda p, variant: f"{what} {_by(p[name], more, less)}"


def _by(scale: ParameterEstimate, more: str, less: str) -> str:
    return amount(scale, neutral=1.0, share=True, more=more, less=less)


def _late(what: str, name: str, how: str) -> Callable[[Parameters, str], str]:
    return lambda p, variant: f"{what} {amount(p[name], one_sided=True, more=how, less=how)}"


def _curve(variant: str) -> str:
    return "the tyres' whole curve" if variant == "curve" else "grip"


def _stretch(p: Parameters) -> str:
    return f"between s = {number(p['s_start'].value)} and {number(p['s_end'].value)} m"


def _grip_fade(p: Parameters, variant: str) -> str:
    loss, tau = p["final_loss"], p["tau"]
    verb = "fades" if loss.value >= 0.0 else "grows"
    unsure = tau.std_error is not None and tau.std_error > _LONG_AGAINST * abs(tau.value)
    if unsure:
        rate = number(100.0 * abs(loss.value / tau.value), 2)
        return f"{_curve(variant)} {verb} with time, at first by {rate} % a second (how far it goes is not known)"
    size, pace = amount(loss, share=True, more="less", less="more"), number(tau.value)
    return f"{_curve(variant)} {verb} with time, to {size} in the end, with a time constant of {pace} s"


def _incline(up: str, down: str) -> Callable[[Parameters, str], str]:
    def statement(p: Parameters, variant: str) -> str:
        if variant == "wave":
            size = amount(_absolute(p["amplitude"]), one_sided=True)
            return f"the road {up} and {down} by up to {size} in waves of {number(p['wavelength'].value)} m"
        size = amount(_absolute(p["angle"]))
        text = f"the road {up if p['angle'].value >= 0.0 else down} by {size}"
        return f"{text} {_stretch(p)}" if variant == "stretch" else text

    return statement


def _absolute(estimate: ParameterEstimate) -> ParameterEstimate:
    if estimate.value >= 0.0:
        return estimate
    low, high = estimate.interval_95
    return ParameterEstimate(-estimate.value, estimate.std_error, estimate.unit, (-high, -low))


def _combined_slip(p: Parameters, vehicle: Vehicle) -> str:
    """Return how much lateral force an axle loses under hard braking, where it loses most."""
    torque = _SOME_BRAKING * vehicle.max_brake_torque / vehicle.wheel_radius
    front = vehicle.brake_split_front * torque / vehicle.front_tire.D
    rear = (1.0 - vehicle.brake_split_front) * torque / vehicle.rear_tire.D
    axle, used = ("front", front) if front >= rear else ("rear", rear)
    lost = 1.0 - math.sqrt(max(1.0 - p["strength"].value * used**2, 0.0))
    return (
        f": the {axle} axle loses {number(100.0 * lost, 2)} % of its lateral force at {percent(_SOME_BRAKING)} of "
        "the largest braking torque"
    )


def _load_transfer(p: Parameters, vehicle: Vehicle) -> str:
    moved = vehicle.mass * p["cg_height"].value / vehicle.wheelbase
    return f": {number(moved)} N for each m/s^2"


_EXAMPLES = {"combined_slip": _combined_slip, "load_transfer": _load_transfer}
_STATEMENTS: dict[str, Callable[[Parameters, str], str]] = {
    "combined_slip": lambda p, v: (
        f"driving and braking take lateral grip, with a strength of {amount(p['strength'], one_sided=True)}"
    ),
    "friction_scale": lambda p, v: f"{_curve(v)} is {_by(p['scale'], 'higher', 'lower')} on the whole road",
    "friction_patch": lambda p, v: (
        f"{_stretch(p)} {_curve(v)} is {_by(p['scale'], 'higher', 'lower')} than elsewhere"
    ),
    "grip_fade": _grip_fade,
    "tire_relaxation": lambda p, v: (
        f"lateral force builds up over {amount(p['length'], one_sided=True)} of travel"
    ),
    "load_transfer": lambda p, v: (
        "accelerating and braking move axle load as a centre of gravity "
        f"{amount(p['cg_height'], one_sided=True, more='high', less='high')} does"
    ),
    "tire_stiffness": lambda p, v: (
        f"the front tyres are {_by(p['front_scale'], 'stiffer', 'softer')} and "
        f"the rear tyres {_by(p['rear_scale'], 'stiffer', 'softer')}"
    ),
    "aero_downforce": lambda p, v: (
        f"axle load changes with speed squared: {amount(p['front'], more='more', less='less')} at the front, "
        f"{amount(p['rear'], more='more', less='less')} at the rear"
    ),
    "aero_drag": lambda p, v: f"there is {amount(p['drag'], more='more drag', less='less drag')}",
    "rolling_resistance": lambda p, v: (
        f"there is {amount(p['force'], more='more resistance', less='less resistance')} to rolling"
    ),
    "yaw_moment_differential": lambda p, v: (
        f"a moment of {amount(p['yaw_damping'], one_sided=True)} resists turning, as a locked axle does"
    ),
    "wind": lambda p, v: (
        f"the air moves over the ground, {amount(p['wx'], more='along X', less='against X')} and "
        f"{amount(p['wy'], more='along Y', less='against Y')}"
    ),
    "road_grade": _incline("climbs", "falls"),
    "road_bank": _incline("rises to the left", "rises to the right"),
    "drive_delay": _late("torque arrives", "delay", "late"),
    "drive_gain": lambda p, v: (
        f"driving torque arrives {_by(p['drive_gain'], 'too strong', 'too weak')}"
        f" and braking torque "
        f"{_by(p['brake_gain'], 'too strong', 'too weak')}"
    ),
    "drive_lag": lambda p, v: f"torque builds up with a time constant of {amount(p['tau'], one_sided=True)}",
    "steer_backlash": lambda p, v: f"the steering has a play of {amount(p['width'], one_sided=True)} in all",
    "steer_delay": _late("the steering answers", "delay", "late"),
    "steer_gain": _scaled("the wheels turn", "gain", "more than commanded", "less than commanded"),
    "steer_lag": lambda p, v: f"steering builds up with a time constant of {amount(p['tau'], one_sided=True)}",
    "steer_offset": lambda p, v: (
        f"the wheels stand {amount(p['offset'], more='too far to the left', less='too far to the right')}"
    ),
    "cg_shift": lambda p, v: (
        f"the centre of gravity lies {amount(p['dx'], more='further forward', less='further back')}"
    ),
    "mass": _scaled("the car is", "scale", "heavier", "lighter"),
    "yaw_inertia": _scaled("the yaw inertia is", "scale", "larger", "smaller"),
    "sensor_delay": _late("against the commands every measured channel is", "delay", "late"),
    "sensor_lever_arm": lambda p, v: (
        f"the velocity sensor sits {amount(p['dx'], more='further forward', less='further back')} than stated"
    ),
    "sensor_misalignment": lambda p, v: (
        f"the velocity sensor is turned {amount(p['angle'], more='counter-clockwise', less='clockwise')}"
    ),
}
