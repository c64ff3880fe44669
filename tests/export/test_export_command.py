"""split export and split verify from the command line to the files, and when something is wrong."""

import json
import shutil
from dataclasses import replace

import pytest
from click.testing import CliRunner

from split_cli.cli.export import command as export_command
from split_cli.cli.verify import command as verify_command
from split_cli.errors import ExportError, SplitError
from split_cli.export import targets
from split_cli.export.verify import verify_folder
from split_cli.files import sha256_of_file
from split_cli.learning.training_set import read_set, write_set
from split_cli.prediction import make_predictor
from split_cli.scoring.export_warnings import reservations
from split_cli.workflows.export import export_set


@pytest.fixture(scope="session")
def set_file(small_set, tmp_path_factory):
    path = tmp_path_factory.mktemp("set") / "my car.split"
    write_set(small_set, path)
    return path


@pytest.fixture(scope="module")
def written(set_file, tmp_path_factory):
    folder = tmp_path_factory.mktemp("export") / "out"
    export_set(set_file, folder, ["c", "npz"], queries=300)
    return folder


@pytest.fixture
def exported(written, tmp_path):
    """A copy of its own, to change."""
    return shutil.copytree(written, tmp_path / "out")


def test_every_target_from_the_command_line(set_file, tmp_path, compiler):
    folder = tmp_path / "out"
    arguments = [str(set_file), "-o", str(folder), "--queries", "500", "--json"]
    for target in ("c", "casadi", "npz", "json"):
        arguments += ["--target", target]
    done = CliRunner().invoke(export_command, arguments, catch_exceptions=False)
    assert done.exit_code == 0
    report = json.loads(done.stdout)
    assert [entry["target"] for entry in report["targets"]] == ["c", "casadi", "npz", "json"]
    assert all(entry["check"]["mean_error"] <= 1e-12 for entry in report["targets"])
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["set"] == {"name": "my car.split", "sha256": sha256_of_file(set_file)}
    header = (folder / "my_car.h").read_text()
    assert report["reservations"] == manifest["reservations"] == list(reservations(read_set(set_file)))
    assert all(text in " ".join(header.replace("\n *", " ").split()) for text in report["reservations"])
    macro = header.split("MY_CAR_SUPPORTED_VARIANCE {")[1].split("}")[0]
    assert [float(value) for value in macro.split(",")] == manifest["supported_variance"]
    trained = read_set(set_file)
    told = trained.trust.array > 0.0  # of an output without trust the variance is the same everywhere
    for z, supported in ((trained.z, True), (trained.z + 1e3 * trained.kernel.length_scales, False)):
        below = make_predictor("bcm", trained).predict(z).variance <= manifest["supported_variance"]
        assert (below[:, told] == supported).mean() > 0.9
    assert manifest["vehicle"]["mass"] == 1500.0 and "frame" in manifest["conventions"]
    written = {path.name for path in folder.iterdir()}
    assert written == set(manifest["files"]) | {"manifest.json"}
    assert {"my_car.c", "my_car.h", "my_car.casadi", "my_car_step.casadi", "my_car_acados.c"} <= written
    for name in ("my_car.h", "my_car.json"):
        assert sha256_of_file(set_file).encode() in (folder / name).read_bytes()
    verified = CliRunner().invoke(verify_command, [str(folder)], catch_exceptions=False)
    assert verified.exit_code == 0 and "FAILED" not in verified.output and "not checked" not in verified.output
    told = " ".join(verified.output.split())
    assert "of the running trust" in told and "the running trust after 4 intervals" in told
    stored = json.loads((folder / "my_car_check.json").read_text())
    stored["observed"]["trust"][0][2] += 1e-4
    (folder / "my_car_check.json").write_text(json.dumps(stored))
    manifest["files"]["my_car_check.json"] = sha256_of_file(folder / "my_car_check.json")
    (folder / "manifest.json").write_text(json.dumps(manifest))
    assert [one.check for one in verify_folder(folder) if one.passed is False] == ["casadi: answers"]


@pytest.mark.parametrize("queries", ["99", "10000001", "1e3", "nan"])
def test_a_number_of_queries_without_bound_is_wrong_usage(set_file, tmp_path, queries):
    arguments = [str(set_file), "--target", "npz", "-o", str(tmp_path / "out"), "--queries", queries]
    done = CliRunner().invoke(export_command, arguments)
    assert done.exit_code == 2 and "--queries" in done.output and not (tmp_path / "out").exists()


def test_two_exports_are_the_same_bytes(set_file, tmp_path, monkeypatch):
    # Compiling changes nothing of what is written but the compiler's name in the manifest.
    monkeypatch.setattr(targets, "find_compiler", lambda: None)
    for name in ("a", "b"):
        export_set(set_file, tmp_path / name, ["c", "casadi", "npz", "json"], queries=200)
    assert sha256_of_file(tmp_path / "a") == sha256_of_file(tmp_path / "b")


def test_a_failed_check_leaves_the_old_export_whole(set_file, exported, monkeypatch):
    before = sha256_of_file(exported)
    right = targets.projection_data

    def wrong(predictor, real="double"):
        tables = right(predictor, real)
        return replace(tables, weights=tables.weights * (1.0 + 1e-9))

    monkeypatch.setattr(targets, "projection_data", wrong)
    with pytest.raises(ExportError, match="nothing was written"):
        export_set(set_file, exported, ["c"], queries=300)
    assert sha256_of_file(exported) == before
    with pytest.raises(ExportError):
        export_set(set_file, exported.parent / "new", ["npz", "c"], queries=300)
    assert not (exported.parent / "new").exists()
    assert not [path for path in exported.parent.iterdir() if path.name.endswith(".part")]


def test_without_a_compiler_the_c_is_said_to_be_unverified(set_file, tmp_path, monkeypatch):
    monkeypatch.setattr(targets, "find_compiler", lambda: None)
    result = export_set(set_file, tmp_path / "out", ["c"], queries=200)
    assert result.targets[0].check is None and "not compiled, hence not verified" in result.targets[0].note
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert manifest["verification"]["c"]["verified"] is False


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"targets": ["cpp"]}, "no target 'cpp'"),
        ({"targets": []}, "no target"),
        ({"real": "half"}, "half"),
        ({"predictor": "full"}, "full"),
        ({"queries": 3}, "3 queries"),
    ],
)
def test_unknown_words_are_named(set_file, tmp_path, changes, message):
    arguments = {"targets": ["c"], **changes}
    with pytest.raises(ExportError, match=message):
        export_set(set_file, tmp_path / "out", arguments.pop("targets"), **arguments)


@pytest.mark.parametrize("name", ["my_car.npz", "my_car.c", "my_car_check.json"])
def test_a_changed_file_fails_verification(exported, name):
    path = exported / name
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    failed = [finding.check for finding in verify_folder(exported) if finding.passed is False]
    assert failed == [f"{name}: SHA-256"]
    with pytest.raises(SplitError, match=name):
        CliRunner().invoke(verify_command, [str(exported)], catch_exceptions=False)


def test_changed_tables_with_a_forged_hash_fail_by_their_answers(exported, compiler):
    path = exported / "my_car.c"
    text = path.read_text()
    start = text.index("static const real weights[")
    begin = text.index("{", start) + 1
    end = text.index(",", begin)
    path.write_text(text[:begin] + f"\n    {float(text[begin:end]) * 1.5 + 0.1!r}" + text[end:])
    manifest = json.loads((exported / "manifest.json").read_text())
    manifest["files"]["my_car.c"] = sha256_of_file(path)
    (exported / "manifest.json").write_text(json.dumps(manifest))
    findings = {finding.check: finding.passed for finding in verify_folder(exported)}
    assert findings["my_car.c: SHA-256"] is True
    assert findings["c: answers"] is False and findings["npz: answers"] is True


def test_a_manifest_may_not_point_outside_its_folder(exported):
    manifest = json.loads((exported / "manifest.json").read_text())
    manifest["files"]["../secret"] = "0" * 64
    (exported / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(ExportError, match="elsewhere"):
        verify_folder(exported)
