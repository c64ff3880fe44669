"""A torque that arrives late: found from labels, put into the set where held-out blocks gain, and nowhere else."""

import json
from dataclasses import replace

import numpy as np
import pytest

from split_cli.errors import SetError
from split_cli.learning.features import Z2
from split_cli.learning.labels import compute_labels
from split_cli.learning.late_labels import freed_of_late_torque
from split_cli.learning.training_set import read_set, write_set
from split_cli.learning.trust import Trust
from split_cli.logs.drive import Drive, DriveMetadata, write_drive
from split_cli.scoring.evaluation import NOMINAL
from split_cli.scoring.evidence import TrainingDrive, TrustEvidence
from split_cli.scoring.export_warnings import reservations
from split_cli.scoring.found_lags import Prepared, decide, lag_notes
from split_cli.scoring.report import EvaluationSettings
from split_cli.scoring.torque_lag import fit_torque_lag
from split_cli.scoring.trust import best_trust
from split_cli.vehicle.parameters import EffectSpec, write_vehicle
from split_cli.workflows.evaluate import evaluate
from split_cli.workflows.info import describe_file
from split_cli.workflows.training.train import TrainSettings, train_set
from tests.factories import MissingForce, make_drive, make_training_set, road_car

TAU = 0.06
LATE = road_car().with_effects(EffectSpec("drive_lag", {"tau": TAU}))


def noisy(drive: Drive, seed: int) -> Drive:
    rng = np.random.default_rng(seed)
    columns = {
        name: drive[name] + scale * rng.normal(size=len(drive))
        for name, scale in (("vx", 0.004), ("vy", 0.004), ("r", 0.001))
    }
    return replace(drive, columns={**drive.columns, **columns})


@pytest.fixture(scope="module")
def late() -> Drive:
    return noisy(make_drive(3, segments=30, vehicle=LATE), 4)


def part_of(drive: Drive) -> TrainingDrive:
    return TrainingDrive(drive, compute_labels(drive, road_car(), Z2))


def test_the_time_constant_that_made_the_drive_is_found(late):
    found = fit_torque_lag([part_of(late)], road_car())
    assert found is not None and (found.effects[-1].term, found.effects[-1].variant) == ("drive_lag", "along")
    # The minimum is looked for to 1 % of the first-order delay; noise of 1,800 labels adds about as much.
    assert found.effects[-1].parameters["tau"] == pytest.approx(TAU, rel=0.04)


def test_no_lag_is_looked_for_where_the_torque_has_arrived_or_the_file_has_one(late):
    derived = replace(late, metadata=DriveMetadata(kinds={"T": "derived: torque from measured a_x"}))
    assert fit_torque_lag([part_of(derived)], road_car()) is None
    assert fit_torque_lag([TrainingDrive(late, compute_labels(late, LATE, Z2))], LATE) is None
    prompt = noisy(make_drive(5, segments=30, terms=[MissingForce({"front_lateral": 200.0})]), 6)
    assert fit_torque_lag([part_of(prompt)], road_car()) is None


def evidence(gained: float, harmed: float = 0.0) -> list[TrustEvidence]:
    """Errors of a model with an effect beyond the file: `gained` of the file's in v_x, 1 + `harmed` of it in r."""
    rng, count = np.random.default_rng(8), 2000
    block, parts = np.arange(count) // 100, []
    conditions = np.column_stack([rng.random((count, 6)), np.zeros(count)])
    for state, share in enumerate((1.0 - gained, 1.0, 1.0 + harmed)):
        by_file = rng.normal(size=count)
        rest = (np.zeros((count, 3)), np.zeros(count), block, conditions)
        parts.append(TrustEvidence(state, 0.0, share * by_file, *rest, nominal=by_file))
    return parts


def test_an_effect_beyond_the_file_is_judged_against_the_file():
    share, gain = best_trust(evidence(0.5))
    # No correction changes anything; the file's mean square of v_x falls to a quarter.
    assert not share.any() and gain == pytest.approx(0.75, abs=0.05)
    assert best_trust(evidence(0.5, harmed=0.1))[1] == -np.inf
    assert best_trust(evidence(0.5), most=(1.0, 0.0, 0.0))[1] == gain
    assert best_trust(evidence(0.0))[1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("by_file", "gain", "most"), [((0.4, 0.3, 0.0), 0.1, 0.3), ((0.0, 0.0, 0.0), 0.0, 1.0)])
def test_no_trust_without_the_lag_bounds_that_with_it_only_where_something_was_found(
    late, monkeypatch, by_file, gain, most
):
    """Two of seven drives of 22 s had no trust and no lag: v_y and r, bounded by 0, could not make up for it."""
    asked = []

    def judged(drives, empty, progress, most=(1.0, 1.0, 1.0)):
        asked.append(most)
        found = by_file if len(asked) == 1 else (1.0, min(0.8, most[1]), 0.0)
        return Trust(found, "held-out", 5), gain if len(asked) == 1 else 0.5, None

    monkeypatch.setattr("split_cli.scoring.found_lags.judge_correction", judged)
    drives, empty = [part_of(late)], make_training_set(points=10)
    chosen = decide(Prepared(empty, drives, None), lambda vehicle: Prepared(empty, drives, None))
    assert asked[1][1] == most and chosen.empty.trust.share == (1.0, min(0.8, most), 0.0)


def test_a_set_tells_the_file_from_what_it_found_and_keeps_both(tmp_path):
    made = replace(make_training_set(points=200), vehicle=LATE, found_effects=1)
    write_set(made, tmp_path / "a.split")
    again = read_set(tmp_path / "a.split")
    assert again.nominal_vehicle.digest() == road_car().digest()
    assert again.vehicle.digest() == LATE.digest() and again.found == LATE.effects
    write_set(replace(made, found_effects=2), tmp_path / "forged.split")
    with pytest.raises(SetError, match="found_effects"):
        read_set(tmp_path / "forged.split")


@pytest.fixture(scope="module")
def trained(late, tmp_path_factory):
    """Files: the drive, the vehicle without the lag, and the set that `split train` makes of them."""
    folder = tmp_path_factory.mktemp("late")
    write_vehicle(road_car(), folder / "car.yaml")
    write_drive(late, folder / "late.parquet")
    result = train_set([folder / "late.parquet"], folder / "car.yaml", folder / "car.split")
    return folder, result


def test_training_puts_the_lag_into_the_set_and_says_so(trained):
    folder, result = trained
    made = read_set(folder / "car.split")
    assert made.found[0].parameters["tau"] == pytest.approx(TAU, rel=0.04)
    assert any("late" in note and "--lag none" in note for note in result.notes)
    # Nothing but noise is left, and nothing of it is believed.
    assert made.trust.share[0] <= 0.1
    facts = dict(describe_file(folder / "car.split").facts)
    assert facts["intervals"].startswith("hold for other stretches of the same driving")
    assert lag_notes(made) == (reservations(replace(made, trust=Trust((0.0, 0.0, 0.0), "held-out", 9))))
    for trust, words in ((Trust((1.0, 0.5, 0.0), "held-out", 9), "same driving"), (Trust.full(), "not judged")):
        assert words in reservations(replace(made, trust=trust))[0]
    often = replace(made, trust=Trust((1.0, 0.5, 0.0), "held-out", 9), sources=3 * made.sources)
    assert "drives like those of training only" in reservations(often)[0]
    plain = train_set([folder / "late.parquet"], folder / "car.yaml", folder / "plain.split", TrainSettings(lag="none"))
    assert read_set(folder / "plain.split").found == ()
    assert any("labels of v_x follow dT/dt" in note for note in plain.notes)


def test_evaluate_compares_the_set_with_the_vehicle_file(trained):
    folder, _ = trained
    fresh = noisy(make_drive(9, segments=12, vehicle=LATE), 10)
    made = read_set(folder / "car.split")
    settings = EvaluationSettings(predictors=("rbcm",), rollout=(0.5,))
    report = evaluate([fresh], road_car(), settings, made).report
    scores = {score.name: score for score in report.scores}
    labels = compute_labels(fresh, road_car(), Z2)
    finite = labels.y[np.isfinite(labels.y).all(axis=1)]
    np.testing.assert_allclose(scores[NOMINAL].rmse[:3], np.sqrt(np.mean(finite**2, axis=0)), rtol=1e-12)
    # What remains with the lag is sensor noise over an interval of two samples: 0.004 sqrt(2)/0.04 = 0.14 m/s^2.
    assert scores["rbcm"].rmse[0] == pytest.approx(0.141, rel=0.1)
    ratio = {(c.state, c.horizon): c.to_nominal for c in report.comparisons if c.name == "rbcm"}
    assert ratio["v_x", 0.0][2] < 0.5 and ratio["v_x", 0.5][2] < 0.4
    assert max(low for _, low, _ in ratio.values()) <= 1.0


def test_going_on_labels_with_the_lag_and_refuses_another(trained, tmp_path):
    folder, _ = trained
    fresh = noisy(make_drive(12, segments=10, vehicle=LATE, name="fresh.parquet"), 13)
    write_drive(fresh, tmp_path / "fresh.parquet")
    (tmp_path / "car.split").write_bytes((folder / "car.split").read_bytes())
    with pytest.raises(SetError, match="keeps the lag"):
        train_set(
            [tmp_path / "fresh.parquet"],
            folder / "car.yaml",
            tmp_path / "car.split",
            TrainSettings(lag="none"),
            append=True,
        )
    train_set([tmp_path / "fresh.parquet"], folder / "car.yaml", tmp_path / "car.split", append=True)
    grown = read_set(tmp_path / "car.split")
    new = grown.source == 1
    with_lag = freed_of_late_torque(grown, compute_labels(fresh, grown.vehicle, Z2))
    of_row = dict(zip(with_lag.row.tolist(), with_lag.y, strict=True))
    assert new.any()
    np.testing.assert_array_equal(grown.y[new], [of_row[row] for row in grown.row[new].tolist()])


def test_exports_carry_the_lag_and_say_that_it_was_found(trained, tmp_path):
    from split_cli.workflows.export import export_set

    folder, _ = trained
    export_set(folder / "car.split", tmp_path / "out", ["json"], queries=200, insist=True)
    told = json.loads(next((tmp_path / "out").glob("*.json")).read_text())
    effects = told["vehicle"]["effects"]
    assert [effect["term"] for effect in effects] == ["drive_lag"]
