"""How much of the track and of the tyres' peak the next lap may use."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from split_cli.control.limits import first_share
from split_cli.control.policy import FIRST_DEVIATION, FIRST_ERROR
from split_cli.control.residual import NoResidual
from split_cli.learning.labels import compute_labels
from split_cli.logs.drive import read_drive
from split_cli.scoring.noise import noise_floor
from split_cli.signals import STANDARD_GRAVITY
from split_cli.vehicle.parameters import read_vehicle
from split_cli.vehicle.single_track import SingleTrack
from split_cli.workflows.racing.driving import Race
from split_cli.workflows.racing.first_lap import header_without_kernel
from split_cli.workflows.racing.margin import acceleration_error
from split_cli.workflows.racing.settings import RaceSettings
from split_cli.workflows.racing.tally import Tally
from tests.control.courses import CAR, ROOT, first_rows


def test_a_clean_lap_lets_the_next_one_use_a_step_more_of_the_peak():
    """From 0.75 of an assumed peak to 0.95 with a learner, to 0.85 without; a lap off the track raises nothing."""
    for learner, shares in (("split", (0.85, 0.95, 0.95)), ("none", (0.85, 0.85, 0.85))):
        race = Race(RaceSettings(learner=learner), read_vehicle(CAR), None, lambda text: None)
        limits = replace(race.mpcc.limits, p_ellipse=first_share(race.vehicle))
        race.controller = SimpleNamespace(limits=limits, deviation=0.8, room=lambda point: np.full(2, 1.4))
        race.laps = [SimpleNamespace(clean=False)]
        race._raise_share()
        assert race.controller.limits.p_ellipse == pytest.approx(0.75)
        race.laps = [SimpleNamespace(clean=True)]
        for share in shares:
            race._raise_share()
            assert race.controller.limits.p_ellipse == pytest.approx(share)
    # Where the track leaves room for a fourth of the margin, the step is a fourth, too.
    race.controller = SimpleNamespace(limits=limits, deviation=0.8, room=lambda point: np.array([1.4, 0.2]))
    race._raise_share()
    assert race.controller.limits.p_ellipse == pytest.approx(0.775)


def test_the_margin_is_what_the_lap_before_has_needed():
    tally, info = Tally(1, 0, 0.85, 400.0), SimpleNamespace(solved=True, solver_seconds=0.0, total_seconds=0.0)
    # The plan kept 1.1 m and the car had 0.4 m left: 0.7 m were needed. Where the track is narrow, it kept 0.5 m.
    for beyond, kept, s in ((-1.1, 1.1, 410.0), (-0.4, 1.1, 500.0), (0.1, 0.5, 532.0), (0.05, 0.5, 533.0)):
        tally.add((0.0, s), beyond, kept, info)
        so_far = tally.lap(9.0, np.zeros((2, 9)), 0, 0, "")
        assert (so_far.outside_at is None) == (so_far.outside == 0.0) == (s < 532.0)
    # The track is 400 m long, and this is its second lap.
    lap = tally.lap(9.0, np.zeros((2, 9)), 0, 0, "")
    assert (lap.outside, lap.outside_at, tally.margin) == (0.1, 132.0, 0.5)
    assert tally.needed == pytest.approx(0.7)


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(np.square(values), axis=0))


def test_the_error_of_acceleration_is_that_of_a_force_at_its_lever_whatever_the_noise():
    """A wrong force at the CG, and one at the radius of gyration before it: they count as their energies do."""
    car, rng = read_vehicle(CAR), np.random.default_rng(0)
    noise, force = np.array([0.2, 0.2, 0.1]), rng.normal(0.0, 600.0, 50_000)
    radius = np.sqrt(car.yaw_inertia / car.mass)
    for lever, factor in ((0.0, 1.0), (radius, np.sqrt(2.0))):
        left_out = np.stack([rng.normal(size=len(force)), force / car.mass, lever * force / car.yaw_inertia], axis=1)
        labels = left_out + noise * rng.normal(size=left_out.shape)
        assert acceleration_error(rms(labels), noise, len(force), car) == pytest.approx(
            factor * 600.0 / car.mass, rel=0.01
        )
    # An error that noise hides counts as what so many labels could tell; v_x moves no car sideways.
    hidden = acceleration_error(np.array([9.0, 0.1, 0.05]), noise, 200, car)
    assert hidden == pytest.approx(np.sqrt(0.1) * np.hypot(0.2, radius * 0.1))


@pytest.fixture
def margins():
    """A race, and what it keeps beside the least margin after laps that missed v_y by shares of `FIRST_ERROR`."""
    drive = first_rows(read_drive(ROOT / "sample_logs" / "road_pair_real.parquet"), 2001)
    race = Race(RaceSettings(), read_vehicle(CAR), None, lambda text: None)
    header = race.header = header_without_kernel(race.vehicle, race.features, race.mpcc)
    race.world = SimpleNamespace(recording=lambda *span, name: drive)
    race.spans = {1: (0, 2001)}
    # No lap lets the next one use more of the peak, unless a test says so.
    race.controller = SimpleNamespace(
        limits=race.mpcc.limits, deviation=race.deviation, room=lambda point: np.full(2, 1.4)
    )
    race.learner = SimpleNamespace(residual=None)
    labels = compute_labels(drive, race.vehicle, header.features, header.region, horizon=header.horizon)
    noise = noise_floor(SingleTrack(race.vehicle), drive, labels).rms

    def after(laps: list[tuple[float, float]], max_lateral: float = 0.9) -> list[float]:
        kept = []
        for share, needed in laps:
            error = np.hypot(noise[1], share * FIRST_ERROR * max_lateral * STANDARD_GRAVITY)
            given = {"error_after": (0.0, error, noise[2]), "accepted": 10**12, "clean": True}
            race.laps = [SimpleNamespace(number=1, max_lateral=max_lateral, **given)]
            race._adapt_margin_and_share(SimpleNamespace(needed=needed, labels=labels))
            kept.append(race.controller.deviation)
        return kept

    return race, after


@pytest.mark.parametrize("max_lateral", [0.9, 0.45])
def test_the_margin_falls_with_the_error_of_the_model_on_any_road_and_by_a_fifth_a_lap(margins, max_lateral):
    _, after = margins
    expected = [0.64, 0.25 * 0.512, 0.5 * 0.4096]
    kept = after([(2.0, 0.0), (0.25, 0.0), (0.5, 0.0)], max_lateral)
    assert np.array(kept) / FIRST_DEVIATION * 0.8 == pytest.approx(expected, rel=1e-3)


def test_a_lap_that_happens_to_need_little_takes_no_margin_that_others_needed(margins):
    """What an error needed it may need again, elsewhere on the track; half the error needs half."""
    _, after = margins
    kept = after([(0.1, 0.6), (0.1, 0.1), (0.05, 0.1), (0.1, 0.7)])
    assert kept == pytest.approx([0.6, 0.48, 0.192, 0.7], rel=1e-3)


def test_while_the_share_of_the_peak_rises_the_margin_does_not_fall(margins):
    """An error at one share says little of a larger one; a margin that a lap needed rises all the same."""
    race, after = margins
    race.controller.limits = replace(race.mpcc.limits, p_ellipse=0.75)
    # To 0.85, to 0.95, and no further.
    assert after([(0.1, 0.0)]) == pytest.approx([FIRST_DEVIATION])
    assert after([(0.1, 1.2)]) == pytest.approx([1.2], rel=1e-3)
    assert race.controller.limits.p_ellipse == pytest.approx(0.95)
    assert after([(0.1, 0.0)]) == pytest.approx([0.96], rel=1e-3)


def test_without_a_learned_model_the_margin_falls_by_a_fifth_alone(margins):
    race, after = margins
    race.learner = SimpleNamespace(residual=NoResidual())
    assert after([(0.1, 0.0), (3.0, 0.6), (0.1, 0.1)]) == pytest.approx([0.64, 0.6, 0.48])
    race.learner = SimpleNamespace(residual=None)
    race.settings = replace(race.settings, margin_by_error=False)
    assert after([(0.1, 0.0)]) == pytest.approx([0.384])
