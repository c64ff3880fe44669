"""An input that arrives late: found from labels together with a correction, which hides it from labels alone."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.learning.cells import empty_set
from split_cli.learning.features import Z2
from split_cli.learning.hyperparameters import fit_kernel
from split_cli.learning.kernel import Kernel
from split_cli.learning.labels import compute_labels
from split_cli.learning.region import Region, z2_grid
from split_cli.learning.training_set import read_set
from split_cli.logs.drive import Drive, DriveMetadata, write_drive
from split_cli.scoring.evidence import TrainingDrive
from split_cli.scoring.export_warnings import reservations
from split_cli.scoring.found_lags import lag_notes
from split_cli.scoring.likeliest_lag import likeliest_lag, with_steer_lag
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.info import describe_file
from split_cli.workflows.training.train import train_set
from tests.factories import MissingForce, make_drive, road_car

TAU = 0.03
#: A tenth of the front axle's force: with ddelta/dt it goes as a lag does, and in r it is as large.
LOST = MissingForce({"front_grip_loss": 0.1})


def driven(seed: int, tau: float) -> Drive:
    lag = [CATALOGUE["steer_lag"]({"tau": tau})] if tau else []
    drive = make_drive(seed, segments=30, terms=[*lag, LOST])
    rng = np.random.default_rng(seed + 1)
    noise = (("vx", 0.004), ("vy", 0.004), ("r", 0.001))
    return replace(
        drive, columns={**drive.columns, **{n: drive[n] + scale * rng.normal(size=len(drive)) for n, scale in noise}}
    )


def prepared(drive: Drive, car=None):
    """Return a drive with its labels, and an empty set with the kernel fitted to them."""
    car = car or road_car()
    region, labels = Region.of(car), compute_labels(drive, car, Z2)
    grid = z2_grid(car, region)
    good = labels.inside(grid)
    start = Kernel(np.array(grid.edges), np.full(3, 0.1), np.full(3, 0.01))
    kernel = fit_kernel(good.z[good.accepted], good.y[good.accepted], grid, start, longest=np.ones(3)).kernel
    return TrainingDrive(drive, labels), empty_set(car, Z2, region, grid, kernel, horizon=0.05)


@pytest.fixture(scope="module")
def late() -> Drive:
    return driven(3, TAU)


def test_the_time_constant_is_found_beside_what_else_is_wrong(late):
    part, empty = prepared(late)
    found = likeliest_lag([part], empty, "delta")
    # Noise of 1,800 labels moves it by some 3 %; the search is exact to 0.5 ms.
    assert found is not None and found.effects[-1].term == "steer_lag"
    assert found.effects[-1].parameters["tau"] == pytest.approx(TAU, rel=0.1)


def test_a_torque_is_found_so_too():
    """Beside the front axle's loss, and with labels of v_x in noise of which the torque's is a small part."""
    drive = make_drive(7, segments=30, terms=[CATALOGUE["drive_lag"]({"tau": TAU}, "along"), LOST])
    rough = drive["vx"] + 0.02 * np.random.default_rng(8).normal(size=len(drive))
    part, empty = prepared(replace(drive, columns={**drive.columns, "vx": rough}))
    found = likeliest_lag([part], empty, "T")
    # The noise of a label, 0.57 m/s^2, is as large as what a lag of 30 ms leaves; of 2,400 labels that is 3 %.
    assert found is not None and (found.effects[-1].term, found.effects[-1].variant) == ("drive_lag", "along")
    assert found.effects[-1].parameters["tau"] == pytest.approx(TAU, rel=0.15)


def test_none_is_found_where_the_wheels_were_measured_or_the_file_delays_them_or_nothing_is_late(late):
    part, empty = prepared(late)
    measured = replace(late, metadata=DriveMetadata(kinds={"delta": "measured"}))
    assert likeliest_lag([replace(part, drive=measured)], empty, "delta") is None
    delayed, with_lag = prepared(late, with_steer_lag(road_car(), TAU))
    assert likeliest_lag([delayed], with_lag, "delta") is None
    prompt, blank = prepared(driven(5, 0.0))
    assert likeliest_lag([prompt], blank, "delta") is None


def test_training_puts_the_lag_into_the_set_and_says_so(late, tmp_path):
    write_vehicle(road_car(), tmp_path / "car.yaml")
    write_drive(late, tmp_path / "late.parquet")
    result = train_set([tmp_path / "late.parquet"], tmp_path / "car.yaml", tmp_path / "car.split")
    made = read_set(tmp_path / "car.split")
    assert [effect.term for effect in made.found] == ["steer_lag"]
    assert made.found[0].parameters["tau"] == pytest.approx(TAU, rel=0.1)
    assert made.nominal_vehicle.digest() == road_car().digest()
    assert made.found[0].variant == "learned"  # a set of an older version has a lag that acts everywhere
    described = dict(describe_file(tmp_path / "car.split").facts)
    assert described["found in training: steer_lag, variant learned"] == f"tau {made.found[0].parameters['tau']:.4g} s"
    (note,) = lag_notes(made)
    assert "steering follows its command 0.0" in note and note in result.notes and note in reservations(made)


def test_of_an_archive_a_lag_is_looked_for_where_trust_is_found_and_the_rest_is_labelled_once_more(
    late, tmp_path, monkeypatch
):
    """The second drive lies beyond the rows that trust is found on; a lag that is tried must not label it."""
    write_vehicle(road_car(), tmp_path / "car.yaml")
    drives = [tmp_path / "first.parquet", tmp_path / "second.parquet"]
    for path, drive in zip(drives, (late, driven(11, TAU).stretch(0, 1000)), strict=True):
        write_drive(drive, path)
    labelled = []

    def counted(drive, vehicle, *given, **named):
        labelled.append((drive.name, tuple(effect.term for effect in vehicle.effects)))
        return compute_labels(drive, vehicle, *given, **named)

    monkeypatch.setattr("split_cli.workflows.training.labelled_drives.compute_labels", counted)
    for place in ("workflows.training.new_set", "scoring.evidence"):
        monkeypatch.setattr(f"split_cli.{place}.MOST_ROWS", len(late))
    result = train_set(drives, tmp_path / "car.yaml", tmp_path / "car.split")
    assert [effect.term for effect in read_set(tmp_path / "car.split").found] == ["steer_lag"]
    assert "trust was found on the first 1 of 2 drives" in result.notes
    second = [terms for name, terms in labelled if name.startswith("second")]
    assert second == [(), ("steer_lag",)]
    # Both drives are learned with the lag.
    assert len(result.rows) == 2 and result.rows[1].samples > 100


def test_of_a_long_drive_a_lag_is_looked_for_on_the_middle_and_all_of_it_is_learned(late, tmp_path, monkeypatch):
    write_vehicle(road_car(), tmp_path / "car.yaml")
    write_drive(late, tmp_path / "long.parquet")
    rows = []

    def counted(drive, *given, **named):
        rows.append(len(drive))
        return compute_labels(drive, *given, **named)

    monkeypatch.setattr("split_cli.workflows.training.labelled_drives.compute_labels", counted)
    most = len(late) * 9 // 10
    for place in ("workflows.training.new_set", "workflows.training.labelled_drives", "scoring.evidence"):
        monkeypatch.setattr(f"split_cli.{place}.MOST_ROWS", most)
    result = train_set([tmp_path / "long.parquet"], tmp_path / "car.yaml", tmp_path / "car.split")
    made = read_set(tmp_path / "car.split")
    assert [effect.term for effect in made.found] == ["steer_lag"]
    # By the file, then the middle for each lag that is tried, then all of it once more.
    assert rows[0] == rows[-1] == len(late) and set(rows[1:-1]) == {most}
    assert result.total.samples == len(compute_labels(late, made.vehicle, Z2))
