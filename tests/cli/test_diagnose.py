"""`split diagnose`: what goes to stdout and stderr, exit codes, and vehicles of the library."""

import json
from dataclasses import replace

import numpy as np
import pandas
import pytest
from click.testing import CliRunner

from split_cli.cli.main import group
from split_cli.diagnosis.statement.document import diagnosis_to_text
from split_cli.diagnosis.statement.result import Detectable, Diagnosis, Finding, GapSeries
from split_cli.errors import VehicleError
from split_cli.files import sha256_of_file
from split_cli.logs.drive import read_drive, write_drive
from split_cli.vehicle.library import library_path
from split_cli.vehicle.parameters import EffectSpec, vehicle_file, write_vehicle
from split_cli.workflows import diagnose as workflow
from tests.factories import make_drive, one_run, road_car

VERDICTS = {
    "match": Diagnosis(
        "match",
        0.4,
        0.9,
        ("brake gain: there is no braking; brake hard once",),
        sentences=("Alike.",),
        detectable=(Detectable("steer_delay", {"delay": (0.01372, "s")}), Detectable("wind", {})),
    ),
    "mismatch": Diagnosis("mismatch", 1e-9, 0.9, sentences=("They differ.",)),
    "undecided": Diagnosis("undecided", None, 0.1, ("too short",), sentences=("Too short.",)),
}
ARGUMENTS = ["--real", "lap.parquet", "--vehicle", "car.yaml", "--out", "out"]


def run(monkeypatch, verdict: str, *options: str, watched: bool = False):
    """Run the command with a diagnosis that is known beforehand: what is tested is what it tells."""

    def known(*_, progress, **__):
        progress("smoothing")
        progress("naming")
        return VERDICTS[verdict]

    monkeypatch.setattr(workflow, "diagnose_files", known)
    monkeypatch.setattr("split_cli.cli.verbosity.is_watched", lambda: watched)
    return CliRunner().invoke(group, ["diagnose", *ARGUMENTS, *options])


@pytest.mark.parametrize(
    ("verdict", "options", "expected"),
    [
        ("mismatch", ("--exit-code",), 3),
        ("match", ("--exit-code",), 0),
        ("undecided", ("--exit-code",), 0),
        ("mismatch", (), 0),
    ],
)
def test_exit_codes(monkeypatch, verdict, options, expected):
    assert run(monkeypatch, verdict, *options).exit_code == expected


@pytest.mark.parametrize("verdict", VERDICTS)
@pytest.mark.parametrize("watched", [False, True])
def test_json_alone_is_on_stdout(monkeypatch, verdict, watched):
    told = run(monkeypatch, verdict, "--json", watched=watched)
    assert told.stdout == diagnosis_to_text(VERDICTS[verdict])
    assert json.loads(told.stdout)["verdict"] == verdict


def test_progress_is_one_line_drawn_anew_where_someone_watches_and_nothing_in_a_pipe(monkeypatch):
    watched = run(monkeypatch, "match", "--json", watched=True).stderr
    # click takes the code that clears the line away where there is no terminal.
    drawn = [line for line in watched.split("\r") if line]
    assert [line.split()[-1] for line in drawn] == ["smoothing", "naming"]
    assert "░" in watched and "\n" not in watched and watched.endswith("\r")
    assert run(monkeypatch, "match", "--json").stderr == ""


def test_what_was_not_judged_stands_beside_the_summary(monkeypatch):
    told = run(monkeypatch, "match")
    verdict, summary, not_judged = told.stdout.splitlines()[:3]
    assert verdict.startswith("match") and summary == "Alike."
    assert not_judged.startswith("not judged: ") and "brake hard once" in not_judged


def test_the_report_and_the_next_command_are_named_and_a_sentence_has_a_line(monkeypatch):
    finding = Finding("brake_gain", "", {}, 0.5, (), "Weak.", 9.0)
    found = replace(
        VERDICTS["mismatch"], findings=(finding,), sentences=("They differ by 1.5 m.", "19 % is open.", "So.")
    )
    monkeypatch.setitem(VERDICTS, "mismatch", found)
    told = run(monkeypatch, "mismatch")
    assert told.stdout.splitlines()[1:4] == ["They differ by 1.5 m.", "19 % is open.", "So."]
    train = "next: split train lap.parquet --vehicle out/vehicle_corrected.yaml -o lap.split"
    assert told.stderr.splitlines() == ["split: report in out/report.html", train]
    assert run(monkeypatch, "match").stderr.splitlines() == ["split: report in out/report.html"]


def test_a_match_tells_what_would_have_been_named(monkeypatch):
    lines = [line.split() for line in run(monkeypatch, "match").stdout.splitlines()]
    assert ["steer_delay", "delay", "0.0137", "s"] in lines
    assert ["wind", "at", "no", "size", "of", "a", "real", "car"] in lines
    assert "steer_delay" not in run(monkeypatch, "mismatch").stdout


def test_a_vehicle_of_the_library_is_named_and_hashed_by_its_file(tmp_path):
    # Too short to judge, so that nothing but the reading of files takes time.
    write_drive(one_run({"vx": np.full(200, 5.0)}, 0.01, "short"), tmp_path / "short.parquet")
    said = workflow.diagnose_files([tmp_path / "short.parquet"], "tum_sim", tmp_path / "out")
    assert said.verdict == "undecided"
    (vehicle,) = [one for one in said.inputs if one.role == "vehicle"]
    assert (vehicle.name, vehicle.sha256) == ("tum_sim.yaml", sha256_of_file(library_path("tum_sim")))
    assert not (tmp_path / "out" / "vehicle_corrected.yaml").exists()


def test_what_a_long_diagnosis_takes_is_told_beforehand(tmp_path):
    told = {}
    for rows in (200, 40_000):
        write_drive(one_run({"vx": np.full(rows, 5.0)}, 0.01, "long"), tmp_path / "long.parquet")
        told[rows] = []
        workflow.diagnose_files([tmp_path / "long.parquet"], "tum_sim", tmp_path / "out", note=told[rows].append)
    more = [text for text in told[40_000] if "more than 1 GB of memory" in text]
    assert len(more) == 1 and "40000 rows (6.67 minutes)" in more[0] and "--start --end" in more[0]
    assert not [text for text in told[200] if "memory" in text]


def test_a_file_wins_over_the_library_and_an_unknown_name_is_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tum_sim").write_text(library_path("tum_sim").read_text())
    assert vehicle_file("tum_sim").resolve() == tmp_path / "tum_sim"
    with pytest.raises(VehicleError, match="tum_sym"):
        workflow.diagnose_files([], "tum_sym", tmp_path / "out")


def test_the_gap_stands_beside_labels_that_know_where_effects_act(tmp_path):
    """Steady 20 m/s with a climb from 50 to 150 m in the vehicle file, which the car did not feel."""
    climb = EffectSpec("road_grade", {"angle": 0.05, "s_start": 50.0, "s_end": 150.0}, "stretch")
    t = 0.01 * np.arange(1001)
    zero = np.zeros_like(t)
    drive = one_run({"X": 20.0 * t, "Y": zero, "yaw": zero, "vx": 20.0 + zero}, 0.01, "real.parquet")
    at = np.arange(2, len(t), 4)
    nowhere, three = np.full(len(at), np.nan), np.zeros((len(at), 3))
    gap = GapSeries(drive.name, t[at], 20.0 * t[at], at, nowhere, nowhere, np.zeros((len(at), 4)), at > 0, three, three)
    told = Diagnosis("match", 0.5, 1.0, gaps=(gap,))
    workflow.write_diagnosis(told, road_car(effects=(climb,)), tmp_path / "out", [drive])
    table = pandas.read_parquet(tmp_path / "out" / "gap.parquet")
    on_it = (table["s"] > 52.0) & (table["s"] < 148.0)
    off_it = (table["s"] < 48.0) | (table["s"] > 152.0)
    # Resistance is the same on and off the climb: what differs is the weight along the road.
    difference = table["y_vx"][on_it].mean() - table["y_vx"][off_it].mean()
    assert difference == pytest.approx(9.80665 * np.sin(0.05), rel=1e-6)


def test_faults_of_sensors_in_the_vehicle_file_are_taken_off_what_they_measured(tmp_path, monkeypatch):
    """A simulation has no sensors; what `split label` takes off a recording, a diagnosis does too."""
    car = road_car().with_effects(EffectSpec("sensor_misalignment", {"angle": 0.02}))
    write_vehicle(car, tmp_path / "car.yaml")
    for number, name in enumerate(("real", "sim", "held")):
        write_drive(make_drive(number, 2, 2.0, 0.02, name=f"{name}.parquet"), tmp_path / f"{name}.parquet")
    given = {}

    def known(real, vehicle, simulated, holdout, **_):
        given.update(real=real[0], sim=simulated[0], held=holdout[0])
        return VERDICTS["match"]

    monkeypatch.setattr(workflow, "diagnose", known)
    paths = {name: [tmp_path / f"{name}.parquet"] for name in ("real", "sim", "held")}
    workflow.read_and_diagnose(paths["real"], tmp_path / "car.yaml", simulated=paths["sim"], holdout=paths["held"])
    for name, turned in (("real", 0.02), ("sim", 0.0), ("held", 0.02)):
        read = read_drive(tmp_path / f"{name}.parquet")
        speed = np.hypot(read["vx"], read["vy"])
        np.testing.assert_allclose(np.hypot(given[name]["vx"], given[name]["vy"]), speed, rtol=1e-12)
        angle = np.arctan2(given[name]["vy"], given[name]["vx"]) - np.arctan2(read["vy"], read["vx"])
        np.testing.assert_allclose(np.abs(angle), turned, atol=1e-12)
