"""Ingest end to end: from files to drives by workflow and by command, and every kind of bad input."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from click.testing import CliRunner

from split_cli.cli.ingest import command
from split_cli.errors import LogError, MapError, SplitError
from split_cli.logs.drive import read_drive
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.ingesting.ingest import IngestSettings, ingest_logs
from tests.logs.planted import PlantedDrive

CHANNELS = ("X", "Y", "yaw", "vx", "vy", "r", "T", "delta", "ax", "ay")
MAP = {"time": {"source": "t", "unit": "s"}, "kinds": {"T": "command", "delta": "measured"}}


@pytest.fixture(scope="module")
def drive() -> PlantedDrive:
    return PlantedDrive(seconds=30.0)


@pytest.fixture
def folder(tmp_path, drive) -> Path:
    """A folder with a vehicle and a map whose sources are the canonical names."""
    write_vehicle(drive.vehicle, tmp_path / "car.yaml")
    content = {**MAP, "channels": {name: {"source": name} for name in CHANNELS}}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(content))
    return tmp_path


def frame(drive: PlantedDrive, rate: float = 100.0) -> pd.DataFrame:
    t = np.arange(0.0, drive.seconds, 1.0 / rate)
    return pd.DataFrame({"t": t, **{name: drive.at(name, t) for name in CHANNELS}})


def ingest(folder: Path, table: pd.DataFrame, **settings):
    table.to_csv(folder / "log.csv", index=False)
    results, _, _ = ingest_logs(
        [folder / "log.csv"],
        folder / "drive.parquet",
        maps=[folder / "map.yaml"],
        vehicle_path=folder / "car.yaml",
        settings=IngestSettings(**settings),
    )
    return results[0]


def drops(result) -> dict[str, int]:
    found: dict[str, int] = {}
    for channel in result.quality.channels:
        for drop in channel.drops:
            found[drop.reason] = found.get(drop.reason, 0) + drop.count
    return found


def test_a_csv_becomes_a_drive_that_reads_back_as_the_planted_one(folder, drive):
    result = ingest(folder, frame(drive))
    made = read_drive(result.drive_path)
    assert made.period == pytest.approx(0.01) and len(made) == result.rows
    for name in CHANNELS:
        np.testing.assert_allclose(made[name], drive.at(name, made["t"]), rtol=1e-9, atol=1e-9)
    assert made.metadata.kinds["T"] == "command" and made.metadata.kinds["delta"] == "measured"
    assert made.metadata.sources[0].name == "log.csv" and len(made.metadata.sources[0].sha256) == 64
    assert made.metadata.vehicle == drive.vehicle.name
    assert made.metadata.signal_map["channels"]["vx"] == {"source": "vx"}
    assert made.metadata.quality["consistency"]["findings"] == []
    assert made.metadata.noise_of("vx").sigma == 0.0


def test_equal_input_gives_equal_bytes(folder, drive):
    first = ingest(folder, frame(drive)).drive_path.read_bytes()
    assert ingest(folder, frame(drive)).drive_path.read_bytes() == first


def test_a_fast_log_is_brought_to_a_hundred_hertz_and_a_slow_one_is_not_upsampled(folder, drive):
    assert ingest(folder, frame(drive, 500.0)).period == pytest.approx(0.01)
    slow = ingest(folder, frame(drive, 25.0))
    assert slow.period == pytest.approx(0.04)
    with pytest.raises(LogError, match="above the slowest required channel.*never upsampled"):
        ingest(folder, frame(drive, 25.0), rate=50.0)
    assert ingest(folder, frame(drive), rate=20.0).period == pytest.approx(0.05)


def test_ten_samples_a_second_are_taken_unasked_and_five_say_what_takes_them(folder, drive):
    assert ingest(folder, frame(drive, 10.0)).period == pytest.approx(0.1)
    with pytest.raises(LogError, match="vx comes every 0.2 s, longer than the gap of 0.1 s. Set --gap 0.5"):
        ingest(folder, frame(drive, 5.0))


def test_a_pose_ten_times_as_fast_as_the_gyro_is_named_as_the_way_to_a_faster_drive(folder, drive):
    """Columns of 10 Hz held on the rows of a motion capture at 100 Hz: the drive came at 10 Hz without a word."""
    table, slow = frame(drive), frame(drive, 10.0)
    for channel in ("r", "ax", "ay"):
        table[channel] = np.repeat(slow[channel].to_numpy(), 10)
    told = [str(note) for note in ingest(folder, table).quality.warnings]
    assert any("without r" in note and "`--derive velocity-from-pose`" in note for note in told), told
    assert not any("velocity-from-pose" in str(note) for note in ingest(folder, slow).quality.warnings)


def test_a_channel_that_is_infinite_is_refused_for_what_it_holds(folder, drive):
    table = frame(drive)
    table["vy"] = np.inf
    with pytest.raises(LogError, match="0 usable samples of vy remain. Dropped: 3000 infinite"):
        ingest(folder, table)


def test_a_gap_makes_a_segment_and_a_longer_gap_setting_bridges_it(folder, drive):
    table = frame(drive)
    holed = table[(table.t < 10.0) | (table.t > 10.4)]
    made = ingest(folder, holed)
    assert made.quality.segments == 2 and made.quality.channels[0].gaps == 1
    assert made.quality.channels[0].longest_gap == pytest.approx(0.42, abs=0.02)
    assert ingest(folder, holed, gap=0.5).quality.segments == 1


def test_bad_samples_are_dropped_counted_and_do_no_harm(folder, drive):
    table = frame(drive)
    table.loc[100:102, "vx"] = np.nan
    table.loc[200, "r"] = np.inf
    table.loc[300, "vy"] = 1e4
    table = pd.concat([table.iloc[:500], table.iloc[499:500], table.iloc[500:]])
    order = np.arange(len(table))
    order[[700, 701]] = [701, 700]
    result = ingest(folder, table.iloc[order])
    found = drops(result)
    assert found["NaN"] == 3 and found["infinite"] == 1 and found["spike"] == 1
    assert found["duplicate time"] == len(CHANNELS) and found["out of order, sorted"] == len(CHANNELS)
    made = read_drive(result.drive_path)
    # The bridged samples come from a cubic over at most 40 ms of motion of 1 Hz and less.
    for name in ("vx", "vy", "r"):
        np.testing.assert_allclose(made[name], drive.at(name, made["t"]), atol=1e-3)


def test_a_clock_jump_back_is_a_segment_and_is_said(folder, drive):
    table = frame(drive)
    table.loc[1500:, "t"] -= 12.0
    result = ingest(folder, table)
    assert result.quality.segments == 2
    assert any("jumps back by 11.99" in text for text in result.metadata.conversions)
    made = read_drive(result.drive_path)
    np.testing.assert_allclose(made["vx"][made.segment == 1][0], drive.at("vx", np.array(15.0)), atol=1e-6)


def test_a_yaw_along_the_cut_of_the_angle_is_no_row_of_spikes(folder, drive):
    table = frame(drive)
    wrapped = table.assign(yaw=np.angle(np.exp(1j * (0.002 * np.sin(40.0 * table.t) + np.pi))))
    made = ingest(folder, wrapped)
    assert "spike" not in drops(made)
    assert np.ptp(read_drive(made.drive_path)["yaw"]) < 0.005


@pytest.mark.parametrize("gap", [0.0, -1.0])
def test_a_gap_of_nothing_is_refused(folder, drive, gap):
    with pytest.raises(MapError, match="the gap is .* must be positive"):
        ingest(folder, frame(drive), gap=gap)


@pytest.mark.parametrize("rows", [0, 1, 3])
def test_an_empty_log_is_refused_and_leaves_the_old_output(folder, drive, rows):
    (folder / "drive.parquet").write_bytes(b"old")
    with pytest.raises(SplitError):
        ingest(folder, frame(drive).iloc[:rows])
    assert (folder / "drive.parquet").read_bytes() == b"old"
    assert [p.name for p in folder.iterdir() if p.name.endswith(".part")] == []


def test_channels_that_never_overlap_are_told_with_their_times(folder, drive):
    table = frame(drive)
    table.loc[table.t < 15.0, "vx"] = np.nan
    table.loc[table.t > 14.0, "r"] = np.nan
    with pytest.raises(LogError, match="no time is covered by all.*vx: 15.00 to 29.99 s.*r: 0.00 to 14.00 s"):
        ingest(folder, table)


def test_a_channel_slower_than_the_gap_is_told_with_the_setting_that_helps(folder, drive):
    with pytest.raises(LogError, match=r"vx comes every 0.2 s, longer than the gap.*--gap 0.5"):
        ingest(folder, frame(drive, 5.0))


def test_several_logs_go_into_a_folder_all_or_none(folder, drive):
    for name in ("a.csv", "b.csv"):
        frame(drive).to_csv(folder / name, index=False)
    (folder / "c.csv").write_text("t,vx\n")
    kwargs = {"maps": [folder / "map.yaml"], "vehicle_path": folder / "car.yaml"}
    results, _, _ = ingest_logs([folder / "a.csv", folder / "b.csv"], folder / "drives", **kwargs)
    assert [r.drive_path.name for r in results] == ["a.parquet", "b.parquet"]
    assert len(read_drive(folder / "drives" / "b.parquet")) == results[1].rows
    with pytest.raises(SplitError):
        ingest_logs([folder / "a.csv", folder / "c.csv"], folder / "none", **kwargs)
    assert not (folder / "none").exists() or not list((folder / "none").iterdir())
    results, failures, _ = ingest_logs([folder / "a.csv", folder / "c.csv"], folder / "some", keep_going=True, **kwargs)
    assert len(results) == 1 and [f.log for f in failures] == ["c.csv"]
    with pytest.raises(SplitError, match="2 recordings cannot go into one drive"):
        ingest_logs([folder / "a.csv", folder / "b.csv"], folder / "x.parquet", **kwargs)


def run(*arguments: object):
    return CliRunner().invoke(command, [str(a) for a in arguments], catch_exceptions=True)


def test_the_command_writes_a_drive_and_reports_as_text_and_json(folder, drive):
    frame(drive).rename(columns={"vx": "speed(km/h)"}).assign(
        **{"speed(km/h)": lambda d: d["speed(km/h)"] * 3.6}
    ).to_csv(folder / "log.csv", index=False)
    content = yaml.safe_load((folder / "map.yaml").read_text())
    content["channels"]["vx"] = {"source": "speed"}
    (folder / "map.yaml").write_text(yaml.safe_dump(content))
    common = (
        folder / "log.csv",
        "--map",
        folder / "map.yaml",
        "--vehicle",
        folder / "car.yaml",
        "-o",
        folder / "d.parquet",
    )
    shown = run(*common)
    assert shown.exit_code == 0, shown.output
    assert "vx: km/h to m/s" in shown.output and "3000 rows at 100 Hz" in shown.output
    report = json.loads(run(*common, "--json").stdout)[0]
    assert report["rows"] == 3000 and report["kinds"]["T"] == "command"
    assert {n["channel"] for n in report["noise"]} >= {"vx", "vy", "r"}
    made = read_drive(folder / "d.parquet")
    np.testing.assert_allclose(made["vx"], drive.at("vx", made["t"]), atol=1e-6)


def test_a_drive_too_slow_to_learn_from_is_not_sent_to_training(folder, drive):
    """`split train` refuses it, and the hint led there."""
    common = (folder / "log.csv", "--map", folder / "map.yaml", "--vehicle", folder / "car.yaml", "-o")
    frame(drive).to_csv(folder / "log.csv", index=False)
    assert "next: split train" in run(*common, folder / "d.parquet").stderr
    slower = {"t": 5.0, "vx": 0.2, "vy": 0.2, "r": 0.2, "T": 0.04, "delta": 1.0}
    (frame(drive)[[*slower]] * pd.Series(slower)).to_csv(folder / "log.csv", index=False)
    content = {**MAP, "channels": {name: {"source": name} for name in ("vx", "vy", "r", "T", "delta")}}
    (folder / "map.yaml").write_text(yaml.safe_dump(content))
    said = run(*common, folder / "slow.parquet").stderr
    assert "take a faster drive: none here reaches the 5 m/s" in said and "split train" not in said


def test_list_and_drafts_need_no_output(folder, drive):
    frame(drive).to_csv(folder / "log.csv", index=False)
    assert "delta" in run(folder / "log.csv", "--list").output
    listed = json.loads(run(folder / "log.csv", "--list", "--json").stdout)
    assert [c["name"] for c in listed["channels"]] == ["t", *CHANNELS]
    draft = yaml.safe_load(run(folder / "log.csv", "--suggest-map").output)
    assert draft["channels"]["delta"]["source"] == "delta"
    assert "genesis_slow" in run("--list-maps").output


def test_a_table_named_like_a_drive_needs_no_map(folder, drive):
    frame(drive).to_csv(folder / "log.csv", index=False)
    shown = run(folder / "log.csv", "--vehicle", folder / "car.yaml", "-o", folder / "d.parquet")
    assert shown.exit_code == 0 and "vx in m/s" in shown.output
    frame(drive).rename(columns={"vx": "speed"}).to_csv(folder / "other.csv", index=False)
    failed = run(folder / "other.csv", "-o", folder / "e.parquet")
    assert isinstance(failed.exception, MapError) and "--suggest-map" in str(failed.exception)
    assert not (folder / "e.parquet").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--map", "genesis_slw"), "no such map.*genesis_slow"),
        (("--map", "canonical", "--vehicle", "genesi"), "no such file.*genesis"),
        (("--map", "canonical", "--derive", "torque"), "no derivation 'torque'.*torque-from"),
        (("--map", "canonical", "--delay", "yaw_rate=0.1"), "--delay names 'yaw_rate'"),
        (("--map", "canonical", "--clock", "header"), "has no header clock"),
        (("--map", "f1tenth"), "no '/odom/twist.twist.linear.x', mapped to vx"),
        (("--map", "odometry"), "no 'nav_msgs/Odometry:twist.twist.linear.x'"),
    ],
)
def test_wrong_arguments_are_told_with_the_nearest_right_ones(folder, drive, arguments, words):
    frame(drive).to_csv(folder / "log.csv", index=False)
    shown = run(folder / "log.csv", "-o", folder / "d.parquet", *arguments)
    assert isinstance(shown.exception, SplitError)
    assert re.search(words, str(shown.exception)), str(shown.exception)
    assert not (folder / "d.parquet").exists()


def test_usage_errors_are_usage_errors(folder):
    assert run().exit_code == 2
    assert run(folder / "log.csv").exit_code == 2
    assert run(folder / "log.csv", "-o", "x.parquet", "--delay", "vx").exit_code == 2


def test_a_disk_that_cannot_be_written_leaves_the_old_drive(folder, drive, monkeypatch):
    ingest(folder, frame(drive))
    old = (folder / "drive.parquet").read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(SplitError, match="No space left"):
        ingest(folder, frame(drive).iloc[:2000])
    monkeypatch.undo()
    assert (folder / "drive.parquet").read_bytes() == old
    assert [p.name for p in folder.iterdir() if p.name.endswith(".part")] == []


def test_a_long_recording_is_checked_on_its_middle(folder, drive, monkeypatch):
    faulty = frame(drive)
    faulty.loc[100:120, "vy"] = np.nan
    whole = read_drive(ingest(folder, faulty).drive_path)
    monkeypatch.setattr("split_cli.logs.assembling.assemble.MOST_CHECKED", len(whole) - 200)
    result = ingest(folder, faulty)
    long = read_drive(result.drive_path)
    assert list(long.columns) == list(whole.columns)
    for name in long.columns:
        np.testing.assert_array_equal(long[name], whole[name])
    assert long.metadata.noise == whole.metadata.noise
    assert long.metadata.quality["channels"] == whole.metadata.quality["channels"]
    minutes = (len(whole) - 200) * whole.period / 60.0
    told = f"channels were checked against each other on the middle {minutes:.3g} minutes"
    assert told in result.quality.warnings
