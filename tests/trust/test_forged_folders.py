"""Something changed by hand in each file of ours, with its digest made right again: `split verify` finds it."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from split_cli.cli.main import group
from split_cli.errors import SplitError
from split_cli.files import DIGESTS, sha256_of_file, write_digests
from split_cli.learning.label_file import read_labels, write_labels
from split_cli.learning.labels import compute_labels
from split_cli.learning.training_set import read_set, write_set
from split_cli.logs.drive import Source, read_drive, write_drive
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.diagnose import write_diagnosis
from split_cli.workflows.info import describe_file
from split_cli.workflows.verifying import relabelled
from split_cli.workflows.verifying.verify import verify
from split_cli.workflows.verifying.verify_files import compare_sources
from tests.diagnosis.test_report import mismatch
from tests.factories import MissingForce, make_drive, road_car

CAR = road_car()


def failed(path) -> set[str]:
    return {i.check for i in verify(path).items if i.passed is False}


def checked(path) -> set[str]:
    return {i.check for i in verify(path).items if i.passed}


def split(*arguments) -> None:
    done = CliRunner().invoke(group, list(map(str, arguments)), catch_exceptions=False)
    assert done.exit_code == 0, done.output


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """Two short drives, a set, an export of it, labels, a comparison on a longer drive, a diagnosis."""
    folder = tmp_path_factory.mktemp("made")
    write_vehicle(CAR, folder / "car.yaml")
    terms = [MissingForce({"front_lateral": 150.0})]
    # Points enter with their cube where they are learned again; a comparison takes four blocks for an interval.
    for seed, segments in enumerate((5, 5, 12)):
        drive = make_drive(seed, segments, 2.0, vehicle=CAR, terms=terms, name=f"d{seed}.parquet")
        write_drive(drive, folder / drive.name)
    car = ("--vehicle", folder / "car.yaml")
    # Ten seconds bear no trust of their own.
    split("train", folder / "d0.parquet", *car, "-o", folder / "a.split", "--trust", "full")
    split("train", folder / "d1.parquet", *car, "-o", folder / "a.split", "--append")
    split("label", folder / "d0.parquet", *car, "-o", folder / "l.parquet")
    split("export", folder / "a.split", "--target", "json", "-o", folder / "export", "--insist", "--queries", 200)
    on = ("--on", folder / "d2.parquet", "--horizon", "0.5")
    split("compare", folder / "car.yaml", folder / "a.split", *on, "-o", folder / "compared")
    write_diagnosis(mismatch("d0.parquet"), CAR, folder / "diagnosis", [read_drive(folder / "d0.parquet")])
    return folder


@pytest.fixture
def folder(made, tmp_path) -> Path:
    shutil.copytree(made, tmp_path / "f")
    return tmp_path / "f"


def test_what_was_written_passes_and_was_looked_at(made):
    for name in ("a.split", "l.parquet", "export", "compared", "compared/report.html", "diagnosis/gap.parquet"):
        if name != "diagnosis/gap.parquet":
            assert failed(made / name) == set(), name
    assert {"points of d0.parquet", "points of d1.parquet", "sums over labels"} <= checked(made / "a.split")
    assert "labels of d0.parquet" in checked(made / "l.parquet")
    # The inputs that the diagnosis names are invented ones.
    assert failed(made / "diagnosis") == {"source d0.parquet", "source car.yaml"}
    assert {"report.html", "report against document", "gap.parquet"} <= checked(made / "diagnosis")


@pytest.mark.parametrize("field", ["y", "z"])
def test_points_of_a_set_that_its_drive_does_not_have(folder, field):
    trained = read_set(folder / "a.split")
    # One number that is moved alone does not fit the gains or the sums, and the set is refused.
    names, rows, by = (("y", "absorbed"), slice(7, 8), 1e-5) if field == "y" else (("z",), slice(None), 2e-6)
    values = {name: getattr(trained, name).copy() for name in names}
    for moved in values.values():
        moved[rows] += by
    write_set(replace(trained, **values), folder / "a.split")
    drives = {f"points of {trained.sources[number].name}" for number in trained.source[rows]}
    assert failed(folder / "a.split") - {"sums over labels"} == drives


@pytest.mark.parametrize(("field", "factor"), [("absorbed", 0.0), ("absorbed", -1.0), ("information", 0.999)])
def test_sums_over_labels_that_its_drives_do_not_have(folder, field, factor):
    trained = read_set(folder / "a.split")
    own = dict(zip(("information", "absorbed"), replace(trained, information=None).sums(), strict=True))[field]
    beside = getattr(trained, field) - own  # of labels that are no points: what reading a set cannot refuse
    write_set(replace(trained, **{field: own + factor * beside}), folder / "a.split")
    assert failed(folder / "a.split") == {"sums over labels"}
    (folder / "d1.parquet").unlink()
    assert failed(folder / "a.split") == set()
    told = {i.check: i for i in verify(folder / "a.split").items}
    assert told["labels and sums"].passed is None and "1 of 2 drives" in told["labels and sums"].detail


@pytest.mark.parametrize(("options", "labelled"), [((), 2), (("--held", "T"), 4), (("--stride", 1), 4)])
def test_points_and_sums_are_compared_with_labels_that_are_computed_once(folder, monkeypatch, options, labelled):
    """Each drive was labelled eight times: for its points at every row, for the sums, and as held in four ways."""
    drives = folder / "d0.parquet", folder / "d1.parquet"
    split("train", *drives, "--vehicle", folder / "car.yaml", "-o", folder / "b.split", *options)
    computed = []
    monkeypatch.setattr(relabelled, "compute_labels", lambda *a, **k: computed.append(a) or compute_labels(*a, **k))
    found = verify(folder / "b.split")
    named = {"points of d0.parquet", "points of d1.parquet"}
    assert found.passed and named <= {i.check for i in found.items}
    assert ("sums over labels" in {i.check for i in found.items}) == ("--stride" not in options)
    assert len(computed) == labelled


def test_a_label_that_its_drive_does_not_have(folder):
    labels = read_labels(folder / "l.parquet")
    y = labels.y.copy()
    y[np.flatnonzero(labels.accepted)[3], 1] *= 1.001
    write_labels(replace(labels, y=y), folder / "l.parquet")
    assert failed(folder / "l.parquet") == {"labels of d0.parquet"}


def test_a_set_or_a_drive_of_another_run(folder):
    shutil.copy(folder / "d1.parquet", folder / "d0.parquet")
    assert failed(folder / "l.parquet") == {"source d0.parquet"}
    split("train", folder / "d1.parquet", "--vehicle", folder / "car.yaml", "-o", folder / "a.split")
    assert failed(folder / "export") == {"trained set"}


def test_the_gap_of_a_diagnosis_is_checked_alone(folder):
    assert verify(folder / "diagnosis" / "gap.parquet").kind == "gap of a diagnosis"


@pytest.mark.parametrize("forged", [{"findings": 5}, {"findings": [1]}, {"verdict": None, "findings": [{}]}, {}])
def test_a_forged_diagnosis_is_described_or_refused_in_one_line(tmp_path, forged):
    (tmp_path / "diagnosis.json").write_text(json.dumps({"schema": "split-diagnosis/1", **forged}))
    with pytest.raises(SplitError, match="damaged or forged"):
        describe_file(tmp_path / "diagnosis.json")


def test_a_folder_of_several_outputs_is_checked_whole_but_the_c_in_it_is_not_run(folder):
    """Only drives were looked at: a forged set or a mixed diagnosis beside them passed."""
    document = json.loads((folder / "diagnosis" / "diagnosis.json").read_text())
    (folder / "diagnosis" / "diagnosis.json").write_text(json.dumps({**document, "inputs": []}))
    write_digests(folder / "diagnosis")
    found = {i.check: i for i in verify(folder).items}
    assert found["a.split"].passed and found["compared"].passed and found["d0.parquet"].passed
    assert found["export"].passed is None and "split verify" in found["export"].detail
    assert failed(folder) == {"diagnosis"}
    assert "report against document: the page shows the numbers of another" in found["diagnosis"].detail
    (folder / "a.split").write_bytes((folder / "a.split").read_bytes()[:-500])
    assert failed(folder) == {"diagnosis", "a.split"}


def test_a_recording_and_its_simulation_may_have_one_name(folder):
    real, simulated = sha256_of_file(folder / "d0.parquet"), sha256_of_file(folder / "d1.parquet")
    told = [("real/d0.parquet", real), ("sim/d0.parquet", simulated)]
    assert [i.passed for i in compare_sources([folder], told)] == [True, None]
    assert [i.passed for i in compare_sources([folder], [("d0.parquet", simulated)])] == [False]


def test_a_vehicle_changed_since_it_was_written(folder):
    write_vehicle(CAR, folder / "calibrated.yaml", comment="Calibrated from a lap.")
    assert checked(folder / "calibrated.yaml") == {"values", "as written"}
    text = (folder / "calibrated.yaml").read_text()
    (folder / "calibrated.yaml").write_text(text.replace(f"mass: {CAR.mass}", f"mass: {CAR.mass + 1.0}"))
    assert failed(folder / "calibrated.yaml") == {"as written"}
    # Names and notes are free.
    (folder / "calibrated.yaml").write_text(text.replace(f"name: {CAR.name}", "name: mine"))
    assert failed(folder / "calibrated.yaml") == set()


def forged_export(folder: Path, change, name: str = "a.json") -> Path:
    """Change the numbers of a JSON file of an export, and enter the file's new digest in the manifest."""
    export, path = folder / "export", folder / "export" / name
    told = json.loads(path.read_text())
    change(told)
    path.write_text(json.dumps(told))
    entered = json.loads((export / "manifest.json").read_text())
    entered["files"][path.name] = sha256_of_file(path)
    (export / "manifest.json").write_text(json.dumps(entered))
    return export


def test_an_export_whose_numbers_changed(folder):
    def change(told):
        told["projected_weights"] = [[value * 1.01 for value in row] for row in told["projected_weights"]]

    manifest = folder / "export" / "manifest.json"
    entered = manifest.read_text()
    forged_export(folder, change)
    assert failed(folder / "export") == {"json: answers"}
    manifest.write_text(entered)
    assert any("SHA-256" in check for check in failed(folder / "export"))


@pytest.mark.parametrize("predictor", ["rbcm", "projected"])
@pytest.mark.parametrize("name", ["z", "y", "length_scales", "signal_variance", "noise_variance"])
@pytest.mark.parametrize("number", [1e300, float("inf"), 0.0, -1.0])
def test_forged_numbers_of_an_export_that_overflow_fail_without_a_warning(folder, predictor, name, number):
    def change(told):
        told["predictor"], told[name] = predictor, np.full_like(told[name], number).tolist()

    assert failed(forged_export(folder, change)) & {"json: answers", "json: points"}


@pytest.mark.parametrize("name", ["mean", "variance"])
def test_stored_answers_that_are_no_numbers(folder, name):
    def change(stored):
        stored[name][0][0] = float("nan")

    (folder / "a.split").unlink()
    assert failed(forged_export(folder, change, "a_check.json")) == {"json: answers"}


def test_a_label_of_a_projected_export_that_taught_it_nothing(folder):
    def change(told):
        told["projected_absorbed"][7][1] += 0.01

    assert failed(forged_export(folder, change)) == {"json: answers"}
    detail = {i.check: i.detail for i in verify(folder / "export").items}
    assert "learns its points again" in detail["json: answers"]


@pytest.mark.parametrize("beside", [True, False])
def test_a_projected_export_of_before_has_no_order(folder, beside):
    """Then its points are compared with the set, where that lies beside it."""

    def change(told):
        del told["projected_order"]
        told["y"][7][1] += 1e-9

    export = forged_export(folder, change)
    if not beside:
        (folder / "a.split").unlink()
    assert failed(export) == ({"json: points"} if beside else set())


def test_answers_that_the_set_does_not_give(folder):
    """A forger who changes all of an export alike has not changed the set beside it."""

    def change(told):
        del told["projected_order"]
        told["projected_weights"] = [[2.0 * one for one in row] for row in told["projected_weights"]]

    def change_stored(stored):
        stored["mean"] = [[2.0 * one for one in row] for row in stored["mean"]]

    forged_export(folder, change_stored, "a_check.json")
    assert failed(forged_export(folder, change)) == {"set: answers"}


@pytest.mark.parametrize("order", [[0, 0], [-1], [0.5], "x", None])
def test_an_order_that_is_none(folder, order):
    def change(told):
        told["projected_order"] = order

    assert failed(forged_export(folder, change)) == {"json: answers"}


def changed_value(diagnosis: Path) -> None:
    told = json.loads((diagnosis / "diagnosis.json").read_text())
    told["findings"][0]["parameters"]["gain"]["value"] += 0.001
    (diagnosis / "diagnosis.json").write_text(json.dumps(told, indent=2) + "\n")


def test_a_value_in_a_diagnosis(folder):
    diagnosis, invented = folder / "diagnosis", {"source d0.parquet", "source car.yaml"}
    changed_value(diagnosis)
    found = {"report against document", "vehicle_corrected.yaml"}
    assert failed(diagnosis) - invented == {*found, "diagnosis.json"}
    write_digests(diagnosis)
    assert failed(diagnosis) - invented == found


def test_a_gap_and_a_figure_of_another_diagnosis(folder):
    diagnosis, other = folder / "diagnosis", folder / "other"
    write_diagnosis(mismatch("d1.parquet"), CAR, other, [replace(read_drive(folder / "d1.parquet"), name="d1.parquet")])
    shutil.copy(other / "gap.parquet", diagnosis)
    assert "gap.parquet" in failed(diagnosis)
    write_digests(diagnosis)
    assert "gap.parquet" in failed(diagnosis)
    (diagnosis / "figures" / "strip-vx.png").write_bytes((diagnosis / "figures" / "strip-vy.png").read_bytes())
    assert "figures/strip-vx.png" in failed(diagnosis)


def test_a_number_of_a_comparison(folder):
    table = folder / "compared" / "compare.csv"
    rows = table.read_text().splitlines()
    cells = rows[1].split(",")
    assert all(float(cell) > 0.0 for cell in cells[5:8])
    cells[5] = str(0.5 * (float(cells[6]) + float(cells[7])))  # within its interval
    table.write_text("\n".join([rows[0], ",".join(cells), *rows[2:]]) + "\n")
    assert failed(folder / "compared") == {"compare.csv", "report against compare.csv"}
    write_digests(folder / "compared")
    assert failed(folder / "compared") == {"report against compare.csv"}
    cells[5] = str(1.01 * float(cells[7]))  # outside
    table.write_text("\n".join([rows[0], ",".join(cells), *rows[2:]]) + "\n")
    assert "report against compare.csv" in failed(folder / "compared")
    (folder / "compared" / DIGESTS).write_text("../../../etc/passwd\n")
    assert "digests" in failed(folder / "compared")


def test_a_comparison_of_too_few_blocks_for_an_interval_is_whole(folder):
    models, on = (folder / "car.yaml", folder / "a.split"), ("--on", folder / "d1.parquet", "--horizon", "0.2")
    split("compare", *models, *on, "-o", folder / "short")
    assert ",nan,nan," in (folder / "short" / "compare.csv").read_text()
    assert failed(folder / "short") == set()


def test_a_page_that_was_cut(folder):
    page = folder / "compared" / "report.html"
    page.write_text(page.read_text()[:-20])
    assert failed(page) == {"page"}


def test_a_drive_of_another_source_entered_in_a_manifest(folder):
    drives = folder / "drives"
    drives.mkdir()
    drive = read_drive(folder / "d0.parquet")
    told = replace(drive.metadata, sources=(Source("lap.csv", "ab" * 32),))
    write_drive(replace(drive, metadata=told), drives / "lap.parquet")
    entry = {"source": "ab" * 32, "settings": "", "drive": "lap.parquet"}
    manifest = {"format": "split-ingest/1", "drives": {"lap.csv": entry}}

    def enter() -> None:
        entry["sha256"] = sha256_of_file(drives / "lap.parquet")
        (drives / "ingest-manifest.json").write_text(json.dumps(manifest))

    enter()
    assert failed(drives) == set()
    other = read_drive(folder / "d1.parquet")
    told = replace(other.metadata, sources=(Source("lap.csv", "cd" * 32),))
    write_drive(replace(other, metadata=told), drives / "lap.parquet")
    enter()
    assert failed(drives) == {"lap.parquet of lap.csv"}


@pytest.mark.parametrize("value", [None, -1, "x", [], {}, [None], 1e308, "../../etc/passwd"])
def test_a_key_of_another_kind_is_a_failed_check_or_one_line(folder, value):
    cases = [("export", "manifest.json", key) for key in ("name", "targets", "files", "set", "real")]
    cases += [("export", "a_check.json", key) for key in ("z", "mean")]
    cases += [("diagnosis", "diagnosis.json", key) for key in ("findings", "inputs", "verdict", "schema")]
    for place, name, key in cases:
        path, manifest = folder / place / name, folder / "export" / "manifest.json"
        whole, entered = path.read_text(), manifest.read_text()
        path.write_text(json.dumps({**json.loads(whole), key: value}))
        if name == "a_check.json":
            told = json.loads(entered)
            told["files"][name] = sha256_of_file(path)
            manifest.write_text(json.dumps(told))
        try:
            passed = not failed(folder / place)
        except SplitError:
            passed = False
        assert not passed or key in ("set", "real"), (name, key)
        path.write_text(whole)
        manifest.write_text(entered)


@pytest.mark.parametrize(
    "change",
    [
        {"window": 0},
        {"window": "x"},
        {"horizon": -1.0},
        {"horizon": 1e308},
        {"vehicle_digest": 5},
        {"drive": None},
        {"region": {"alpha_max": None}},
        {"region": []},
        {"features": {}},
        {"duration": float("inf")},
        {"plain": 1},
        {"features": [1]},
    ],
    ids=str,
)
def test_a_header_that_no_labels_have(folder, change):
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(folder / "l.parquet")
    told = json.loads(table.schema.metadata[b"split"])
    table = table.replace_schema_metadata({b"split": json.dumps({**told, **change}).encode()})
    pyarrow.parquet.write_table(table, folder / "l.parquet", write_page_checksum=True)
    with pytest.raises(SplitError, match="cannot be read as labels"):
        verify(folder / "l.parquet")
