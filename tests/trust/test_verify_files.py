"""`split verify` on every file of ours: what is whole passes, each kind of damage fails the check it concerns."""

import contextlib
import json
import random
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from split_cli.cli.verify import command
from split_cli.errors import SplitError
from split_cli.files import sha256_of_file
from split_cli.logs.drive import Source, read_drive, write_drive
from split_cli.workflows.info import describe_file
from split_cli.workflows.verifying.verify import verify
from tests.studies.fuzz import mutate_json
from tests.trust.test_forged_folders import failed

FILES = Path(__file__).parents[1] / "golden" / "files"


@pytest.fixture
def folder(tmp_path):
    shutil.copytree(FILES, tmp_path / "f")
    return tmp_path / "f"


def changed(folder, **columns) -> Path:
    drive = read_drive(folder / "drive-1.parquet")
    write_drive(replace(drive, columns={**drive.columns, **columns}), folder / "drive-1.parquet")
    return folder / "drive-1.parquet"


def test_ranges_and_physics(folder):
    drive = read_drive(folder / "drive-1.parquet")
    with pytest.raises(SplitError, match="no number is a measurement"):
        verify(changed(folder, vx=1e6 + drive["vx"]))
    shutil.copy(FILES / "drive-1.parquet", folder)
    assert failed(changed(folder, r=300.0 * drive["r"])) == {"physical consistency"}
    assert failed(changed(folder, r=drive["r"])) == set()


def test_sources_beside_a_drive(folder):
    drive = read_drive(folder / "drive-1.parquet")
    (folder / "lap.csv").write_text("t,vx\n0,1\n")
    digest = sha256_of_file(folder / "lap.csv")
    metadata = replace(drive.metadata, sources=(Source("lap.csv", digest),))
    write_drive(replace(drive, metadata=metadata), folder / "drive-1.parquet")
    assert failed(folder / "drive-1.parquet") == set()
    assert {i.check: i.passed for i in verify(folder / "drive-1.parquet").items}["source lap.csv"] is True
    (folder / "lap.csv").write_text("t,vx\n0,2\n")
    assert failed(folder / "drive-1.parquet") == {"source lap.csv"}


@pytest.mark.parametrize("name", ["drive-1.parquet", "labels-1.parquet", "set-2.split"])
def test_a_flipped_bit_is_seen_wherever_it_is(folder, name):
    # Pages, digests and footers: no place of these files may change unseen.
    whole = (folder / name).read_bytes()
    rng = np.random.default_rng(3)
    unseen = []
    for at in rng.integers(0, len(whole), 60):
        damaged = bytearray(whole)
        damaged[at] ^= 1 << int(rng.integers(8))
        (folder / name).write_bytes(damaged)
        try:
            unseen += [] if failed(folder / name) else [int(at)]
        except SplitError:
            continue
    # What Arrow's and Parquet's own footers repeat, and padding, changes no number that is read.
    assert len(unseen) <= 12, unseen


@pytest.mark.parametrize("read", [verify, describe_file])
def test_a_column_whose_name_is_no_text_is_refused_in_one_line(folder, read):
    """The name that pyarrow cannot decode was an error of the program."""
    content = (folder / "labels-1.parquet").read_bytes()
    (folder / "labels-1.parquet").write_bytes(content.replace(b"alpha_r", b"\xfflpha_r"))
    with pytest.raises(SplitError, match="is not a whole Parquet file"):
        read(folder / "labels-1.parquet")


def test_yaml(folder):
    text = (folder / "vehicle-1.yaml").read_text()
    (folder / "vehicle-1.yaml").write_text(text.replace("mass", "maas", 1))
    with pytest.raises(SplitError, match="mass"):
        verify(folder / "vehicle-1.yaml")
    for entry, says in {
        "{term: __class__, parameters: {x: 1}}": "unknown term",
        "{term: drive_gain, parameters: {}}": "lacks",
    }.items():
        bare = text.partition("effects:")[0]
        (folder / "vehicle-1.yaml").write_text(f"{bare}effects:\n  - {entry}\n")
        with pytest.raises(SplitError, match=says):
            verify(folder / "vehicle-1.yaml")
    (folder / "vehicle-1.yaml").write_text(re.sub(r"max_torque:.*", "max_torque: 1" + 30 * "0", text))
    with pytest.raises(SplitError, match="max_torque"):
        verify(folder / "vehicle-1.yaml")
    (folder / "hyperparameters-1.yaml").write_text("length_scales: {alpha_f: -1}\n")
    with pytest.raises(SplitError):
        verify(folder / "hyperparameters-1.yaml")


def test_an_export_against_its_set(folder):
    assert failed(folder / "export-1") == set()
    assert {i.check: i.passed for i in verify(folder / "export-1").items}["trained set"] is True
    shutil.copy(folder / "vehicle-1.yaml", folder / "set-2.split")
    assert failed(folder / "export-1") == {"trained set"}


def test_a_report_of_another_diagnosis(folder):
    diagnosis = folder / "diagnosis-1"
    told = json.loads((diagnosis / "diagnosis.json").read_text())
    shown = " ".join([*(f["term"] for f in told["findings"]), *(i["sha256"] for i in told["inputs"])])
    (diagnosis / "report.html").write_text(f"<html>{shown}</html>")
    assert failed(diagnosis) == set()
    (diagnosis / "report.html").write_text(f"<html>{shown[:-5]}</html>")
    assert failed(diagnosis) == {"report against document"}
    told["findings"][0]["parameters"][next(iter(told["findings"][0]["parameters"]))]["value"] = 1e9
    (diagnosis / "diagnosis.json").write_text(json.dumps(told))
    assert "document" in failed(diagnosis / "diagnosis.json")


def test_a_folder_of_drives_against_its_manifest(folder):
    drives = folder / "drives"
    drives.mkdir()
    shutil.copy(folder / "drive-1.parquet", drives / "a.parquet")
    entry = {"source": "x", "settings": "y", "drive": "a.parquet", "sha256": sha256_of_file(drives / "a.parquet")}
    manifest = {"format": "split-ingest/1", "drives": {"a.csv": entry}}
    (drives / "ingest-manifest.json").write_text(json.dumps(manifest))
    assert failed(drives) == set()
    done = CliRunner().invoke(command, [str(drives)], catch_exceptions=False)
    assert done.exit_code == 0 and "passed" in done.output
    changed(folder, vx=read_drive(folder / "drive-1.parquet")["vx"] + 1.0)
    shutil.copy(folder / "drive-1.parquet", drives / "a.parquet")
    assert failed(drives) == {"a.parquet of a.csv"}
    (folder / "nothing").mkdir()
    with pytest.raises(SplitError, match="neither an export"):
        verify(folder / "nothing")
    with pytest.raises(SplitError, match="no such"):
        verify(folder / "absent.split")


def test_a_file_of_a_folder_is_checked_with_it(folder):
    """Of both it was said that this program does not write them."""
    with pytest.raises(SplitError, match="checked with the export that it lies in"):
        verify(next((folder / "export-1").glob("*_check.json")))
    (folder / "ingest-manifest.json").write_text("[]")
    with pytest.raises(SplitError, match="no manifest of this version"):
        verify(folder / "ingest-manifest.json")


def test_results_whose_values_were_forged_are_refused_or_read(folder):
    """A hundred and twenty seeded forgeries of a diagnosis and of the manifests of an export and of a folder."""
    rng = random.Random(7)
    for path in ("diagnosis-1/diagnosis.json", "export-1/manifest.json", "drives-1/ingest-manifest.json"):
        content = (folder / path).read_bytes()
        for _ in range(40):
            (folder / path).write_bytes(mutate_json(content, rng))
            for look in (verify, describe_file):
                with contextlib.suppress(SplitError):
                    look(folder / path)
    diagnosis = json.loads((FILES / "diagnosis-1" / "diagnosis.json").read_text())
    diagnosis["inputs"][0]["name"] = "x" * 9999  # longer than any file system takes
    (folder / "diagnosis-1" / "diagnosis.json").write_text(json.dumps(diagnosis))
    assert [i.passed for i in verify(folder / "diagnosis-1").items if i.check.startswith("source xx")] == [None]
