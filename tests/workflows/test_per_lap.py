"""The table of laps: its last row is the set, and its sums are those of the drive."""

from pathlib import Path

from split_cli.workflows.simulate import SimulateSettings, simulate_log
from split_cli.workflows.training.train import TrainSettings, train_set

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
