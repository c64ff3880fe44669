"""What a race chooses to learn after a lap, and what it says of laps with and without learning."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from split_cli.learning.features import parse_features
from split_cli.learning.training_set import read_set
from split_cli.logs.drive import read_drive
from split_cli.vehicle.parameters import read_vehicle
from split_cli.workflows.racing import choice as choice_of_features
from split_cli.workflows.racing import driving
from split_cli.workflows.racing.choice import (
    FeatureChoice,
    advice_after_lap_0,
    choose_features,
    whether_learning_helped,
)
from split_cli.workflows.racing.driving import Race
from split_cli.workflows.racing.first_lap import header_without_kernel, with_past_term
from split_cli.workflows.racing.result import Lap
from split_cli.workflows.racing.settings import CANDIDATES, RaceSettings
from tests.control.courses import CAR, ROOT, first_rows


def test_lap_0_chooses_what_is_learned():
    lap = first_rows(read_drive(ROOT / "sample_logs" / "road_pair_real.parquet"), 1000)
    vehicle, _ = with_past_term(read_vehicle(CAR), parse_features(CANDIDATES[-1]))
    choice = choose_features([lap], vehicle, RaceSettings())
    # Actuators of the plant lag, and the vehicle file does not: the past predicts better.
    left = [float(share) for share in re.findall(r"(\d+) % with", choice.reason)]
    assert choice.features == "z2,feature_lag" and left[1] < left[0] < 100 and not choice.undecided
    assert choose_features([lap], vehicle, RaceSettings(features="z2")) == ("z2", "", False)
    short = choose_features([first_rows(lap, 30)], vehicle, RaceSettings())
    assert short.features == "z2" and "cannot choose" in short.reason and short.undecided


@pytest.mark.parametrize(("behind", "undecided"), [(0.9, True), (1.1, False)])
def test_a_choice_is_undecided_within_one_standard_error(monkeypatch, behind, undecided):
    found = [
        SimpleNamespace(features=name, error=0.5, behind=more, behind_error=1.0, chosen=name == "z2")
        for name, more in (("z2,feature_lag", behind), ("z2", 0.0))
    ]
    monkeypatch.setattr(choice_of_features, "select", lambda *given: SimpleNamespace(candidates=found))
    choice = choose_features([None, None], read_vehicle(CAR), RaceSettings())
    assert (choice.features, choice.undecided) == ("z2", undecided)
    assert "laps 0 to 1" in choice.reason and ("next lap decides again" in choice.reason) == undecided


def test_a_choice_that_later_laps_turn_learns_all_laps_as_if_it_had_been_made_at_once(tmp_path, monkeypatch):
    drive = read_drive(ROOT / "sample_logs" / "road_pair_real.parquet")
    settings = RaceSettings(hyperparameters="default")
    choices: list[FeatureChoice] = []
    monkeypatch.setattr(driving, "choose_features", lambda *given: choices.pop(0))
    monkeypatch.setattr(driving, "ControlModel", lambda *given: given)

    def race(file):
        one = Race(settings, read_vehicle(CAR), tmp_path / file, lambda text: None)
        one.header = header_without_kernel(one.vehicle, one.features, one.mpcc)
        one.world = SimpleNamespace(
            recording=lambda first, last, name: replace(
                drive,
                name=name,
                segment=drive.segment[first:last],
                columns={key: column[first:last] for key, column in drive.columns.items()},
            )
        )
        one.controller = SimpleNamespace(grip=np.ones(2), model=None)
        return one

    def end_laps(one, *numbers):
        for number in numbers:
            one.spans[number] = (1000 + 300 * number, 1301 + 300 * number)
            one.laps.append(Lap(number, 9.0, *(0,) * 15))

    def choose(one, features, reason="", undecided=False):
        choices.append(FeatureChoice(features, reason, undecided))
        one._choose_features()

    turned, at_once = race("turned.split"), race("at_once.split")
    end_laps(turned, 0)
    choose(turned, "z2", undecided=True)
    assert turned.header.features.is_z2 and turned.undecided
    # As long as the choice stays, so does all that was learned; nothing is done twice.
    learner, size = turned.learner, turned.learner.size
    end_laps(turned, 1)
    choose(turned, "z2", "still z2", undecided=True)
    assert turned.learner is learner and learner.size == size and turned.laps[1].size == 0
    assert turned.undecided and not turned.notes and len(turned.grips) == 1
    turned.grips.append((0.5, 0.5))  # found with the features of before
    end_laps(at_once, 0, 1)
    for one in (turned, at_once):
        choose(one, "z2,feature_lag")
        assert len(one.header.features.names) == 6 and not one.undecided
        assert one.laps[1].size == one.learner.size > 50 and one.grips[-1] == tuple(one.controller.grip)
    assert len(turned.grips) == 2
    kept, expected = read_set(tmp_path / "turned.split"), read_set(tmp_path / "at_once.split")
    np.testing.assert_array_equal(kept.z, expected.z)
    np.testing.assert_array_equal(kept.y, expected.y)
    assert [source.name for source in kept.sources] == ["lap 0", "lap 1"]
    z = kept.z[:5]
    np.testing.assert_array_equal(turned.learner.residual.along(z).mean, at_once.learner.residual.along(z).mean)


def test_the_race_says_whether_learning_helped():
    def driven(number, time, outside=0.0, share=0.75):
        return SimpleNamespace(
            number=number,
            time=time,
            outside=outside,
            clean=outside == 0.0,
            share=share,
            margin=1.1,
            error_after=(0.2, 0.1, 0.3),
            error_before=(0.4, 0.4, 0.4),
        )

    # Lap 0 is driven carefully, and a verdict that knows no other lap of the nominal model says so.
    laps = [driven(0, 40.0), driven(1, 38.0, share=0.85)]
    helped = whether_learning_helped(laps, RaceSettings())
    assert "38.00 s, 5.0 % less than lap 0" in helped and "held to 0.75" in helped and "to 0.85" in helped

    def without(*laps):
        return SimpleNamespace(learner="none", laps=laps)

    # As fast with no learner, a lap off the track aside: nothing was gained.
    rival = without(driven(0, 40.0), driven(1, 37.0, 0.2), driven(2, 38.0))
    assert "Learning did not help" in whether_learning_helped(laps, RaceSettings(), [rival])
    fair = whether_learning_helped(laps, RaceSettings(), [without(driven(0, 40.0), driven(1, 39.0))])
    assert "38.00 s, 2.6 % less than the nominal controller's in as many laps (39.00 s)." in fair
    assert "held to" not in fair
    # Where that left the track in every lap, only lap 0 is left to compare with.
    assert "--learner none" in helped
    unclean = whether_learning_helped(laps, RaceSettings(), [without(driven(0, 39.0, 0.1))])
    assert "than lap 0" in unclean and "--learner none" not in unclean
    harmed = whether_learning_helped([driven(0, 40.0), driven(1, 38.0, 0.1)], RaceSettings())
    assert "no lap with it was clean" in harmed and "50 %, 25 %, 75 %" in harmed and "split diagnose" in harmed
    # A lap 0 off the track is no rival that a clean lap has to beat, and nothing to go back to.
    cleaner = whether_learning_helped([driven(0, 37.0, 0.3), driven(1, 38.0)], RaceSettings())
    assert "clean lap with what was learned took 38.00 s. Without it no lap was clean: lap 0" in cleaner
    assert "37.00 s, 0.30 m outside the track" in cleaner
    both = whether_learning_helped([driven(0, 37.0, 0.3), driven(1, 38.0, 0.1)], RaceSettings())
    assert "no lap with it was clean" in both and "0.30 m outside" in both and "--learner none" not in both
    assert "Leave out --features" in whether_learning_helped(
        [driven(0, 40.0), driven(1, 41.0)], RaceSettings(features="z2")
    )
    assert whether_learning_helped([driven(0, 40.0), driven(1, 38.0)], RaceSettings(learner="none")) == ""


def test_a_lap_0_off_the_track_asks_for_a_diagnosis_where_the_file_has_no_terms():
    car = read_vehicle(CAR)
    off, lost, clean = (
        SimpleNamespace(number=0, time=time, outside=outside, clean=not outside, share=0.75)
        for time, outside in ((40.0, 0.2), (None, 2.0), (40.0, 0.0))
    )
    assert "0.20 m outside" in advice_after_lap_0([off], car) and "split diagnose" in advice_after_lap_0([off], car)
    assert "not finished" in advice_after_lap_0([lost], car)
    assert "--p-ellipse-lap0 0.6)" in advice_after_lap_0([lost], car)
    lagged = replace(car, effects=(SimpleNamespace(term="steer_lag"),))
    assert advice_after_lap_0([clean], car) == advice_after_lap_0([off], lagged) == advice_after_lap_0([], car) == ""
    # Of several learners the first tells it, for all that drive lap 0 with the same file.
    race = Race(RaceSettings(), car, None, lambda text: None)
    race.laps = [replace(Lap(0, 40.0, *(0,) * 15), outside=0.2)]
    first = race.result(None)
    assert len(first.notes) == 1 and race.result(None, [first]).notes == ()
