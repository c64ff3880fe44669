"""Whether the channels of a drive fit together physically, and if not, what is wrong with which, in words."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from split_cli.logs.checking.changed_clock import changed_clock
from split_cli.logs.checking.checks import ACROSS, NOT_RECORDED, Checks, Unjudged
from split_cli.logs.checking.directions import along_the_world, exchanged_accelerations, look_swapped, swap_finding
from split_cli.logs.checking.explanations import explain
from split_cli.logs.checking.frozen import frozen_channels
from split_cli.logs.checking.jumps import jumps
from split_cli.logs.checking.measuring_point import or_its_place, place_of_lateral_velocity
from split_cli.logs.checking.path import direction_of_travel, velocity_across, velocity_along, yaw_is_course
from split_cli.logs.checking.relations import ConsistencyFinding, Relation
from split_cli.logs.checking.torque_sides import torque_sides
from split_cli.logs.checking.unmoved import unmoved
from split_cli.logs.drive import Drive
from split_cli.logs.drive_metadata import is_derived
from split_cli.vehicle.parameters import Vehicle

__all__ = ["Consistency", "ConsistencyFinding", "Unjudged", "check_consistency", "corrected_columns"]

_IN_OTHERS = ("vx", "vy", "r", "X", "hand", "yaw")
"""Channels that others are judged by: with one of them put right, what stands beside it is measured again."""


@dataclass(frozen=True)
class Consistency:
    """What the checks found."""

    findings: tuple[ConsistencyFinding, ...] = ()  # what does not fit together; empty for a sound drive
    relations: tuple[Relation, ...] = ()  # every relation measured, also those that hold
    unjudged: tuple[Unjudged, ...] = ()
    # Channel to the signed factor that is in it, where one mistake is clearly the best explanation.
    factors: Mapping[str, float] = field(default_factory=dict)
    cost: float = 0.0  # of the explanation, as a negative logarithm [1]; 0 where all holds


def check_consistency(
    drive: Drive, vehicle: Vehicle | None, kinds: Mapping[str, str], certain: Collection[str] = (), slowest: float = 0.0
) -> Consistency:
    """Check a drive's channels against each other.

    Parameters
    ----------
    vehicle : Vehicle, optional
        Gives the wheelbase for the steer angle, the CG for v_y, mass and wheel radius for T.
    kinds : mapping of str to str
        Derived channels are not checked against what they were derived from.
    certain : collection of str
        What no mistake is looked for in: ``hand`` where X, Y are known to be east and north, ``yaw``.
    slowest : float
        Step between two samples of the channel that was recorded least often [s]: shorter motion is smoothed away
        in all of them, since it is not in that one.

    Notes
    -----
    Each relation measures a product of factors of two or three channels. `explain` weighs the known mistakes
    (a unit, a hand, a swap) that account for them. Where it is sure of one, what was wrong is corrected in a copy,
    and the finer checks (bias on straights, place of v_y, direction of yaw) are made on that.
    """
    checks = Checks(drive.columns, drive, vehicle, kinds, certain, slowest)
    constant = unmoved(checks)
    spoilt = [swap_finding(checks)] if look_swapped(checks) else along_the_world(checks)
    if not spoilt:
        checks.measure_relations()
        spoilt = changed_clock(checks)
    if spoilt:
        # Of exchanged channels, velocities along the world and a clock that is off nothing else can be judged.
        return Consistency((*constant, *spoilt), (), tuple(checks.unjudged))
    explanation = explain(checks.relations, vehicle, checks.magnitudes())
    found = [or_its_place(finding, checks) for finding in explanation.findings]
    factors, finer = dict(explanation.factors), checks
    vy_judged = _is_across_judged(checks)

    def of(columns: Mapping[str, np.ndarray]) -> Checks:
        # What was derived from the pose before it was right judges nobody.
        turned = {"X", "hand", "yaw"} & set(shared)
        own = {c: NOT_RECORDED if turned and is_derived(kind) else kind for c, kind in kinds.items()}
        return Checks(columns, drive, vehicle, own, certain, slowest)

    shared: dict[str, float] = {}
    while (known := {c: factors[c] for c in _IN_OTHERS if c in factors}) != shared:
        shared = known
        # The path may judge v_y now; where it does not, v_y has the unit of v_x.
        for judged in (True, False):
            finer = of(corrected_columns(drive.columns, shared, judged))
            finer.measure_relations()
            vy_judged = vy_judged or _is_across_judged(finer)
            if vy_judged:
                break
        again = explain(finer.relations, vehicle, finer.magnitudes())
        # What was put right may explain what nothing did.
        found = [f for f in found if f.check != "range" and f.channel not in explanation.unexplained]
        named = {finding.channel for finding in found}
        found += [_after(finding, shared) for finding in again.findings if finding.channel not in named]
        factors |= {c: f for c, f in again.factors.items() if c not in factors}
    if any(f.channel == "time" and f.check == "sign" for f in found):
        # Whatever needs a rate of change is judged when the rows are in order.
        reported, unjudged = tuple([*constant, *found]), tuple(dict.fromkeys(checks.unjudged))
        return Consistency(reported, _plain(checks), unjudged, factors, explanation.cost)
    if factors:
        corrected = of(corrected_columns(drive.columns, factors, vy_judged))
        corrected.measure_relations()  # what judges a channel judges it still
        corrected.unjudged, finer = finer.unjudged, corrected
    wrong = {finding.channel for finding in found} - set(factors) - ({"X"} if "hand" in factors else set())
    # Whether v_y has the unit of v_x is open: a place that only one of the two gives is none.
    in_doubt = "vx" in factors and not vy_judged and not {"vx", "r"} & wrong
    as_it_is = of({**finer.k.columns, "vy": drive.columns["vy"]}) if in_doubt else None
    findings = _with_compass(_fine(finer, as_it_is, wrong, [*constant, *found]))
    unjudged = dict.fromkeys([*checks.unjudged, *finer.unjudged])
    return Consistency(findings, _plain(checks), tuple(unjudged), factors, explanation.cost)


def _is_across_judged(checks: Checks) -> bool:
    return any(relation.name == ACROSS for relation in checks.relations)


def _fine(
    finer: Checks, as_it_is: Checks | None, wrong: Collection[str], findings: Sequence[ConsistencyFinding]
) -> list[ConsistencyFinding]:
    """Return findings with those of the finer checks: places, biases, grip, sides and directions.

    Parameters
    ----------
    finer : Checks
        Of the columns with what is known put right.
    as_it_is : Checks or None
        The same with v_y as recorded, where that may be right.
    wrong : collection of str
        Channels that are off by what nothing tells: they judge no other.
    findings : sequence of ConsistencyFinding
        Those so far.
    """
    exchanged = exchanged_accelerations(finer)
    findings = [*findings, *exchanged, *frozen_channels(finer)]
    if "vx" not in wrong:
        judged = not {"vy", "time"} & set(wrong)  # what accelerating takes hangs on them
        sides = torque_sides(finer, wrong, any(f.channel == "T" for f in findings)) if judged else []
        # Where they differ, no one factor puts T right.
        findings = [f for f in findings if not sides or f.channel != "T"] + [*jumps(finer), *sides]
    elif finer.torque_parts() is not None:
        finer.unjudged.append(Unjudged("T where the car is driven and braked", "v_x is off by what nothing tells"))
    if not {"vx", "r"} & set(wrong):
        across_is_right = not {"ay", "vy"} & set(wrong)
        placed = place_of_lateral_velocity(finer, across_is_right)
        if as_it_is is not None and placed:
            placed = place_of_lateral_velocity(as_it_is, across_is_right) and placed
        # Of a v_y that is off by what nothing tells, neither bias nor grip can be judged.
        findings += [f for f in finer.straight_line() if f.channel != "vy" or "vy" not in wrong]
        findings += [*placed, *(finer.grip() if "vy" not in wrong else ())]
    if "r" not in wrong:
        findings += finer.wheel_sides()
    if not {"X", "Y", "yaw"} & set(wrong):
        useless = [*velocity_across(finer), *velocity_along(finer)]
        findings += [*direction_of_travel(finer, not useless), *useless, *yaw_is_course(finer)]
    # Along another axis, an acceleration tells nothing of a tilt or a bias.
    along = {finding.channel for finding in exchanged}
    return [f for f in findings if f in exchanged or f.channel not in along or f.check == "constant"]


def _plain(checks: Checks) -> tuple[Relation, ...]:
    """Return the relations without functions: these were for the search, and results travel between processes."""
    return tuple(replace(relation, corrected=None) for relation in checks.relations)


def _after(finding: ConsistencyFinding, shared: Mapping[str, float]) -> ConsistencyFinding:
    """Say in a finding of the second look what was put right before it."""
    names = " and ".join("X, Y" if channel == "hand" else channel for channel in shared)
    return replace(finding, text=f"with {names} put right, {finding.text}")


def corrected_columns(
    columns: Mapping[str, np.ndarray], factors: Mapping[str, float], vy_judged: bool = True
) -> dict[str, np.ndarray]:
    """Return the columns with known factors taken out.

    Parameters
    ----------
    columns : mapping of str to ndarray, shape (N,)
    factors : mapping of str to float
        Of `Consistency`.
    vy_judged : bool
        Whether v_y was compared with the path; else it has the factor of v_x, of one sensor.
    """
    made = dict(columns)
    together = {"vx": ("vx",) if vy_judged else ("vx", "vy"), "X": ("X", "Y")}
    for channel, factor in factors.items():
        for name in together.get(channel, (channel,)):
            if name in made:
                made[name] = made[name] / factor
    if "hand" in factors:
        made["X"], made["Y"] = made["Y"], made["X"]
    return made


def _with_compass(findings: Sequence[ConsistencyFinding]) -> tuple[ConsistencyFinding, ...]:
    """Make one finding of a yaw that turns the wrong way and starts at another zero: a compass does both."""
    turned = next((f for f in findings if f.channel == "yaw" and f.check in ("sign", "scale")), None)
    zero = next((f for f in findings if f.check == "direction"), None)
    if turned is None or zero is None:
        return tuple(findings)
    mirrored = next((f for f in findings if f.channel == "X" and f.check == "sign"), None)
    evidence = turned.text.split("). ", 1)[0] + ")"
    remedies = {turned: turned.text}
    if abs(zero.measured - 0.5 * np.pi) > 0.15:
        zero_words = f"its zero is {np.degrees(zero.measured):+.1f} deg off the map's X axis"
        remedies[turned] = f"{turned.text} Then {zero_words}: add `offset: {zero.measured:.4f}` rad."
    elif mirrored is not None:
        ned = "it is a compass bearing and X, Y are north and east. Set `world: ned` in the map"
        remedies[turned] = f"{evidence}: {ned}, which puts both right."
        remedies[mirrored] = f"{mirrored.text.split('). ', 1)[0]}): see yaw, `world: ned` puts both right."
    else:
        remedies[turned] = (
            f"{evidence}: it is a compass bearing, clockwise from north, while X and Y are east and north. Write "
            "`world: ned` into the entry of yaw alone, not into the whole map, which would exchange X and Y."
        )
    is_compass = abs(zero.measured - 0.5 * np.pi) <= 0.15
    checks = {turned: "compass"} if is_compass else {}
    return tuple(
        replace(f, text=remedies.get(f, f.text), check=checks.get(f, f.check)) for f in findings if f is not zero
    )
