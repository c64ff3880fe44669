"""What may be called a finding: an effect whose interval leaves out that there is none."""

from types import SimpleNamespace

import numpy as np
import pytest

from split_cli.diagnosis.policy import STANDARD
from split_cli.diagnosis.remainder.flexible import flexible_rows
from split_cli.diagnosis.remainder.structure import build_structure
from split_cli.diagnosis.search.baselines import SearchOutcome
from split_cli.diagnosis.search.fitting import Fit
from split_cli.diagnosis.search.selection import Selection
from split_cli.diagnosis.search.self_test import SelfTest
from split_cli.diagnosis.statement.result import Finding, ParameterEstimate
from split_cli.diagnosis.verdict import findings
from split_cli.diagnosis.verdict.constancy import Bend
from split_cli.diagnosis.verdict.findings import describe, excludes_no_effect
from split_cli.logs.drive_metadata import DriveMetadata
from tests.diagnosis.recordings import INFLATION

RULES = STANDARD.abstention


def test_values_hold_with_and_without_what_is_not_believed():
    """A scale of 0.68 (0.57 to 0.78) alone, 0.45 (0.34 to 0.56) beside what left: either may be."""
    alone = {"scale": ParameterEstimate(0.68, 0.05, "1", (0.57, 0.78))}
    covering = findings._covering(alone, {"scale": ParameterEstimate(0.45, 0.05, "1", (0.34, 0.56))})
    assert covering["scale"].value == 0.68 and covering["scale"].interval_95 == (0.34, 0.78)
    assert findings._covering(alone, {}) == alone


def test_what_only_nameless_terms_explain_is_unexplained(pair, chosen_pair, discrepancy):
    """Yaw inertia and drag: where the drag stays in the fit without a name, the drag's share has none."""
    (evidence,) = pair.evidence
    structure = build_structure(pair, [flexible_rows(evidence, discrepancy)])
    gap = structure.fit(chosen_pair.base.residuals, INFLATION)
    without_drag = findings._nameless(chosen_pair, {"aero_drag"})
    said = {}
    for name, selection in (("both", chosen_pair), ("inertia", without_drag)):
        said[name] = describe(SearchOutcome(structure, gap, selection, SelfTest(), INFLATION))
    assert not said["both"].unexplained and said["both"].remainder.effect_to_noise < 0.1
    assert [one.term for one in said["inertia"].findings] == ["yaw_inertia"] and said["inertia"].unexplained
    # No less is left than the drag does.
    drag = next(one for one in said["both"].findings if one.term == "aero_drag")
    assert said["inertia"].remainder.effect_to_noise > drag.effect_to_noise > STANDARD.allowances.large
    assert said["inertia"].remainder.p_value < 1e-6 < said["both"].remainder.p_value


def test_a_term_that_is_not_singled_out_stays_in_the_fit_without_a_name():
    def part(term: str) -> SimpleNamespace:
        return SimpleNamespace(candidate=SimpleNamespace(term=term))

    chosen = Fit(tuple(map(part, ("cg_shift", "mass", "wind"))), 0.0, np.zeros(3), np.zeros((3, 3)))
    selection = Selection(chosen, chosen, (), (), (), (True, True, False))
    found = findings._nameless(selection, {"mass"})
    assert found.named == (True, False, False) and found.chosen is chosen


def test_what_ends_at_what_a_car_can_have_is_nameless_by_its_share():
    """Of 100 explained, 40 only by tyres without a name, 8 by a steering that may be theirs: no names.

    A bank that is merely too small to name takes none.
    """
    ends = {"steer_gain": False, "tire_stiffness": True, "road_bank": False}
    parts = tuple(
        SimpleNamespace(candidate=SimpleNamespace(term=term, at_limit=lambda end: end), values=end)
        for term, end in ends.items()
    )

    def fit(cost: float) -> Fit:
        return Fit(parts, cost, np.zeros(3), np.zeros((3, 3)))

    selection = Selection(fit(110.0), fit(10.0), (fit(18.0), fit(50.0), fit(30.0)), (), (), (True, False, False))
    nameless = findings._nameless_shares(selection)
    assert nameless == {"tire_stiffness": 0.4}
    assert findings._nameless_shares(selection, {"road_bank"}) == {"tire_stiffness": 0.4, "road_bank": 0.2}
    told, left = [SimpleNamespace(term="steer_gain", gap_explained=0.08)], SimpleNamespace(share=0.0)
    assert findings._possibly_imitating(told, left, (), RULES) == set()
    assert findings._possibly_imitating(told, left, (), RULES, nameless) == {"steer_gain", "tire_stiffness"}


def finding(term: str, **intervals: tuple[float, float]) -> Finding:
    parameters = {
        name: ParameterEstimate(0.5 * sum(interval), 0.25 * (interval[1] - interval[0]), "1", interval)
        for name, interval in intervals.items()
    }
    return Finding(term, "", parameters, 0.5, (), "", 1.0)


@pytest.mark.parametrize(
    ("term", "intervals", "expected"),
    [
        ("sensor_misalignment", {"angle": (-0.0034, 0.0003)}, False),  # turned either way, or not at all
        ("sensor_misalignment", {"angle": (-0.0034, -0.0003)}, True),
        ("mass", {"scale": (0.97, 1.04)}, False),  # neutral is a scale of one
        ("mass", {"scale": (1.01, 1.04)}, True),
        # One half of a gain may be as it should be, if the other is not.
        ("drive_gain", {"drive_gain": (0.995, 1.005), "brake_gain": (0.84, 0.86)}, True),
        ("drive_gain", {"drive_gain": (0.995, 1.005), "brake_gain": (0.95, 1.02)}, False),
    ],
)
def test_a_finding_leaves_out_that_there_is_no_effect(term, intervals, expected):
    assert excludes_no_effect(finding(term, **intervals)) is expected


def test_what_explains_no_more_than_is_left_and_its_untrusted_look_alikes_has_no_name():
    """0.092 of the whole for the centre of gravity: more than the 0.08 left, less with a stiffness's 0.028."""
    left = SimpleNamespace(share=0.08)
    shares = {"friction_scale": 0.6, "cg_shift": 0.1, "tire_stiffness": 0.03}
    told = [SimpleNamespace(term=term, gap_explained=share) for term, share in shares.items()]
    assert findings._possibly_imitating(told, left, (), RULES) == {"cg_shift", "tire_stiffness"}
    assert findings._possibly_imitating(told[:2], left, (), RULES) == set()
    # A lag of the drive looks like neither.
    beside = SimpleNamespace(term="drive_lag", gap_explained=0.1)
    assert findings._possibly_imitating([*told, beside], left, (), RULES) == {"cg_shift", "tire_stiffness"}
    # A stiffness that stays in the fit without a name explains no less for that.
    without, beside = [told[0], told[1]], {"tire_stiffness": 0.03}
    assert findings._possibly_imitating(without, left, (), RULES, beside) == {"cg_shift", "tire_stiffness"}
    assert findings._possibly_imitating(without, left, (), RULES, {"drive_lag": 0.5}) == {"drive_lag"}
    # What has to bend by the greater part of itself stands for something else, and so may what looks like it.
    nothing_left = SimpleNamespace(share=0.0)
    for size, out in ((0.3, set()), (0.7, {"cg_shift", "tire_stiffness"})):
        bent = [Bend("cg_shift", "front slip", size, 1e-9)]
        assert findings._possibly_imitating(told, nothing_left, bent, RULES) == out


@pytest.mark.parametrize(
    ("inflation", "columns", "left", "declared"),
    [
        (30.0, "vx vy r ay", 10.0, {"cg_shift+tire_stiffness", "tire_stiffness"}),
        (30.0, "vx vy r ay", 5.0, set()),  # the accelerometer bears it out
        (30.0, "vx vy r ay X Y yaw", 10.0, set()),
        (2.0, "vx vy r ay", 10.0, set()),  # the shape of the effect tells
    ],
)
def test_a_missing_channel_leaves_look_alikes_where_neither_shape_nor_witness_tells(inflation, columns, left, declared):
    own = SimpleNamespace(term="sensor_lever_arm", variant="")
    part = SimpleNamespace(candidate=own, term=SimpleNamespace(corrects=True))
    selection = SimpleNamespace(
        chosen=SimpleNamespace(parts=(part,), residuals=left), without=(SimpleNamespace(residuals=10.0),)
    )
    metadata = DriveMetadata()
    drive = SimpleNamespace(columns=dict.fromkeys(columns.split()), metadata=metadata)
    objective = SimpleNamespace(
        posterior=None,
        form_error_inflation=inflation,
        policy=STANDARD,
        evidence=(SimpleNamespace(series=SimpleNamespace(drive=drive)),),
        witnesses_cost=lambda residuals: residuals,
    )
    assert set(findings._declared(objective, selection, own)) == declared
