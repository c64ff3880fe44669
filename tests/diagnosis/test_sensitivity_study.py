"""The study of the policy's numbers: a run that parts where a number turns something against a run a number."""

import math

import numpy as np
import pytest

from split_cli.diagnosis.policy import STANDARD, deciding_numbers
from tests.studies import policy
from tests.studies.policy import altered, with_numbers
from tests.studies.probing import outcomes, turned

VALUES = np.linspace(0.0, 3.0, 61)
NUMBERS = {"level": 1.0, "margin": 2.0, "count": 3, "share": 0.25, "unread": 5.0, "slack": 1e-9, "small": 0.1}


def procedure(numbers):
    """Compare, multiply, index and convert: every way in which code reads a number."""
    chosen = VALUES[numbers["level"] < VALUES]
    first = chosen[: numbers["count"]]
    allowed = numbers["margin"] * (1.0 + numbers["share"]) - 0.5
    verdict = "large" if first.mean() > allowed else "small"
    root = math.sqrt(numbers["margin"])
    best = max(numbers["small"], 0.5)  # neither half nor twice of it is above one half
    if first.size < numbers["slack"]:
        verdict = "none"
    blocks = int(np.ceil(7.5 / numbers["margin"]))
    return verdict, float(first.sum()), round(root, 12), float(best), float(np.sqrt(numbers["share"])), blocks


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_every_altered_outcome_is_that_of_a_run_of_its_own():
    told = []
    numbers = {
        name: {factor: altered(value, factor) for factor in (1.0, 0.5, 2.0)} for name, value in NUMBERS.items()
    }
    plain, found = outcomes(procedure, numbers, lambda name, factor, outcome: told.append((name, factor)))
    assert plain == procedure(NUMBERS)
    for name, values in numbers.items():
        for factor in (0.5, 2.0):
            alone = procedure({**NUMBERS, name: values[factor]})
            assert found.get((name, factor), plain) == alone, (name, factor)
    assert sorted(told) == sorted(found)
    never = {name for name in NUMBERS if (name, 0.5) not in found and (name, 2.0) not in found}
    assert never == {"unread", "slack", "small"}  # nothing was run for these


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_run_that_fails_with_an_altered_number_is_no_outcome(capfd):
    def failing(numbers):
        if numbers["level"] > 1.5:
            raise ZeroDivisionError("only when doubled")
        return 1

    with pytest.raises(RuntimeError, match="level times 2 ended without an outcome"):
        outcomes(failing, {"level": {1.0: 1.0, 2.0: 2.0}})
    assert "only when doubled" in capfd.readouterr().err


def test_numbers_are_altered_by_name_and_counts_stay_whole():
    assert [altered(3, 0.5), altered(1, 0.5), altered(3, 2.0), altered(0.3, 0.5)] == [2, 1, 6, 0.15]
    group, one, value = next(iter(deciding_numbers()))
    other = with_numbers({f"{group}.{one.name}": 2.0 * value})
    assert getattr(getattr(other, group), one.name) == 2.0 * value
    assert other.altered(group, **{one.name: value}) == STANDARD


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_survey_names_what_may_matter_and_misses_nothing_that_does():
    numbers = {name: {k: altered(value, k) for k in (1.0, 0.5, 2.0)} for name, value in NUMBERS.items()}
    plain, differ = turned(procedure, numbers)
    assert plain == procedure(NUMBERS)
    changing = {
        (name, factor)
        for name, values in numbers.items()
        for factor in (0.5, 2.0)
        if procedure({**NUMBERS, name: values[factor]}) != plain
    }
    assert changing <= differ and not {name for name, _ in differ} & {"unread", "slack", "small"}


def test_a_survey_asks_every_case_of_the_folder_and_none_is_told(tmp_path, monkeypatch, capsys):
    asked = []
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.setattr(policy, "use_threads", lambda count: None)
    monkeypatch.setattr(policy, "study", lambda folder, groups, cases, rows, follow: asked.append((cases, follow)))
    command = [str(tmp_path), "--survey", "-o", str(tmp_path / "rows.csv")]
    with pytest.raises(SystemExit):
        policy.main(command)
    assert "has no cases to survey" in capsys.readouterr().err
    for name in ("0002", "0011"):
        (tmp_path / "cases" / name).mkdir(parents=True)
    policy.main(command)
    policy.main([*command, "--cases", "2"])
    assert asked == [([2, 11], False), ([2], False)]
