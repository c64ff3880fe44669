"""Hostile use of every command: one line that says what, exit code 1, and what was there before untouched."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

from split_cli.learning.training_set import read_set
from split_cli.logs.drive import read_drive
from tests.cli.hostile import refused, tool

COLUMNS = ("t", "vx", "vy", "r", "T", "delta")


def plain_drive(**changes: np.ndarray) -> dict[str, np.ndarray]:
    drive = read_drive("d0.parquet")
    count = int(np.count_nonzero(drive.segment == drive.segment[0]))
    columns = {name: drive[name][:count].copy() for name in COLUMNS}
    return {**columns, **changes}


def save(columns: dict[str, np.ndarray], name: str = "p.parquet") -> str:
    pa.parquet.write_table(pa.table(columns), name)
    return name


def spoiled(channel: str, row: int, value: float) -> str:
    columns = plain_drive()
    columns[channel][row] = value
    return save(columns)


# Outputs that are inputs


@pytest.mark.parametrize(
    ("command", "lost"),
    [
        (("ingest", "lap.parquet", "-o", "lap.parquet"), "lap.parquet"),
        (("ingest", "lap.parquet", "-o", "."), "lap.parquet"),
        (("ingest", "lap.csv", "lap.parquet", "-o", "."), "lap.parquet"),
        (("label", "d0.parquet", "--vehicle", "car.yaml", "-o", "d0.parquet"), "d0.parquet"),
        (("label", "d0.parquet", "--vehicle", "car.yaml", "-o", "car.yaml"), "car.yaml"),
        (("train", "d1.parquet", "d0.parquet", "--vehicle", "car.yaml", "-o", "./d0.parquet"), "d0.parquet"),
        (("train", "d0.parquet", "--vehicle", "car.yaml", "-o", "link.split"), "d0.parquet"),
        (("calibrate", "d0.parquet", "--vehicle", "car.yaml", "-o", "d0.parquet"), "d0.parquet"),
        (("ingest", "lap.csv", "-o", "x.parquet", "--report", "./lap.csv"), "lap.csv"),
        (("ingest", "lap.csv", "--map", "m.yaml", "-o", "m.yaml"), "m.yaml"),
    ],
)
def test_an_input_is_never_overwritten(here, command, lost):
    (here / "link.split").symlink_to(here / "d0.parquet")
    said = refused(*command, says=(), output=lost)
    assert "overwritten" in said or "two recordings" in said


def test_a_log_is_not_its_own_truth_and_both_places_are_checked_before_driving(here):
    common = ("simulate", "--track", "small", "--duration", 3)
    refused(*common, "--truth", "z.parquet", "-o", "z.parquet", says=("--truth", "overwritten"), output="z.parquet")
    refused(*common, "--truth", "no/t.parquet", "-o", "z.mcap", says=("no/t.parquet", "Create no"), output="z.mcap")
    assert not (here / "z.mcap").exists()


# Numbers that are no measurements


@pytest.mark.parametrize(
    ("channel", "value", "says"),
    [
        ("vx", np.nan, ("non-finite", "vx", "row 7")),
        ("T", np.inf, ("non-finite", "T", "row 7")),
        ("vx", 1e300, ("vx is 1e+300 in row 7",)),
        # Stiff enough to take 1e8 substeps: refused, not waited for.
        ("r", 1e10, ("r is 1e+10 in row 7",)),
        ("T", -1e300, ("T is -1e+300 in row 7",)),
        ("t", np.nan, ("time does not increase at row 7",)),
    ],
)
@pytest.mark.parametrize("command", ["label", "train", "calibrate", "evaluate"])
def test_a_drive_with_an_impossible_number_is_refused(here, command, channel, value, says):
    drive = spoiled(channel, 7, value)
    output = () if command == "evaluate" else ("-o", "out.file")
    Path("out.file").write_text("old")
    said = refused(command, drive, "--vehicle", "car.yaml", *output, says=("p.parquet", *says), output="out.file")
    assert "np.float64" not in said


def test_ingest_counts_impossible_numbers_and_keeps_the_rest(here):
    rows = Path("lap.csv").read_text().splitlines()
    names = rows[0].split(",")
    place = next(i for i, name in enumerate(names) if name.startswith("vx"))
    clean = read_ingested("lap.csv")
    for row in (100, 101, 300):
        cells = rows[row].split(",")
        cells[place] = "1e308"
        rows[row] = ",".join(cells)
    Path("hit.csv").write_text("\n".join(rows) + "\n")
    code, out, err = tool("ingest", "hit.csv", "-o", "hit.parquet")
    assert code == 0 and err.startswith("next: ") and err.count("\n") == 1
    assert "3 beyond 100000, no measurement in vx" in out
    made = read_drive("hit.parquet")
    # Bridged by a cubic over 30 ms of a car's motion with noise of some cm/s.
    np.testing.assert_allclose(made["vx"], clean["vx"], atol=0.2)
    for row in range(1, len(rows)):
        cells = rows[row].split(",")
        cells[place] = "-1e308"
        rows[row] = ",".join(cells)
    Path("hit.csv").write_text("\n".join(rows) + "\n")
    refused("ingest", "hit.csv", "-o", "hit.parquet", says=("hit.csv", "vx", "no measurement"), output="hit.parquet")


def read_ingested(log: str):
    assert tool("ingest", log, "-o", "clean.parquet")[0] == 0
    return read_drive("clean.parquet")


def test_a_flipped_bit_in_a_drive_is_no_velocity(here):
    content = bytearray(Path("d0.parquet").read_bytes())
    said = []
    # The columns come first, the footer with the schema last: every place here lies in a column's pages.
    for place in np.linspace(200, 0.9 * len(content), 25).astype(int):
        hit = content.copy()
        hit[place] ^= 16
        Path("hit.parquet").write_bytes(hit)
        code, _, err = tool("info", "hit.parquet")
        if code == 0:
            code, _, err = tool("label", "hit.parquet", "--vehicle", "car.yaml", "-o", "l.parquet")
        assert "an error of this program" not in err
        said.append(code)
    assert said == [1] * 25


# Drives, vehicles and sets that do not fit


def test_a_plain_drive_says_what_it_lacks_or_has_twice(here):
    columns = plain_drive()
    label = ("--vehicle", "car.yaml", "-o", "l.parquet")
    refused("label", save({n: v for n, v in columns.items() if n != "vy"}), *label, says=("lacks vy", "p.parquet"))
    refused("label", save({**columns, "vx(km/h)": columns["vx"]}), *label, says=("two columns are vx",))
    refused("label", save({n: v[:1] for n, v in columns.items()}), *label, says=("holds 1 samples",))
    refused("label", save({n: v[:2] for n, v in columns.items()}), *label, says=("too short for a label",))
    Path("none").mkdir()
    refused("label", "none", *label, says=("none: holds no drive",))
    refused("label", "a.split", *label, says=("cannot be read as a drive",))
    for stop in (0, 100, -100):
        Path("cut.parquet").write_bytes(Path("d0.parquet").read_bytes()[:stop])
        train = ("train", "cut.parquet", "--vehicle", "car.yaml", "-o", "a.split")
        refused(*train, says=("cut.parquet",), output="a.split")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"period": 0.0}, ("metadata is damaged",)),
        ({"period": float("nan")}, ("metadata is damaged",)),
        ({"period": 0.5}, ("clock is not uniform",)),
        ({"noise": 5}, ("metadata is damaged",)),
        ({"format": "split-drive/99"}, ("split-drive/99", "Ingest the recording again")),
    ],
)
def test_damaged_metadata_of_a_drive_is_told(here, change, says):
    table = pa.parquet.read_table("d0.parquet")
    stored = {**json.loads(table.schema.metadata[b"split"]), **change}
    pa.parquet.write_table(table.replace_schema_metadata({"split": json.dumps(stored)}), "p.parquet")
    refused("train", "p.parquet", "--vehicle", "car.yaml", "-o", "a.split", says=("p.parquet", *says), output="a.split")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--vehicle", "other.yaml"), ("a.split", "was trained for another vehicle of the same name")),
        (("--vehicle", "car.yaml", "--features", "z1"), ("features: alpha_f, alpha_r, torque_ratio; asked for: vx",)),
        (("--vehicle", "car.yaml", "--capacity", 5), ("its capacity: 10; asked for: 5",)),
        (("--vehicle", "car.yaml", "--plain-labels"), ("its plain labels: False; asked for: True",)),
        (("--vehicle", "car.yaml", "--hyperparameters", "fit"), ("keeps its hyperparameters",)),
        (("--vehicle", "car.yaml", "--trust", "held-out"), ("keeps its trust",)),
        (("--vehicle", "a.split"), ("a.split",)),
        (("--vehicle", "."), ("Is a directory",)),
        (("--vehicle", "lap.mcap"), ("lap.mcap", "no text")),
    ],
)
def test_appending_what_does_not_fit_leaves_the_set_alone(here, arguments, says):
    refused("train", "d1.parquet", *arguments, "-o", "a.split", "--append", says=says, output="a.split")


def test_a_set_cut_or_hit_anywhere_is_refused_by_every_command(here):
    content = bytearray(Path("a.split").read_bytes())
    commands = [
        ("info", "hit.split"),
        ("verify", "hit.split"),
        ("evaluate", "d1.parquet", "--set", "hit.split"),
        ("export", "hit.split", "--target", "npz", "-o", "out"),
        ("train", "d1.parquet", "--vehicle", "car.yaml", "-o", "hit.split", "--append"),
    ]
    values = read_set("a.split").y[:, 1]
    hits = [content[: len(content) // 3], content[:-20], bytearray(), bytearray(b"ARROW1")]
    for value in values[[0, len(values) // 2, -1]]:
        hit = content.copy()
        hit[hit.find(np.float64(value).tobytes())] ^= 1
        hits.append(hit)
    # The schema with its metadata stands at both ends of an Arrow file; readers take that of the end.
    hits.append(content.replace(b'"capacity": 10', b'"capacity": 11'))
    hits.append(content.replace(b'"threshold": 0.001', b'"threshold": 0.002'))
    assert all(hit != content for hit in hits)
    for hit in hits:
        Path("hit.split").write_bytes(hit)
        for command in commands:
            refused(*command, says=("hit.split",), output="hit.split")
    assert not Path("out").exists()


# The others: tests/vehicle/test_parameters.py.
@pytest.mark.parametrize(("text", "says"), [("[" * 1000, "nested too deeply"), ("masss: 5\n", "Did you mean mass")])
def test_a_vehicle_file_that_is_none_is_told_in_a_line(here, text, says):
    Path("v.yaml").write_text(text)
    refused("label", "d0.parquet", "--vehicle", "v.yaml", "-o", "l.parquet", says=("v.yaml", says), output="l.parquet")


def test_numbers_in_yaml_may_be_written_as_in_c(here):
    text = Path("car.yaml").read_text()
    Path("v.yaml").write_text(text + "effects: [{term: aero_drag, parameters: {drag: 1e-3}}]\n")
    assert tool("label", "d0.parquet", "--vehicle", "v.yaml", "-o", "l.parquet")[0] == 0


def test_an_effect_too_fast_to_follow_is_not_waited_for(here):
    text = Path("car.yaml").read_text()
    Path("v.yaml").write_text(text + "effects: [{term: drive_lag, parameters: {tau: 1e-9}}]\n")
    assert tool("label", "d0.parquet", "--vehicle", "v.yaml", "-o", "l.parquet")[0] == 0


# Signal maps


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("preset: split_sim\nchannels: {w: {source: '/wheels/velocity[7]'}}", ("'/wheels/velocity[7]'", "to w")),
        ("preset: split_sim\nchannels: {vx: {source: /odometry/twist.twist.linear.x, scale: 0}}", ("scale is 0",)),
        ("preset: split_sim\nchannels: {vx: {source: /odometry/twist.x}}", ("'/odometry/twist.x'", "Did you mean")),
        ("preset: split_sim\ntime: {source: stamp}", ("for tables", "header, publish, log")),
        ("preset: nope", ("no preset 'nope'",)),
        ("preset: 5", ("preset is 5", "a list of names was expected")),
        ("preset: [split_sim, split_sim]", ("names a preset twice",)),
        (f"preset: split_sim\nchannels: {{vx: {{source: {'x' * 100_000}}}}}", ("the recording has no 'xxx", "[...]")),
    ],
)
def test_a_map_that_cannot_be_right_is_refused(here, text, says):
    Path("m.yaml").write_text(text)
    Path("o.parquet").write_text("old")
    ingest = ("ingest", "lap.mcap", "--vehicle", "car.yaml", "--map", "m.yaml", "-o", "o.parquet")
    refused(*ingest, says=says, output="o.parquet")


def test_an_optional_element_past_the_end_of_every_list_is_said_not_to_be_recorded(here):
    Path("m.yaml").write_text("preset: split_sim\nchannels: {w: {source: '/wheels/velocity[7]', optional: true}}")
    code, out, _ = tool("ingest", "lap.mcap", "--vehicle", "car.yaml", "--map", "m.yaml", "-o", "o.parquet", "--json")
    assert code == 0
    assert json.loads(out)[0]["quality"]["skipped"] == ["w: no message has an element /wheels/velocity[7]"]
    assert "w" not in read_drive("o.parquet")


def test_a_topic_option_that_changes_nothing_is_refused(here):
    common = ("ingest", "lap.mcap", "--vehicle", "car.yaml", "--map", "split_sim", "-o", "o.parquet")
    refused(*common, "--topic", "odometry=/odom", says=("--topic", "'odometry'", "/odometry"))
    refused(*common, "--topic", "/odometry=/odom", says=("lap.mcap", "/odom/"))
    assert not Path("o.parquet").exists()


def test_the_log_at_fault_and_its_damage_are_named(here):
    content = bytearray(Path("lap.mcap").read_bytes())
    content[len(content) // 3] ^= 255
    Path("hit.mcap").write_bytes(content)
    code, out, err = tool(
        "ingest", "lap.mcap", "hit.mcap", "--vehicle", "car.yaml", "--map", "split_sim", "-o", "drives"
    )
    if code:
        assert "hit.mcap" in err and len(err.splitlines()) == 1
        assert not Path("drives").exists()
    else:
        assert "chunk left out" in out
    save({name: values[:3] for name, values in plain_drive().items()}, "three.parquet")
    common = ("--gap", 0.3, "-o", "others")
    refused("ingest", "lap.parquet", "three.parquet", *common, says=("three.parquet", "3 usable"))
    code, _, err = tool("ingest", "three.parquet", *common, "--keep-going")
    assert code == 1 and len(err.splitlines()) == 1
    assert not Path("others").exists()


# Options


@pytest.mark.parametrize(
    "options",
    [
        ("label", "d0.parquet", "--vehicle", "car.yaml", "-o", "x.out", "--stride", 0),
        ("label", "d0.parquet", "--vehicle", "car.yaml", "-o", "x.out", "--horizon", "nan"),
        ("train", "d0.parquet", "--vehicle", "car.yaml", "-o", "x.out", "--features", ""),
        ("train", "d0.parquet", "--vehicle", "car.yaml", "-o", "x.out", "--features", "alpha_f,alpha_f"),
        ("train", "d0.parquet", "--vehicle", "car.yaml", "-o", "x.out", "--capacity", 0),
        ("train", "d0.parquet", "--vehicle", "car.yaml", "-o", "x.out", "--cell-edge", "1e-308"),
        ("evaluate", "d0.parquet", "--vehicle", "car.yaml", "--guard", "nan"),
        ("evaluate", "d0.parquet", "--vehicle", "car.yaml", "--rollout", "nan"),
        ("calibrate", "d0.parquet", "--vehicle", "car.yaml", "-o", "x.out", "--fit", ","),
        ("calibrate", "d0.parquet", "--vehicle", "car.yaml", "-o", "x.out", "--figure", "f.xyz"),
        ("calibrate", "d0.parquet", "--vehicle", "car.yaml", "-o", "x.out", "--figure", "no/f.png"),
        ("simulate", "--track", "small", "--duration", "1e-9", "-o", "x.csv"),
        ("simulate", "--track", "small", "--laps", "nan", "-o", "x.csv"),
        ("ingest", "lap.csv", "-o", "o.parquet", "--gap", "nan"),
        ("ingest", "lap.csv", "-o", "o.parquet", "--rate", "1e9"),
        ("ingest", "lap.csv", "-o", "o.parquet", "--dbc", "no_such.dbc"),
        ("compare", "car.yaml", "--on", "d0.parquet", "--horizon", "0"),
        ("compare", "car.yaml", "--on", "d0.parquet", "--horizon", ","),
        ("compare", "car.yaml", "--on", "d0.parquet", "--horizon", "1e308"),
        ("calibrate", "d0.parquet", "--vehicle", "car.yaml", "-o", "x.out", "--smooth", "1e308"),
        ("race", "--vehicle", "car.yaml", "--laps", 10**21, "-o", "o.parquet"),
        ("verify", "lap.csv"),
        ("verify", "no_such_file.split"),
        ("info", "bad\udcff.csv"),
    ],
)
def test_options_that_make_no_sense_write_nothing(here, options):
    refused(*options, says=())
    assert not Path("x.out").exists() and not Path("x.csv").exists() and not Path("o.parquet").exists()


def test_a_valid_name_is_not_called_invalid_where_python_reads_ascii(here):
    ascii_only = {**os.environ, "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "LC_ALL": "C"}
    command = [sys.executable, "-m", "split_cli", "info"]
    for name, told in ((b"r\xc3\xbccken.csv", b"Set PYTHONUTF8=1"), (b"r\xfccken.csv", b"is not valid UTF-8")):
        done = subprocess.run([*command, name], env=ascii_only, capture_output=True)
        assert done.returncode == 1 and told in done.stderr, done.stderr


def test_a_car_that_only_goes_straight_keeps_its_tyres(here):
    count = 4000
    t = np.arange(count) * 0.01
    vx = 15.0 + 3.0 * np.sin(0.2 * t)
    zero = np.zeros(count)
    drive = {"t": t, "vx": vx, "vy": zero, "r": zero, "T": 800.0 * np.cos(0.2 * t), "delta": zero}
    code, _, err = tool("calibrate", save(drive), "--vehicle", "car.yaml", "-o", "c.yaml")
    assert code == 0 and "the start's tyres are kept on both axles" in err


def test_verify_tells_files_of_an_export_that_it_did_not_check(here):
    for target in ("json", "npz"):
        assert tool("export", "a.split", "--target", target, "--queries", 200, "-o", "out")[0] == 0
    code, out, _ = tool("verify", "out")
    assert code == 0
    assert next(line for line in out.splitlines() if line.startswith("other files")).endswith(
        "a.json, split-export.schema.json"
    )


def test_json_is_json(here):
    for command in (
        ("ingest", "--list-maps"),
        ("ingest", "lap.csv", "--list"),
        ("ingest", "lap.csv", "lap.mcap", "--list"),
        ("ingest", "lap.csv", "--suggest-map"),
        ("info", "a.split", "car.yaml", "d0.parquet", "lap.mcap"),
        ("verify", "a.split"),
    ):
        code, out, err = tool(*command, "--json")
        assert code == 0 and err == ""
        assert json.loads(out, parse_constant=pytest.fail)  # no NaN, no Infinity
    options = {"info": (), "verify": (), "ingest": ("-o", "o.parquet"), "export": ("--target", "npz", "-o", "o")}
    for command, more in options.items():
        code, out, err = tool(command, "nothing", *more, "--json")
        assert code in (1, 2) and out == "" and "nothing" in err
