"""The table of laps: its last row is the set, and its sums are those of the drive."""

from dataclasses import replace
from pathlib import Path

import pytest

from split_cli.errors import DriveError
from split_cli.logs.drive import write_drive
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.simulate import SimulateSettings, simulate_log
from split_cli.workflows.training.train import TrainSettings, train_set
from tests.factories import make_drive, road_car

ROOT = Path(__file__).resolve().parents[2]


def test_laps_add_up_to_the_set(tmp_path):
    simulate_log(SimulateSettings(track="small", duration=100.0, seed=4), tmp_path / "laps.parquet")
    result = train_set(
        [tmp_path / "laps.parquet"],
        ROOT / "sample_logs" / "road_car.yaml",
        tmp_path / "a.split",
        TrainSettings(hyperparameters="default", trust="full"),
        per_lap=True,
    )
    assert len(result.laps) >= 2
    assert [row.finished for row in result.laps] == [True] * (len(result.laps) - 1) + [False]
    assert sum(row.updates for row in result.laps) == result.total.updates
    last = result.laps[-1]
    assert (last.points, last.cells, last.valid_share) == (
        result.total.points,
        result.total.cells,
        result.total.valid_share,
    )
    assert all(a.points <= b.points for a, b in zip(result.laps, result.laps[1:], strict=False))
    # 580 m a lap, give or take the line driven.
    assert all(0.9 * 580 < row.time * row.mean_speed < 1.1 * 580 for row in result.laps[:-1])


@pytest.mark.parametrize(("position", "said"), [(False, "no position and no lap channel"), (True, "never comes back")])
def test_a_drive_without_laps_is_told_before_anything_is_learned(tmp_path, position, said):
    """Only after labels and hyperparameters the command said that it cannot, and what it had learned was lost."""
    drive = make_drive(3, segments=20)
    straight = {"X": 20.0 * drive["t"], "Y": 0.0 * drive["t"]} if position else {}
    write_drive(replace(drive, columns={**drive.columns, **straight}), tmp_path / "d.parquet")
    write_vehicle(road_car(), tmp_path / "car.yaml")
    paths, steps = (tmp_path / "d.parquet", tmp_path / "car.yaml", tmp_path / "a.split"), []
    with pytest.raises(DriveError, match=f"{said}.*leave out --per-lap"):
        train_set([paths[0]], *paths[1:], TrainSettings(), per_lap=True, progress=steps.append)
    assert not any("label" in step or "fitting" in step for step in steps)
