"""Files that earlier versions wrote open in this one, with the numbers they had; and without our code."""

import csv
import hashlib
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from split_cli.learning.features import parse_features
from split_cli.learning.kernel_file import read_kernel
from split_cli.learning.label_file import read_labels
from split_cli.learning.training_set import read_set, write_set
from split_cli.logs.drive import read_drive
from split_cli.logs.signal_map import read_map
from split_cli.prediction import make_predictor
from split_cli.vehicle.parameters import read_vehicle
from split_cli.workflows.verifying.verify import verify
from tests.golden.make import MAP, compared, evaluated
from tests.optional import needed

FILES = Path(__file__).parent / "files"
KEYS = ("name", "features", "drive", "horizon")
DIGESTS = {
    "comparison-1/SHA256SUMS": "f723153dbf407d01",
    "comparison-1/compare.csv": "42648f5e6c21f296",
    "comparison-1/report.html": "83adb4c3aa7476a3",
    "drives-1/drive-1.parquet": "77a8e5e93f5a093e",
    "drives-1/ingest-manifest.json": "f2ebc40d3f09ea4d",
    "evaluation-1.json": "5110cc82b9ac63db",
    "set-1.split": "019d28a0b943926e",
    "export-2/manifest.json": "9d71073a4901f17c",
    "export-2/set_3.json": "48add03d4c10aff0",
    "export-2/set_3_check.json": "904f13d01498d866",
    "export-2/split-export.schema.json": "211042a68b4a5d15",
    "set-3.split": "cb61e54941e72ddf",
    "diagnosis-1/diagnosis.json": "3b98fce866f88d7a",
    "diagnosis-1/vehicle_corrected.yaml": "41994c61d4d9a739",
    "drive-1.parquet": "77a8e5e93f5a093e",
    "export-1/manifest.json": "7071b9398115e182",
    "export-1/set_2.json": "8bbebce0d97fac2a",
    "export-1/set_2.npz": "017beaf44dbbfc30",
    "export-1/set_2_check.json": "66c1a100e9206107",
    "export-1/split-export.schema.json": "51e876bd9971b112",
    "hyperparameters-1.yaml": "4623fad9690280eb",
    "labels-1.parquet": "95f5efc7162739a5",
    "map-1.yaml": "af86e84ccca98334",
    "set-2.split": "04e906701562d935",
    "vehicle-1.yaml": "5e4c45f5e4b7374b",
}


def test_the_files_are_those_that_were_committed():
    found = {
        str(path.relative_to(FILES)): hashlib.sha256(path.read_bytes()).hexdigest()[:16]
        for path in sorted(FILES.rglob("*"))
        if path.is_file()
    }
    assert found == DIGESTS


@pytest.mark.parametrize(
    "name", [path.name for path in sorted(FILES.iterdir()) if path.stem not in ("diagnosis-1", "evaluation-1")]
)
def test_every_file_passes_its_checks(name):
    found = verify(FILES / name)
    assert found.items and found.passed, [i for i in found.items if i.passed is False]


def test_a_drive():
    drive = read_drive(FILES / "drive-1.parquet")
    assert (len(drive), len(drive.segments()), drive.period) == (202, 2, 0.02)
    assert drive["vx"].sum() == 4613.059343412 and drive["r"][17] == 0.018234510679691993
    m = drive.metadata
    assert m.kinds["delta"] == "command" and m.between == {"delta": "held", "T": "continuous"}
    assert m.noise_of("vx").autocorrelation == (1.0, 0.2) and m.noise_of("T").reason == "derived"
    assert m.sources[0].name == "lap.csv" and m.conversions == ("vx: km/h to m/s",)


def test_labels():
    labels = read_labels(FILES / "labels-1.parquet")
    assert (len(labels), labels.counts()) == (101, {"gap": 1})
    assert labels.y[labels.accepted].sum() == -1.7642997106375358


def test_a_set_predicts_what_it_predicted(tmp_path):
    trained = read_set(FILES / "set-2.split")
    assert (trained.size, trained.cell_count) == (80, 78)
    assert trained.y.sum() == -9.352257766508735
    # Stored queries with the answers of the version that wrote them: other processors round otherwise.
    stored = json.loads((FILES / "export-1" / "set_2_check.json").read_text())
    found = make_predictor("rbcm", trained).predict(np.array(stored["z"]))
    np.testing.assert_allclose(found.mean, stored["mean"], atol=1e-10)
    np.testing.assert_allclose(found.variance, stored["variance"], atol=1e-10)
    write_set(trained, tmp_path / "again.split")
    assert verify(tmp_path / "again.split").passed


def test_a_set_of_all_labels_predicts_what_it_predicted():
    trained = read_set(FILES / "set-3.split")
    assert (trained.size, trained.cell_count) == (80, 79)
    assert trained.y.sum() == 2.085005710135012
    stored = json.loads((FILES / "export-2" / "set_3_check.json").read_text())
    queries = np.array(stored["z"])
    found = make_predictor("projected", trained).predict(queries)
    np.testing.assert_allclose(found.mean, stored["mean"], atol=1e-10)
    np.testing.assert_allclose(found.variance, stored["variance"], atol=1e-10)
    assert np.abs(make_predictor("bcm", trained).predict(queries).mean - stored["mean"]).max() > 0.01


def test_a_set_of_the_first_format_is_trusted_as_a_whole():
    first, second = read_set(FILES / "set-1.split"), read_set(FILES / "set-2.split")
    for name in ("z", "y", "gamma", "offsets", "row"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert first.trust.share == (1.0, 1.0, 1.0) and first.trust.doubt is None


def test_an_evaluation_and_a_comparison_give_the_numbers_they_gave(tmp_path):
    """Within 1e-6, as is promised of versions and libraries; the time per query is this machine's."""
    found, stored = json.loads(evaluated(FILES)), json.loads((FILES / "evaluation-1.json").read_text())
    assert found["scores"] and len(found["scores"]) == len(stored["scores"])
    for entry in stored["scores"] + stored["rollouts"]:
        same = [e for e in found["scores"] + found["rollouts"] if all(e.get(k) == entry.get(k) for k in KEYS)]
        assert len(same) == 1 and set(entry) <= set(same[0])
        for name in {"rmse", "skill_nominal", "coverage_95", "distance"} & set(entry):
            np.testing.assert_allclose(np.array(same[0][name], float), np.array(entry[name], float), rtol=1e-6)
    compared(FILES, tmp_path / "again")
    before, now = (
        list(csv.DictReader((p / "compare.csv").open())) for p in (FILES / "comparison-1", tmp_path / "again")
    )
    for row, again in zip(before, now, strict=True):
        assert (row["model"], row["state"]) == (again["model"], again["state"])
        for name in ("rmse", "low_95", "high_95"):
            assert float(again[name]) == pytest.approx(float(row[name]), rel=1e-6, nan_ok=True)


def test_yaml_files():
    assert read_vehicle(FILES / "vehicle-1.yaml").mass == 1500.0
    assert (FILES / "map-1.yaml").read_text() == MAP
    signal_map = read_map(FILES / "map-1.yaml")
    assert signal_map.channel("delta").sources[0].curve[0] == (-1.0, -0.42) and signal_map.world == "ned"
    kernel = read_kernel(FILES / "hyperparameters-1.yaml", parse_features("z2"))
    np.testing.assert_array_equal(kernel.length_scales, read_set(FILES / "set-2.split").kernel.length_scales)
    assert read_vehicle(FILES / "diagnosis-1" / "vehicle_corrected.yaml").effects


def test_a_diagnosis_is_of_its_schema():
    jsonschema = needed("jsonschema")
    root = Path(__file__).parents[2]
    schema = json.loads((root / "split_cli" / "diagnosis" / "diagnosis.schema.json").read_text())
    told = json.loads((FILES / "diagnosis-1" / "diagnosis.json").read_text())
    jsonschema.validate(told, schema)
    found = {i.check: i.passed for i in verify(FILES / "diagnosis-1").items}
    assert found["document"] and found["vehicle_corrected.yaml"] and not found["report against document"]


def test_the_example_of_the_page_needs_nothing_of_ours(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "formats.md").read_text()
    code = re.search(r"<!-- plain pyarrow -->\n```python\n(.*?)```", page, re.DOTALL)[1]
    assert "split_cli" not in code and len(code.strip().splitlines()) <= 20
    for name in ("drive-1.parquet", "set-2.split"):
        (tmp_path / name).write_bytes((FILES / name).read_bytes())
    code = code.replace("lap.parquet", "drive-1.parquet").replace("car.split", "set-2.split")
    script = f"import sys; sys.modules['split_cli'] = None\n{code}"
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True)
    trained = read_set(FILES / "set-2.split")
    first = trained.z[0] @ np.ones(3)
    assert done.stdout.split()[:2] == ["202", "4613.059"]
    assert float(done.stdout.split()[-1]) == pytest.approx(first)
