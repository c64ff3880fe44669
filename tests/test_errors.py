"""The text a user reads: what, where, what to do, on one line; and the nearest names."""

import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from split_cli import errors
from split_cli.errors import LogError, MapError, SplitError, VehicleError, nearest_names


def test_text_has_place_fault_and_advice_in_this_order():
    error = MapError("unknown unit 'kmq'", where="map.yaml, vx", advice="Did you mean km/h?")
    assert str(error) == "map.yaml, vx: unknown unit 'kmq'. Did you mean km/h?"


def test_text_without_place_or_advice_is_the_fault_alone():
    assert str(SplitError("the log is empty")) == "the log is empty"


def test_no_double_full_stop_before_the_advice():
    assert str(SplitError("is empty.", advice="Record again.")) == "is empty. Record again."


@pytest.mark.parametrize("name", [name for name in errors.__all__ if name.endswith("Error")])
def test_every_error_is_of_the_family_the_command_line_maps(name):
    assert issubclass(getattr(errors, name), SplitError)


@pytest.mark.parametrize(
    "error",
    [
        LogError("truncated", where="a.mcap", advice="Record again."),
        VehicleError("lacks mass"),
        SplitError("full", where="b"),
    ],
)
def test_an_error_survives_the_way_back_from_a_worker_process(error):
    # Process pools send exceptions by pickling them; an exception whose constructor has keyword-only arguments
    # does not survive by itself.
    back = pickle.loads(pickle.dumps(error))
    assert type(back) is type(error)
    assert (str(back), back.what, back.where, back.advice) == (str(error), error.what, error.where, error.advice)


def test_an_error_message_stays_on_one_line_whatever_it_quotes():
    error = SplitError("cannot be read (line one\nline two)", where="odd\nname.csv")
    assert "\n" not in str(error)


def test_nearest_names_finds_a_misspelling_and_another_case():
    known = ["mass", "yaw_inertia", "wheel_radius"]
    assert nearest_names("mas", known) == "Did you mean mass?"
    assert "yaw_inertia" in nearest_names("YAW_INERTIA", known)


def test_nearest_names_lists_what_there_is_when_nothing_is_near():
    assert nearest_names("zzz", ["mass", "name"]) == "There are: mass, name."
    assert nearest_names("zzz", []) == "There are none."
    many = nearest_names("zzz", [f"q{i:02d}" for i in range(20)])
    assert many.endswith("and 8 more.")
    assert "q11" in many
    assert "q12" not in many


@given(st.lists(st.text(min_size=1, max_size=12), min_size=1, max_size=8))
def test_a_known_name_is_always_its_own_nearest(names):
    assert names[0] in nearest_names(names[0], names)


def test_an_error_fills_no_more_than_a_screen():
    """Names are others' text; what to do stands at the end and stays."""
    text = str(SplitError(f"no unit {'m' * 10**6!r}", where="car.yaml", advice="Did you mean m?"))
    assert text.startswith("car.yaml: no unit 'mmm") and text.endswith("mm'. Did you mean m?") and len(text) < 2100
    assert str(SplitError("x" * 1990)) == "x" * 1990
    # Control characters are told as four characters each, and count as such.
    assert len(str(SplitError("\x1b" * 1500))) == len(str(SplitError("x" * 5000))) == 2000
