"""Every number that decides is in one place, says what it is and where it comes from, and decides."""

import ast
from collections import Counter
from collections.abc import Iterator
from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest

from split_cli.diagnosis.policy import STANDARD, deciding_numbers

#: Constants that do not decide on a difference, its name or its size, by kind and name. A group stands for all of its
#: constants that no other kind names. Guards refuse a recording or leave rows out, effort bounds computing time, and
#: "report" chooses what a report says of a gap.
KINDS = {
    kind: tuple(names.split())
    for kind, names in {
        "guards": """
            screening comparison.least_rows comparison.least_share believing.rolling_share believing.lost_share
            believing.rolling_seconds believing.least_rolling believing.cycling_seconds believing.cycling_share
            believing.settling unnamed.fewest""",
        "effort": """
            selection.few_names selection.full_fits selection.considered selection.rounds selection.swaps
            selection.beginnings""",
        "report": """
            comparison.holdout_share abstention.most_leads reporting.least_dependence reporting.clearly_more
            reporting.local_gap reporting.local_ratio reporting.stable reporting.formula_terms reporting.much_slipping
            reporting.least_compared""",
    }.items()
}
DECIDES = "decides"
# A sensor out of scale is a difference, whatever the drives show otherwise.
_SCALES = ("screening.least_scale_error", "screening.sure_scale_error")

ROOT = Path(__file__).resolve().parents[2] / "split_cli" / "diagnosis"


@pytest.mark.parametrize(
    ("group", "one", "value"), [pytest.param(*entry, id=f"{entry[0]}-{entry[1].name}") for entry in deciding_numbers()]
)
def test_a_number_says_its_unit_its_meaning_and_its_origin(group, one, value):
    assert isinstance(value, int | float)
    assert one.metadata["unit"] and len(one.metadata["meaning"].split()) >= 4
    kind, colon, reason = one.metadata["origin"].partition(": ")
    assert kind in ("theory", "study", "judgement") and colon and reason


def test_a_policy_is_frozen_and_altered_by_name_only():
    with pytest.raises(FrozenInstanceError):
        STANDARD.comparison.level = 0.5
    with pytest.raises(TypeError):
        STANDARD.altered("comparison", levle=0.5)
    other = STANDARD.altered("comparison", level=0.5)
    assert (other.comparison.level, other.selection) == (0.5, STANDARD.selection)


def test_a_diagnosis_lists_every_number_once():
    names = [(group, one.name) for group, one, _ in deciding_numbers()]
    described = STANDARD.described()
    assert len(described) == len(names) and described["level"] == STANDARD.comparison.level
    assert described["selection_price"] == STANDARD.selection.price


def kind_of(name: str) -> str:
    """Return the kind of a constant by its name `group.number`: a key of `KINDS`, or `DECIDES`."""
    if name in _SCALES:
        return DECIDES
    group = name.partition(".")[0]
    return next((kind for kind, names in KINDS.items() if name in names or group in names), DECIDES)


#: Numbers of each kind at most. They only fall: who adds one takes one out, or says here why not. Five guards more
#: are no new ones: `least_acceleration` to `fewest_rows` stood bare in the functions of `recording.screening`.
#: `settling` leaves out the begin of a stretch, which was compared before as if nothing had gone on until then.
MOST = {DECIDES: 36, "guards": 31, "effort": 6, "report": 10}


def test_numbers_of_every_kind_only_fall():
    counts = Counter(kind_of(f"{group}.{one.name}") for group, one, _ in deciding_numbers())
    assert sum(counts.values()) == len(STANDARD.described())
    assert all(counts[kind] <= most for kind, most in MOST.items()), counts


def test_every_name_that_has_a_kind_is_a_number_or_a_group():
    known = {f"{group}.{one.name}" for group, one, _ in deciding_numbers()}
    groups = {name.partition(".")[0] for name in known}
    assert not [name for names in KINDS.values() for name in names if name not in known | groups]


def test_every_number_is_read_somewhere():
    """A field that no module of the diagnosis reads decides nothing."""
    elsewhere = [path for path in ROOT.rglob("*.py") if not path.name.startswith("policy")]
    sources = [path.read_text(encoding="utf-8") for path in elsewhere]
    nodes = [node for source in sources for node in ast.walk(ast.parse(source))]
    read = {node.attr for node in nodes if isinstance(node, ast.Attribute)}
    unread = [f"{group}.{one.name}" for group, one, _ in deciding_numbers() if one.name not in read]
    assert not unread


# Numbers that stand beside their algorithm: how finely something is computed, told or averaged, or how long a
# search may take. A new name here is a decision to be looked at; what decides belongs into the policy.
BESIDE_THEIR_ALGORITHM = {
    "baseline/_functions_numba.py": {"_SAMPLES_AT_A_TIME"},
    "baseline/discrepancy.py": {"_SMOOTH_DEVIATION", "_COLUMNS_AT_A_TIME"},
    "baseline/tires.py": {"_SLIP_STEP", "_MOST_SCALED"},
    "innovations/autocovariance.py": {"LAG_ROWS"},
    "innovations/case.py": {"_MOST_PASSES", "_SETTLED"},
    "innovations/evidence.py": {"ROW_SECONDS", "_TUNING_ROWS", "_KEPT_BYTES"},
    "innovations/linearisation.py": {"_UNRESOLVED", "_STEP"},
    "innovations/objective.py": {"_BLOCK_SECONDS", "_LISTS_AT_A_TIME", "_LEAST_INFORMED", "_REMEMBERED", "_SHIFTS"},
    "innovations/projection.py": {"_FEW"},
    "innovations/rollouts.py": {"_STEP_SECONDS", "_MOST_STARTS", "_FEWEST_STARTS"},
    "innovations/effect_to_noise.py": {"_HORIZON", "_ROWS_AT_A_TIME"},
    "innovations/shared_terms.py": {"_BEGIN", "_LEAST"},
    "recording/windows.py": {"_WINDOW_SECONDS", "_EDGE_SECONDS", "LEAST_WINDOWS"},
    "recording/witnesses.py": {"_LEAST_SPREAD"},
    "recording/scales.py": {"_BLOCKS"},
    "recording/excitation.py": {"_STEP_SECONDS", "_OUTER_SHARE"},
    "recording/segment_means.py": {"SMOOTHED_SECONDS"},
    "recording/predicted_states.py": {"_SLACK", "_NEGLIGIBLE_NOISE"},
    "recording/vehicle_match.py": {"_MOST_ROWS"},
    "recording/series.py": {"_PARTS", "_WORTHLESS", "REMEMBERED", "VISIBLE"},
    "recording/straights.py": {"_BLOCK_SECONDS", "_FEWEST_BLOCKS"},
    "remainder/flexible.py": {"_HARMONICS", "_KNOTS"},
    "remainder/formula.py": {"_ROWS_APART", "_SUBSAMPLES", "_BLOCK_SECONDS"},
    "remainder/location.py": {"_AVERAGE_SECONDS", "_ALIKE", "_FOLDS"},
    "remainder/oscillation.py": {"_APART", "_DAMPING", "_RANK"},
    "remainder/spectrum.py": {"_BACKGROUND", "_LARGEST"},
    "remainder/structure.py": {"_RIDGE_SHARE"},
    "remainder/autocorrelation.py": {"_NEAR_ROWS"},
    "search/self_test.py": {"_BINS", "_SHARES", "_WAVES"},
    "search/candidates.py": {"_NEAR"},
    "search/form_error.py": {"_ROWS_AT_A_TIME"},
    "search/fitting.py": {"RIDGE", "_ITERATIONS", "_JOINT_ITERATIONS", "_LEAST_GAIN", "_PLACES", "_MOST_UPDATE_ERROR"},
    "search/joint.py": {"_NEAR_NEUTRAL", "_NO_EFFECT", "_TRIED"},
    "search/parts_of_drive.py": {"_MOST_BLOCKS"},
    "search/delay_minima.py": {"_APART"},
    "search/variant_choice.py": {"_TINY"},
    # Memory: what is not held is worked out anew, see test_exploration.py.
    "search/exploration.py": {"Explorer.held"},
    # How many threads run.
    "parallel.py": {"_MOST", "_threads"},
    # How many ways of driving there are, and when the report says a word of what has been found.
    "engine.py": {"_REACHES", "_TESTS"},
    "statement/improvement.py": {"NORMAL_95", "_SHOWS"},
    "statement/result.py": {"_AS_GOOD"},
    "statement/sentences.py": {"_WORTH_A_WORD", "_CLEARLY", "_STANDS_FOR", "_MUCH_OF_ERROR"},
    # Grids, blocks and iterations of what is said of names that the search chose, and of held-out errors.
    "verdict/constancy.py": {"_WAVES", "_FREE"},
    "verdict/corrected_vehicle.py": {"_STEP"},
    "verdict/learned_correction.py": {"_FEWEST_TO_LEARN", "_FOLDS", "_STARTS", "_BEYOND_CHANCE"},
    "verdict/detectable.py": {"_ROUNDS", "_FURTHEST", "_GROWTH", "_LEAST_GROWTH"},
    "verdict/faulty_commands.py": {"_POWERS"},
    "verdict/tolerance.py": {"_WORTH_A_LEAD"},
    "verdict/estimates.py": {"_CHI2_95", "_COLLINEAR"},
    "verdict/findings.py": {"_SHOWN_RIVALS", "_SCALE_STEP"},
    "verdict/improvement.py": {"_BOOTSTRAPS", "_MOSTLY"},
    "verdict/joint_region.py": {"_STEPS"},
    "verdict/label_errors.py": {"BLOCK_SECONDS", "_WANTED_BLOCKS", "_SHORTEST_BLOCK"},
    "verdict/power.py": {"_PREDICTED_SECONDS"},
    "verdict/simulation_part.py": {"_CHECKED_SHARE", "_STARTS"},
}


def test_no_module_takes_a_multiple_of_a_number_of_the_policy():
    """A factor beside a field is a number of its own: a derived size stands on the policy as a property."""
    known, factors = {one.name for _, one, _ in deciding_numbers()}, []
    for path in sorted(one for one in ROOT.rglob("*.py") if not one.name.startswith("policy")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult | ast.Div)):
                continue
            for factor, of in ((node.left, node.right), (node.right, node.left)):
                if isinstance(factor, ast.Constant) and isinstance(of, ast.Attribute) and of.attr in known:
                    factors += [f"{path.name}: {ast.unparse(node)}"] * (float(factor.value) != 1.0)
    assert not factors


def is_a_number(value: ast.expr | None) -> bool:
    """Return whether an expression is a number, or made of numbers alone."""
    if isinstance(value, ast.UnaryOp):
        return is_a_number(value.operand)
    if isinstance(value, ast.BinOp):
        return is_a_number(value.left) and is_a_number(value.right)
    return isinstance(value, ast.Constant) and type(value.value) in (int, float)


def numbers_in(node: ast.AST, owner: str = "") -> Iterator[tuple[str, ast.expr]]:
    """Yield names and values of a tree's numbers: of modules and classes, fields with defaults, and parameters."""
    for one in ast.iter_child_nodes(node):
        if isinstance(one, ast.Assign | ast.AnnAssign):
            fields = [word for word in getattr(one.value, "keywords", ()) if word.arg == "default"]
            names = [ast.unparse(name) for name in getattr(one, "targets", [getattr(one, "target", None)])]
            values = [one.value, *(word.value for word in fields)]
            yield from ((owner + name, value) for name in names for value in values if is_a_number(value))
        if isinstance(one, ast.FunctionDef):
            places = [*one.args.posonlyargs, *one.args.args][::-1]
            pairs = [*zip(places, one.args.defaults[::-1], strict=False)]
            pairs += zip(one.args.kwonlyargs, one.args.kw_defaults, strict=True)
            yield from ((f"{owner}{one.name}.{name.arg}", value) for name, value in pairs if is_a_number(value))
        else:  # not the local names of a function
            yield from numbers_in(one, f"{one.name}." if isinstance(one, ast.ClassDef) else owner)


def test_numbers_of_classes_fields_and_parameters_are_seen():
    source = """
A = -2
class C:
    b = 2**3
    c: int = field(default=4)
    d: int = 5
    def f(self, x, y=6, *, z: float = 7.0, on=True): pass
"""
    found = {name: ast.unparse(value) for name, value in numbers_in(ast.parse(source))}
    assert found == {"A": "-2", "C.b": "2 ** 3", "C.c": "4", "C.d": "5", "C.f.y": "6", "C.f.z": "7.0"}


def test_no_number_that_decides_stands_outside_the_policy():
    """None and one are what is, or is counted, where nothing is given; they choose nothing."""
    unknown = []
    for path in sorted(ROOT.rglob("*.py")):
        file = path.relative_to(ROOT).as_posix()
        if not file.startswith("policy"):
            for name, value in numbers_in(ast.parse(path.read_text(encoding="utf-8"))):
                neutral = "." in name and ast.unparse(value) in ("0", "0.0", "1", "1.0")
                if not neutral and name not in BESIDE_THEIR_ALGORITHM.get(file, set()):
                    unknown.append(f"{file}: {name}")
    assert not unknown, "give these a field of the policy, or say beside which algorithm they stand"
