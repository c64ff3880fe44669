"""Findings in words a reader can act on."""

from collections.abc import Mapping, Sequence

from split_cli.diagnosis.statement.improvement import CorrectedVehicle, HorizonErrors, Improvement, StateChange
from split_cli.diagnosis.statement.result import Combination, Finding, Location, ParameterEstimate, RemainderTest
from split_cli.diagnosis.statement.separation import separation
from split_cli.diagnosis.statement.wording import STATES, is_swinging, number, percent, term_with_id, variable_name
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.parameters import Vehicle

# What a flexible fit calls its groups of functions, for a reader.
_KINDS = {
    "left against right": "the direction, left or right, driving or braking",
    "memory": "what happened before (memory)",
    "operating point": "the operating point",
}
Parameters = Mapping[str, ParameterEstimate]
_WORTH_A_WORD = 0.2  # of the gap, that neither a finding nor the unexplained part accounts for [1]; judgement
_CLEARLY = 0.02  # share of the gap from which on it is said to go with a variable [1]; judgement
_MUCH_OF_ERROR = 0.2  # share of the mean in a squared error, from which on it is stated [1]; judgement
_STANDS_FOR = 0.4  # of what place explains, from which on another variable is named in its stead [1]; judgement


def sentence_for(
    term: str,
    variant: str,
    parameters: Parameters,
    alternatives: Sequence[str],
    vehicle: Vehicle | None = None,
    combination: Combination | None = None,
) -> str:
    """Return what a finding means, with what it cannot be distinguished from and what would tell it.

    Parameters
    ----------
    alternatives : sequence of str
        Ids; a combination is written ``a+b``.
    vehicle : Vehicle, optional
        The nominal model, to tell effects in its forces.
    combination : Combination, optional
        What is known of the parameters together, where none is known by itself.
    """
    lacks = "; the simulation lacks this effect" if CATALOGUE[term].exported else ""
    sentences = [f"{statement_for(term, variant, parameters, vehicle)}{lacks}."]
    if combination is not None:
        sentences.append(_only_together(combination))
    for one in (separation(term, variant, alternative) for alternative in alternatives):
        name = term_with_id(one.alternative)
        if one.exact:
            sentences.append(f"No recording can distinguish it from {name}: {one.hint}.")
        else:
            sentences.append(f"These data do not distinguish it from {name}; this would: {one.hint}.")
    return " ".join(sentences)


def _only_together(one: Combination) -> str:
    """Return which sum of a finding's parameters is known."""
    names = [name.replace("_", " ") for name in one.weights]
    text = f"No interval of {' or '.join(names)} leaves out no effect"
    if not one.unit:
        return f"{text}, but their joint 95 % region does."
    weights = [number(abs(weight), 2) for weight in one.weights.values()]
    signs = ["-" if weight < 0.0 else "+" for weight in one.weights.values()]
    each = [f"{sign} {weight} {name}" for sign, weight, name in zip(signs, weights, names, strict=True)]
    unit = f" {one.unit}".removesuffix(" 1")
    low, high = (number(end) for end in one.interval_95)
    total = " ".join(each).removeprefix("+ ")
    return f"{text}. Their changes are known together: {total} = {number(one.value)}{unit} (95 %: {low} to {high})."


def lead_sentence(
    term: str,
    variant: str,
    parameters: Parameters,
    sources: Sequence[str],
    instead: Sequence[tuple[str, str, Parameters]],
    vehicle: Vehicle | None = None,
    *,
    further: bool = False,
) -> str:
    """Return what an explanation would need that no real car has, why none has it, and what explains as much.

    Parameters
    ----------
    parameters : mapping of str to ParameterEstimate
        What it would need.
    sources : sequence of str
        Of the limits.
    instead : sequence of (str, str, mapping)
        Term, variant and parameters of explanations within what a car can have.
    further : bool
        Whether it would come to what is named.
    """
    kind, gap = CATALOGUE[term], "what the findings leave" if further else "the gap"
    parts = [
        f"A lead, not a finding: {gap} would be explained if {kind.statement(parameters, variant)}. No real "
        f"car of this size has such a value ({'; '.join(sources)})."
    ]
    parts += [
        f"It would be explained as well if {CATALOGUE[other].statement(values, which)} ({other})."
        for other, which, values in instead
    ]
    return " ".join(parts)


def withdrawn_sentence(
    term: str, variant: str, parameters: Parameters, reason: str, vehicle: Vehicle | None = None
) -> str:
    """Return what would explain a part of the gap, and the reason why held-out time speaks against it."""
    reasons = f"{reason} A part of the gap has no name. So this effect stands for something else."
    return _stated_as_lead(term, variant, parameters, reasons, vehicle)


def hidden_sentence(
    term: str,
    variant: str,
    parameters: Parameters,
    size: float,
    instead: Sequence[str],
    vehicle: Vehicle,
    *,
    apart: bool = False,
) -> str:
    """Return which effect may act beside the findings, its size over noise, and which terms explain as much.

    Parameters
    ----------
    apart : bool
        Whether it has no name since reality and simulation were driven too differently.
    """
    wrong = "What the model gets wrong of the findings may be as large."
    if apart:
        wrong = "Where one was driven and the other was not, what the vehicle file gets wrong may be as large."
    reasons = f"Over 0.05 s it changes the motion by {size:.2g} times sensor noise. {wrong}"
    if instead:
        reasons += f" The same would be explained by {' or '.join(instead)}."
    return _stated_as_lead(term, variant, parameters, reasons, vehicle)


def tolerance_sentence(
    term: str, variant: str, parameters: Parameters, limits: Mapping[str, float], *, taken_off: bool
) -> str:
    """Return what a sensor does that any sound recording may have, and up to which value of each parameter.

    Parameters
    ----------
    taken_off : bool
        Whether figures of held-out time, with the findings, are without it.
    """
    most = " and ".join(_limit_in_words(limit, parameters[name].unit) for name, limit in limits.items())
    reasons = f"Up to {most} is usual in sound recordings, so it is no fault."
    reasons += " The held-out errors with the identified effects are without it." if taken_off else ""
    return _stated_as_lead(term, variant, parameters, reasons, None)


def _limit_in_words(limit: float, unit: str) -> str:
    return f"{100.0 * limit:.3g} %" if unit == "1" else f"{number(limit)} {unit}".strip()


def _stated_as_lead(term: str, variant: str, parameters: Parameters, reasons: str, vehicle: Vehicle | None) -> str:
    statement = statement_for(term, variant, parameters, vehicle)
    return f"A lead, not a finding: {statement[:1].lower()}{statement[1:]}. {reasons}"


def error_rises(rises: tuple[float, float, float]) -> str:
    """Return by which share the one-step error rises on held-out time with all findings.

    Parameters
    ----------
    rises : tuple of float
        Of the squared error above the noise floor; value, upper and lower end.
    """
    share, high, low = (100.0 * one for one in rises)
    return (
        f"On held-out time the squared one-step error above the noise floor rises by {share:.0f} % with all "
        f"identified effects (95 %: {low:.0f} to {high:.0f} %)."
    )


def nothing_is_better(corrected: CorrectedVehicle) -> str:
    """Return which velocities a file with all findings predicts worse at the longest horizon; none is better."""
    horizon, worse = corrected.farthest[0].horizon, [one for one in corrected.farthest if one.is_worse]
    return (
        f"On held-out time a vehicle file with all identified effects predicts no velocity after {horizon:g} s better "
        f"than the given one, beyond chance, and worse: {_with_and_without(worse)}."
    )


def statement_for(term: str, variant: str, parameters: Parameters, vehicle: Vehicle | None = None) -> str:
    """Return what a finding says of the car or of the measurement, without a full stop."""
    kind = CATALOGUE[term]
    text = kind.statement(parameters, variant)
    if not kind.exported:
        return f"The measurement, not the car: {text}"
    example = kind.example(parameters, vehicle) if vehicle is not None else ""
    return f"In reality {text}{example}"


def separations(term: str, variant: str, alternatives: Sequence[str]) -> tuple[str, ...]:
    """Return, for every alternative, the excitation that would tell it from the term, or that nothing can."""
    return tuple(separation(term, variant, alternative).words for alternative in alternatives)


def acting_in_a_part(
    readings: Sequence[tuple[str, str, ParameterEstimate]],
    begin: float,
    end: float,
    most: int,
    number_of_drive: int | None = None,
) -> str:
    """Return what terms would explain from `begin` to `end` [s] and not all along the drive.

    Parameters
    ----------
    readings : sequence of (str, str, ParameterEstimate)
        Terms, a parameter of each, and what it is there; best first.
    most : int
        Of how many more than one terms no name is given.
    number_of_drive : int, optional
        Which of several real drives, from 1.
    """
    where = f"Between {number(begin)} and {number(end)} s{f' of real drive {number_of_drive}' * bool(number_of_drive)}"
    if not 0 < len(readings) <= most + 1:
        several = "many effects explain it as well" if readings else "no effect that a real car can have explains it"
        return f"{where} there is a difference that is not there all along the drive; {several}."

    def worded(term: str, name: str, one: ParameterEstimate) -> str:
        low, high = (number(end, 3) for end in one.interval_95)
        value = f"{name} = {number(one.value, 3)} {one.unit}".removesuffix(" 1")
        return f"{term_with_id(term)} with {value} (95 %: {low} to {high})"

    first, *others = (worded(*one) for one in readings)
    instead = f" It is explained nearly as well there by {' or by '.join(others)}." if others else ""
    return f"{where} it looks like {first}, but not all along the drive. This is a lead, not a finding.{instead}"


def where_compared(share: float) -> str:
    """Return in words at which operating points a share of the real drive was compared."""
    if share > 0.995:
        return "at all operating points of the real drive"
    return f"at the {100.0 * share:.0f} % of the real drive's operating points that both have"


def summarise(
    verdict: str,
    findings: Sequence[Finding] = (),
    unexplained: bool = False,
    location: Location | None = None,
    remainder: RemainderTest | None = None,
    reasons: Sequence[str] = (),
    improvement: Improvement | None = None,
    vehicle: Vehicle | None = None,
    corrected: CorrectedVehicle | None = None,
    compared_share: float = 1.0,
) -> tuple[str, ...]:
    """Return the diagnosis in sentences: what differs, where, whether it helps, and what has no name.

    `reasons` are sentences: why nothing is decided, what a match leaves open, or what casts doubt on a mismatch.
    `compared_share` is that of the real drive.
    """
    if verdict == "undecided":
        return (f"It cannot be decided whether simulation and reality differ: {' '.join(reasons[:1])}", *reasons[1:])
    if verdict == "match":
        return (f"Simulation and reality agree within noise {where_compared(compared_share)}.", *reasons)
    parts = ["Simulation and reality differ.", *reasons]
    # Of one finding the two statements are one; of several, what the simulation lacks follows all of them.
    alone = "; the simulation lacks this effect" if len(findings) == 1 and findings[0].exported else ""
    for finding in findings:
        statement = statement_for(finding.term, finding.variant, finding.parameters, vehicle)
        others = " or ".join(term_with_id(one) for one in finding.alternatives)
        parts += [f"{statement}{alone}.", f"These data are explained as well by {others}." if others else ""]
        parts.append("" if finding.combination is None else _only_together(finding.combination))
    lacking = sum(finding.exported for finding in findings)
    lacks = (
        "",
        "" if alone else "The simulation lacks one of these effects.",
        "The simulation lacks both effects.",
        "The simulation lacks all of these effects.",
    )
    parts.append(lacks[min(lacking, 3)])
    if location is not None:
        parts += _where(location)
    if unexplained and remainder is not None:
        parts += _unnamed(remainder, findings)
    if improvement is not None:
        parts += _help(improvement, "physics" if findings else "split_only", vehicle)
    if corrected is not None and corrected.further:
        parts += with_nameless_effects(corrected)
    elif corrected is not None and not corrected.accepted:
        parts.append(not_accepted(corrected))
    return tuple(part for part in parts if part)


def _where(location: Location) -> list[str]:
    force = max(location.forces, key=location.forces.get)
    sentences = [f"The gap is mostly {force.replace('_', ' ')} force ({percent(location.forces[force])})."]
    name, score = _variable_to_name(location)
    if score > _CLEARLY:
        words = variable_name(name)[0]
        sentences.append(f"{words[:1].upper()}{words[1:]} alone explains {percent(score)} of the gap.")
    here = ""
    if location.place is not None:
        here = f"between s = {number(location.place.s_start)} and {number(location.place.s_end)} m"
    elif location.time is not None:
        here = f"between {number(location.time[0])} and {number(location.time[1])} s"
    if here:
        share = percent(location.share_of_gap)
        sentences.append(f"{share} of the gap lies {here}, in {percent(location.share_of_samples)} of the samples.")
    elif name in location.region:
        low, high = location.region[name]
        words, unit = variable_name(name)
        sentences.append(f"The gap is largest at a {words} of {number(low)} to {number(high)} {unit}.")
    return sentences


def _variable_to_name(location: Location) -> tuple[str, float]:
    """Return the variable to name: on a lap that repeats itself, place stands for all the others."""
    best = location.depends_on[0] if location.depends_on else ("", 0.0)
    others = [pair for pair in location.depends_on if pair[0] not in ("s", "t")]
    if best[0] in ("s", "t") and location.place is None and others and others[0][1] > _STANDS_FOR * best[1]:
        return others[0]
    return best


def _help(improvement: Improvement, stage: str, vehicle: Vehicle | None = None) -> list[str]:
    model = "the identified effects" if stage == "physics" else "a correction learned by SPLIT alone"
    if not improvement.shows_gap:
        return [f"The held-out data show too little of the gap to tell whether {model} would reduce it."]
    removed, intro, parts = improvement.removed.get(stage), f"With {model}, on held-out data", []
    nothing = stage in improvement.trust and not any(improvement.trust[stage])
    if nothing:
        parts.append("A correction learned by SPLIT alone does not hold on training time, and none is applied.")
    elif removed is not None:
        share, *ends = removed
        verb = "falls" if share >= 0.0 else "rises"
        low, high = sorted(100.0 * end if share >= 0.0 else -100.0 * end for end in ends)
        chance = ", within chance" if low < 0.0 < high else ""
        change = f"{verb} by {percent(abs(share))} (95 %: {low:.0f} to {high:.0f} %{chance})"
        parts.append(f"{intro}, the squared one-step error above the noise floor {change}.")
    if improvement.rollouts:
        change, *others = (_as_it_is if nothing else _open_loop)(improvement.rollouts[-1], stage, vehicle)
        parts += [change if parts else f"{intro}: {change[:1].lower()}{change[1:]}", *others]
        parts += _beside_split(improvement.rollouts[-1]) if stage == "physics" else []
    return parts


def _as_it_is(last: HorizonErrors, stage: str, vehicle: Vehicle | None = None) -> list[str]:
    """Return the errors of all velocities where a stage changes none."""
    errors = [
        f"{number(getattr(last, stage)[k], 2)} {unit} in {name} (persistence: {number(last.persistence[k], 2)})"
        for k, (name, unit) in enumerate(STATES)
    ]
    *most, final = errors
    text = f"After {last.horizon:g} s of open-loop simulation the error is {', '.join(most)} and {final}."
    return [text, *_offsets(last, stage, last.beaten_by_persistence(stage), vehicle)]


def _offsets(last: HorizonErrors, stage: str, channels: Sequence[int], vehicle: Vehicle | None) -> list[str]:
    """Return what of a stage's squared errors is the mean error: of v_x, a force that lasts."""
    sentences = []
    for k in channels:
        share = last.mean_share(stage, k)
        if share is None or share < _MUCH_OF_ERROR:
            continue
        (name, unit), mean = STATES[k], last.mean[stage][k]
        text = f"The mean error of {name} is {number(mean, 2)} {unit}, {percent(share)} of the squared error"
        if k == 0 and vehicle is not None:
            force = number(abs(mean) * vehicle.mass / last.horizon, 2)
            text += f", as of {force} N of longitudinal force too {'much' if mean > 0.0 else 'little'}"
        sentences.append(f"{text}.")
    return sentences


def _open_loop(last: HorizonErrors, stage: str, vehicle: Vehicle | None = None) -> list[str]:
    """Return what becomes of the error that a stage changes most, and which errors get worse."""
    k = last.most_changed(stage)
    name, unit = STATES[k]
    before, after, held, floor = (
        number(getattr(last, key)[k], 2) for key in ("before", stage, "persistence", "noise_floor")
    )
    text = (
        f"After {last.horizon:g} s of open-loop simulation the error of {name} changes from {before} to {after} "
        f"{unit} (persistence: {held}; noise floor: {floor})"
    )
    beaten = last.beaten_by_persistence(stage)
    others = [
        f"The error of {STATES[i][0]} rises from "
        f"{' to '.join(_apart(last.before[i], getattr(last, stage)[i]))} {STATES[i][1]}"
        for i in last.worse(stage)
        if i != k
    ]
    if beaten:
        names = " and ".join(STATES[i][0] for i in beaten)
        others.append(f"Persistence still predicts {names} better")
    doubtful = sorted({*beaten, *last.worse(stage)})
    return [*(f"{one}." for one in (text, *others)), *_offsets(last, stage, doubtful, vehicle)]


def _beside_split(last: HorizonErrors) -> list[str]:
    """Return which errors a correction learned beside the effects makes worse than these alone do."""
    worse = [
        f"{STATES[k][0]} ({' instead of '.join(_apart(last.after[k], last.physics[k]))} {STATES[k][1]})"
        for k in last.worse_with_split()
    ]
    text = f"A correction learned by SPLIT beside them makes it worse in {_listed(worse)}: use the effects alone."
    return [text] if worse else []


def _listed(several: Sequence[str]) -> str:
    """Return words as a list: ``a``, ``a and b``, ``a, b and c``."""
    return " and ".join(filter(None, (", ".join(several[:-1]), *several[-1:])))


def _apart(one: float, other: float) -> tuple[str, str]:
    """Return two numbers with as many digits, two or more, as tell them apart."""
    texts = [(number(one, digits), number(other, digits)) for digits in (2, 3, 4)]
    return next((pair for pair in texts if pair[0] != pair[1]), texts[-1])


def _with_and_without(states: Sequence[StateChange]) -> str:
    """Return errors of a corrected vehicle and of the nominal one."""
    return ", ".join(
        f"{one.channel} after {one.horizon:g} s ({' instead of '.join(_apart(one.corrected, one.nominal))} {one.unit})"
        for one in states
    )


def _errors_that_reject(corrected: CorrectedVehicle) -> str:
    return _with_and_without([one for one in corrected.states if one.is_worse] or corrected.farthest)


def with_nameless_effects(corrected: CorrectedVehicle) -> list[str]:
    """Return which effects without a name a corrected vehicle file holds, too, and why."""
    several = _listed([term_with_id(one.term) for one in corrected.further])
    return [
        f"The corrected vehicle file also holds {several}, which these data do not tell from other effects.",
        f"Errors with the identified effects are with these, too. Without them the file would predict worse than the "
        f"given one on held-out data: {_errors_that_reject(corrected.alone)}.",
    ]


def not_accepted(corrected: CorrectedVehicle) -> str:
    """Return why a corrected vehicle is not to be used."""
    errors, away = _errors_that_reject(corrected), ""
    if corrected.runs_away:
        held = ", ".join(f"{one.channel} {number(one.persistence, 2)} {one.unit}" for one in corrected.farthest)
        away = f" It runs away there, as in a spin: velocities held as they are would be nearer ({held})."
    return (
        f"On held-out data the corrected vehicle file predicts worse than the given one: {errors}.{away} "
        "It is written as vehicle_rejected.yaml, for inspection only; do not use it."
    )


def scatter(remainder: RemainderTest, findings: Sequence[Finding]) -> float:
    """Return which share of the gap [1] has neither a name nor structure; 0 where it is not worth a word."""
    rest = remainder.without_structure(findings) if findings else 0.0
    return rest if rest > _WORTH_A_WORD else 0.0


def unexplained_part(findings: Sequence[Finding], remainder: RemainderTest | None) -> str:
    """Return how much of the gap findings leave without a name: ``less than 1 % of the gap unexplained``."""
    if remainder is None:
        return "an unexplained part"
    share = remainder.share + scatter(remainder, findings)
    return f"{percent(share) if share > 0.0 else 'less than 1 %'} of the gap unexplained"


def gap_left(findings: Sequence[Finding], remainder: RemainderTest) -> str:
    """Return what of the gap has structure and no name: ``3 % of the gap``; all of it where nothing is named."""
    share = percent(remainder.share) if remainder.share > 0.0 else "less than 1 %"
    return f"{share} of the gap" if findings else "the gap"


def _depending(kind: str) -> str:
    """Return what the nameless part depends on, as a sentence; empty if that is not known."""
    if is_swinging(kind):
        return (
            f"It follows the accelerations of the car as a mass on a spring does, {kind}. "
            "A load or fuel that sloshes, a trailer and a body that rolls do that."
        )
    return f"It depends mostly on {_KINDS.get(kind, kind)}." if kind else ""


def _unnamed(remainder: RemainderTest, findings: Sequence[Finding]) -> list[str]:
    share = gap_left(findings, remainder)
    kind = remainder.by_group[0][0] if remainder.by_group else ""
    rest = scatter(remainder, findings)
    nameless = "is explained by no effect of the catalogue"
    if rest:
        nameless = "has a structure that no effect of the catalogue explains"
    return [
        f"{share[:1].upper()}{share[1:]} {nameless}.",
        _depending(kind),
        f"A candidate formula: {remainder.formula}." if remainder.formula else "",
        f"Another {percent(rest)} has neither name nor structure: scatter, or the error of the model's form."
        if rest
        else "",
    ]
