"""Sealing, resuming, and that identification sees no answers."""

import json
import shutil
from pathlib import Path

import pytest

from split_cli.diagnosis.statement.result import Diagnosis
from split_cli.errors import SplitError
from split_cli.logs.drive import write_drive
from split_cli.proof.generate import generate_cases
from split_cli.proof.store import check_seal, read_answer, read_heldout, shown_cases
from split_cli.vehicle.parameters import read_vehicle, write_vehicle
from split_cli.workflows.engine import Engine
from split_cli.workflows.proving import prove
from split_cli.workflows.proving.prove_recording import prove_recording
from tests.factories import make_drive, road_car


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Two cases, the second in a run of its own: the first one, made again among two, has to be the same."""
    root = tmp_path_factory.mktemp("proof") / "out"
    counts = []
    for cases in (1, 2):
        seal = generate_cases(root, 4, cases, kinds=("null", "single"), count=lambda *at: counts.append(at))
    assert counts == [(1, 1), (2, 2)]
    return root, seal


@pytest.fixture
def copy(made, tmp_path):
    root, seal = made
    return shutil.copytree(root, tmp_path / "copy"), seal


def test_a_run_that_was_cut_off_ends_with_the_same_seal_and_drives(copy):
    root, seal = copy
    drives = {path: path.read_bytes() for path in (root / "cases" / "0001").iterdir()}
    shutil.rmtree(root / "cases" / "0001")  # the null, which is quickly made again
    (root / "sealed" / "0001.json").unlink()
    (root / "seal.json").unlink()
    with pytest.raises(SplitError, match="seal"):
        check_seal(root)
    again = generate_cases(root, 4, 2, kinds=("null", "single"))
    assert again == seal and all(path.read_bytes() == content for path, content in drives.items())


def test_nothing_is_made_twice(copy, monkeypatch):
    root, seal = copy
    monkeypatch.setattr("split_cli.proof.generate.build_case", lambda plan: pytest.fail("built again"))
    assert generate_cases(root, 4, 2, kinds=("null", "single")) == seal


def test_cases_of_another_seed_do_not_mix(copy):
    with pytest.raises(SplitError, match="seed"):
        generate_cases(copy[0], 5, 2, kinds=("null", "single"))


@pytest.mark.parametrize("damage", ["change", "add", "remove", "list"])
def test_a_broken_seal_is_noticed(copy, damage):
    root, _ = copy
    path = root / "sealed" / "0001.json"
    if damage == "change":
        path.write_text(path.read_text().replace("bare", "rich").replace("plant", "nominal"))
    elif damage == "add":
        (root / "sealed" / "0009.json").write_text("{}")
    elif damage == "remove":
        path.unlink()
    else:
        told = json.loads((root / "seal.json").read_text())
        told["files"]["0001.json"] = "0" * 64
        (root / "seal.json").write_text(json.dumps(told))
    with pytest.raises(SplitError):
        check_seal(root)


def test_answers_and_held_out_drives_come_back_whole(made):
    root, _ = made
    kinds = [read_answer(root, case.name).kind for case in shown_cases(root)]
    assert sorted(kinds) == ["null", "single"]
    for case in shown_cases(root):
        heldout, noise = read_heldout(root, case.name)
        assert (heldout is None) == (read_answer(root, case.name).kind == "null")
        assert noise.shape == (3,) and (noise > 0).all()


def test_what_is_shown_tells_nothing(made):
    root, _ = made
    for case in shown_cases(root):
        names = {path.name for path in case.real.parent.iterdir()}
        assert names <= {"real.parquet", "sim.parquet", "vehicle.yaml"}
        answer = read_answer(root, case.name)
        content = case.real.read_bytes() + case.vehicle.read_bytes()
        for word in ("effect_to_noise", answer.kind, answer.car, *(effect.term for effect in answer.effects)):
            assert word.encode() not in content


def test_identification_is_handed_the_shown_files_only_and_takes_up_where_it_stopped(copy, monkeypatch):
    root, seal = copy
    asked = []

    def diagnose(real, vehicle, *, simulated=()):
        asked.append([*real, vehicle, *simulated])
        if len(asked) == 2:
            raise SplitError("too short")
        return Diagnosis("match", 1.0, 1.0), read_vehicle(vehicle), ()

    monkeypatch.setattr("split_cli.workflows.diagnose.read_and_diagnose", diagnose)
    (root / "results").mkdir()
    for case in shown_cases(root):
        prove._identify((case, root / "results"))
    assert all("sealed" not in str(path) for paths in asked for path in paths)
    notes = [json.loads((root / "results" / f"000{n}.json").read_text()) for n in (1, 2)]
    assert [bool(note["error"]) for note in notes] == [False, True]
    # All are answered, so no worker has anything to do; a failure counts as undecided.
    assert prove.identify_cases(root) == seal
    assert prove.read_statement(root, "0001").verdict == "match"
    assert prove.read_statement(root, "0002").verdict == "undecided"
    score = prove.score_cases(root)
    assert score.identified == 2 and score.failed == (("0002", "too short"),)
    outcomes = {s.answer.kind: s.outcome for s in score.scores}
    assert outcomes == {"null": "exact", "single": "missed"}


def test_another_engine_is_handed_the_same_tasks_by_full_paths(copy, monkeypatch):
    root, seal = copy
    given: list[Path] = []

    def apply(function, tasks):
        for case, results in tasks:
            given.extend((case.real, case.vehicle, results))
            yield function((case, results))

    monkeypatch.setattr(
        "split_cli.workflows.diagnose.read_and_diagnose",
        lambda real, vehicle, *, simulated=(): (Diagnosis("match", 1.0, 1.0), read_vehicle(vehicle), ()),
    )
    monkeypatch.chdir(root.parent)
    counts: list[tuple[int, int]] = []
    cluster = Engine("others", 2, apply)
    assert prove.identify_cases(Path(root.name), count=lambda *at: counts.append(at), cluster=cluster) == seal
    assert counts == [(1, 2), (2, 2)] and len(given) == 6 and all(path.is_absolute() for path in given)
    assert prove.read_statement(root, "0002").verdict == "match"


def test_nothing_is_scored_before_something_was_identified(copy):
    with pytest.raises(SplitError, match="identified"):
        prove.score_cases(copy[0])


def test_what_is_refused_leaves_no_folder(tmp_path):
    for arguments in ((5000, 1), (1, 1)):
        with pytest.raises(SplitError):
            generate_cases(tmp_path / "out", *arguments, kinds=("nan",))
    write_vehicle(road_car(), tmp_path / "car.yaml")
    write_drive(make_drive(0, segments=1, seconds=3.0), tmp_path / "short.parquet")
    for name in ("missing.parquet", "short.parquet"):
        with pytest.raises(SplitError):
            prove_recording([tmp_path / name], tmp_path / "car.yaml", tmp_path / "out")
    assert not (tmp_path / "out").exists()
