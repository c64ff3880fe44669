"""A folder, a glob or an address stands for its logs, and what is done is not done again."""

import ctypes
import json
import os
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fsspec
import pytest
import zstandard

from split_cli.cli.main import main
from split_cli.errors import SplitError
from split_cli.logs.readers.opening import open_recording
from split_cli.workflows.engine import open_engine
from split_cli.workflows.ingesting.ingest import ingest_logs
from split_cli.workflows.ingesting.ingest_manifest import MANIFEST_NAME
from split_cli.workflows.simulate import SimulateSettings, simulate_log
from split_cli.workflows.sources import SourceFile, find_sources, skipped_files
from split_cli.workflows.training.train import train_set
from tests.conftest import ROOT
from tests.logs import readers_support as support
from tests.studies.hostile import NO_CAPABILITIES, SOMEONE_ELSE

CAR = ROOT / "sample_logs" / "road_car.yaml"


@pytest.fixture(scope="session")
def logs(tmp_path_factory) -> Path:
    """Three logs named as drives, two of them in a folder below."""
    folder = tmp_path_factory.mktemp("archive")
    (folder / "monday").mkdir()
    for seed, place in enumerate(("a.csv", "monday/a.csv", "monday/b.csv")):
        simulate_log(SimulateSettings(track="small", duration=6.0, seed=seed), folder / place)
    (folder / ".hidden").mkdir()
    (folder / ".hidden" / "x.csv").write_text("no")
    (folder / "notes.md").write_text("no log")
    return folder


@pytest.fixture
def archive(logs, tmp_path) -> Path:
    shutil.copytree(logs, tmp_path / "archive")
    return tmp_path / "archive"


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*.parquet"))}


def test_a_folder_stands_for_the_logs_in_and_below_it(archive, tmp_path):
    run = ingest_logs([archive], tmp_path / "drives")
    assert sorted(contents(tmp_path / "drives")) == ["a.parquet", "monday/a.parquet", "monday/b.parquet"]
    assert len(run.results) == 3 and not run.failures and not run.unchanged


def test_drives_that_lie_below_the_logs_are_no_logs(archive):
    """The second run refused the drives of the first as inputs that it would write over."""
    first = ingest_logs([archive], archive / "drives")
    again = ingest_logs([archive], archive / "drives")
    assert len(first.results) == len(again.unchanged) == 3 and not again.results
    assert skipped_files([archive], outside=archive / "drives") == {".md": 1}
    (archive / "drives" / "a.parquet").rename(archive / "drives" / "b.parquet")
    assert [s.place for s in find_sources([archive / "drives" / "b.parquet"], outside=archive / "drives")] == [
        "b.parquet"
    ]


@pytest.mark.parametrize(
    ("names", "whole"),
    [
        (("run_0.db3", "run_1.db3"), True),
        (("run.db3", "readme.md"), True),
        (("metadata.yaml", "a.db3", "b.csv"), True),
        (("monday.db3", "tuesday.db3"), False),
        (("run_0.db3", "lap.csv"), False),
        (("run_0.db3.zstd", "run_1.db3.zstd"), True),
        (("run.db3", "readme.txt"), True),
    ],
)
def test_a_folder_is_one_bag_only_if_all_it_holds_are_parts_of_it(tmp_path, names, whole):
    """Two days were joined into one drive, and a table beside a database was dropped without a word."""
    for name in names:
        (tmp_path / name).write_text("Monday, dry, 12 laps\n" if name == "readme.txt" else "")
    places = [source.place for source in find_sources([tmp_path])]
    assert places == ([tmp_path.name] if whole else sorted(names))


def test_a_glob_keeps_places_below_what_it_names(archive):
    assert [s.place for s in find_sources([archive / "mon*" / "*.csv"])] == ["monday/a.csv", "monday/b.csv"]
    assert [s.place for s in find_sources([archive / "**" / "a.csv"])] == ["a.csv", "monday/a.csv"]
    with pytest.raises(SplitError, match="holds no recording"):
        find_sources([archive / "*.mcap"])


def test_a_folder_in_a_glob_stands_for_the_logs_in_it(tmp_path):
    for name in ("a/run.csv", "a/notes.md", "b/below/run.csv", "run [1]/x.csv"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "b" / "up").symlink_to(tmp_path)
    places = {
        "*": ["a/run.csv", "b/below/run.csv", "run [1]/x.csv"],
        "b/*": ["below/run.csv", "up/a/run.csv", "up/run [1]/x.csv"],
        "b/**": ["below/run.csv"],
        "run [1]/*.csv": ["x.csv"],
        "run [[]1]/*.csv": ["run [1]/x.csv"],
        "a/*": ["notes.md", "run.csv"],
    }
    assert {glob: [source.place for source in find_sources([tmp_path / glob])] for glob in places} == places
    with pytest.raises(SplitError, match=r"write \[\[\] for the letter"):
        find_sources([tmp_path / "ru* [1]/*.csv"])


def test_one_file_under_several_ways_to_write_its_path_is_one(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x.csv").touch()
    (tmp_path / "a" / "latest.csv").symlink_to("x.csv")
    monkeypatch.chdir(tmp_path)
    ways = ["a/x.csv", "./a/x.csv", "a/../a/x.csv", tmp_path / "a" / "x.csv", tmp_path / "a"]
    assert [source.name for source in find_sources(ways)] == ["x.csv", "latest.csv"]


def test_a_name_that_is_no_text_is_told(tmp_path):
    with open(os.fsencode(tmp_path) + b"/caf\xe9.csv", "w"):
        pass
    (source,) = find_sources([tmp_path])
    with pytest.raises(SplitError, match="no text in UTF-8"), source.local():
        pass


def test_a_glob_tells_a_link_to_nothing(archive, tmp_path):
    """It was passed over, and the drive of a log that had moved was missing without a word."""
    (archive / "moved.csv").symlink_to(archive / "elsewhere.csv")
    run = ingest_logs([archive / "*.csv"], tmp_path / "drives", keep_going=True)
    assert [one.log for one in run.failures] == ["moved.csv"] and len(run.results) == 1


def test_before_what_is_there_is_compared_that_is_said(archive, tmp_path, monkeypatch):
    """Digests of a whole archive came before the first word, also where there was nothing to compare them with."""
    told, fingerprint = [], SourceFile.fingerprint
    monkeypatch.setattr(SourceFile, "fingerprint", lambda source: told.append(source.place) or fingerprint(source))
    ingest_logs([archive], tmp_path / "drives", progress=told.append)
    places = ["a.csv", "monday/a.csv", "monday/b.csv"]
    assert told == [line for n, place in enumerate(places, 1) for line in (place, f"[{n}/3] {place}")]
    told.clear()
    ingest_logs([archive], tmp_path / "drives", progress=told.append)
    assert told == ["comparing 3 recordings with those that were read before", *places]


def test_a_killed_ingest_goes_on_with_what_is_left(archive, tmp_path):
    def kill_at_the_second(text: str) -> None:
        if text.startswith("[2/"):
            os.kill(os.getpid(), signal.SIGKILL)

    child = os.fork()
    if child == 0:
        ingest_logs([archive], tmp_path / "drives", keep_going=True, progress=kill_at_the_second)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    run = ingest_logs([archive], tmp_path / "drives", keep_going=True)
    assert run.unchanged == ("a.csv",) and [one.log for one in run.results] == ["a.csv", "b.csv"]
    ingest_logs([archive], tmp_path / "unbroken", keep_going=True)
    folders = tmp_path / "drives", tmp_path / "unbroken"
    files = [{p.relative_to(f): p.read_bytes() for p in f.rglob("*") if p.is_file()} for f in folders]
    assert files[0] == files[1]


@pytest.mark.parametrize("how", ["grows", "is replaced", "is cut"])
def test_a_log_that_is_changed_while_it_is_read_is_refused(archive, tmp_path, monkeypatch, how):
    """A drive named the digest of a log that it was not made of."""
    whole = (archive / "a.csv").read_bytes()

    def opened(path, **settings):
        recording = open_recording(path, **settings)
        if Path(path) == archive / "a.csv" and how == "grows":
            with Path(path).open("ab") as stream:
                stream.write(whole.splitlines(keepends=True)[-1])
        elif Path(path) == archive / "a.csv" and how == "is replaced":
            (archive / "new").write_bytes(whole)
            os.replace(archive / "new", path)
        elif Path(path) == archive / "a.csv":
            os.truncate(path, 0)
        return recording

    monkeypatch.setattr("split_cli.workflows.ingesting.ingest.open_recording", opened)
    with pytest.raises(SplitError, match="was changed while it was read"):
        ingest_logs([archive / "a.csv"], tmp_path / "a.parquet")
    assert not list(tmp_path.glob("*.parquet"))
    (archive / "a.csv").write_bytes(whole)
    run = ingest_logs([archive], tmp_path / "drives", keep_going=True)
    assert [one.log for one in run.failures] == ["a.csv"] and len(run.results) == 2
    assert "was changed" in str(run.failures[0].error)


@pytest.mark.parametrize("keep_going", [False, True])
def test_only_what_is_new_or_changed_is_read_again(archive, tmp_path, keep_going):
    drives = tmp_path / "drives"
    ingest_logs([archive], drives, keep_going=keep_going)
    before = contents(drives)
    shutil.copy(archive / "a.csv", archive / "new.csv")
    text = (archive / "monday" / "b.csv").read_text().splitlines()
    (archive / "monday" / "b.csv").write_text("\n".join(text[:-5]) + "\n")  # five rows fewer
    run = ingest_logs([archive], drives, keep_going=keep_going)
    assert sorted(r.log for r in run.results) == ["b.csv", "new.csv"]
    assert sorted(run.unchanged) == ["a.csv", "monday/a.csv"]
    after = contents(drives)
    assert after["a.parquet"] == before["a.parquet"]
    assert after["monday/b.parquet"] != before["monday/b.parquet"]
    # A drive that went missing or was altered is made again, and other settings make all again.
    (drives / "a.parquet").write_bytes(b"x")
    assert [r.log for r in ingest_logs([archive], drives, keep_going=keep_going).results] == ["a.csv"]
    from split_cli.workflows.ingesting.ingest import IngestSettings

    assert len(ingest_logs([archive], drives, settings=IngestSettings(rate=20.0)).results) == 4


def test_one_bad_log_is_told_and_the_rest_is_there(archive, tmp_path):
    (archive / "bad.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(50))
    with pytest.raises(SplitError, match=r"bad\.mcap"):
        ingest_logs([archive], tmp_path / "none")
    assert not (tmp_path / "none").exists()
    long = "x" * 251 + ".csv"  # a name that its drive cannot have
    shutil.copy(archive / "a.csv", archive / long)
    run = ingest_logs([archive], tmp_path / "drives", keep_going=True)
    assert [f.log for f in run.failures] == ["bad.mcap", long] and len(run.results) == 3
    assert "File name too long" in str(run.failures[1].error)
    again = ingest_logs([archive], tmp_path / "drives", keep_going=True)
    assert len(again.unchanged) == 3 and len(again.failures) == 2


def test_a_folder_that_may_not_be_read_is_one_log_that_failed(archive, tmp_path):
    closed = archive / "closed"
    closed.mkdir()
    closed.chmod(0)
    if os.getuid() == 0:
        os.chown(closed, SOMEONE_ELSE, SOMEONE_ELSE)
    child = os.fork()
    if child == 0:
        code = 99
        try:
            if os.getuid() == 0:  # who may read everything
                ctypes.CDLL(None).capset(*NO_CAPABILITIES)
            skipped_files([archive])
            run = ingest_logs([archive], tmp_path / "drives", keep_going=True)
            told = [(one.log, "Permission denied" in str(one.error)) for one in run.failures]
            code = 0 if told == [("closed", True)] and len(run.results) == 3 else 1
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_what_a_folder_holds_beside_recordings_is_told(tmp_path, capsys):
    """Nothing was said of it: logs of an ending that is not looked for were thought to be in."""
    for name in ("a.csv", "b.jsonl", "c.md", "d.JSON", "e", ".f.md", "more/g.md", ".git/h.md"):
        (tmp_path / "logs" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "logs" / name).write_text("")
    (tmp_path / "logs" / "bag.md").mkdir()
    (tmp_path / "logs" / "bag.md" / "x.db3").write_text("")
    (tmp_path / "logs" / "loop").symlink_to(tmp_path / "logs")
    assert skipped_files([tmp_path / "logs"]) == {".md": 2, ".json": 1, "no ending": 1}
    assert skipped_files([tmp_path / "logs" / "a.csv", f"{tmp_path}/logs/*"]) == {}
    system = fsspec.filesystem("memory")
    system.put(str(tmp_path / "logs" / "more"), "/left/more", recursive=True)
    assert skipped_files(["memory://left"]) == {".md": 1}


def test_a_text_is_a_log_only_with_rows_of_numbers(tmp_path, capsys):
    """A README.txt beside logs was one of them, and `--list` of a folder named its packed recording alone."""
    planted = support.plant(count=40)
    support.write_ros2_mcap(tmp_path / "plain.mcap", planted)
    logs = tmp_path / "logs"
    logs.mkdir()
    packed = zstandard.ZstdCompressor().compress((tmp_path / "plain.mcap").read_bytes())
    (logs / "run.mcap.zstd").write_bytes(packed)
    (logs / "lap.txt").write_text("t,vx\n" + "".join(f"{0.01 * n:.2f},10.0\n" for n in range(50)))
    (logs / "README.txt").write_text("Car 7 on 2 sets of tyres.\nWind from the left.\n")
    assert [s.place for s in find_sources([logs])] == ["lap.txt", "run.mcap.zstd"]
    assert skipped_files([logs]) == {".txt": 1}
    support.check_planted(open_recording(logs / "run.mcap.zstd"), planted, ("header", "log", "publish"))
    with pytest.raises(SystemExit, match="0"):
        main(["ingest", str(logs), "--list"])
    shown = capsys.readouterr().out
    assert "lap.txt: 2 channels" in shown and "run.mcap.zstd: " in shown and "README" not in shown


def test_a_damaged_manifest_says_what_to_do(archive, tmp_path):
    ingest_logs([archive], tmp_path / "drives")
    (tmp_path / "drives" / MANIFEST_NAME).write_text("{")
    with pytest.raises(SplitError, match="Remove it to ingest all again"):
        ingest_logs([archive], tmp_path / "drives")


def test_packed_logs_of_another_file_system_are_found_by_name(tmp_path):
    """What an archive holds would have to be looked at: it has to be named."""
    (tmp_path / "logs").mkdir()
    for name in ("a.csv.gz", "b.mcap.zst", "notes.md.gz", "c.zip"):
        (tmp_path / "logs" / name).write_text("")
    fsspec.filesystem("memory").put(str(tmp_path / "logs"), "/packed", recursive=True)
    assert [source.place for source in find_sources(["memory://packed"])] == ["a.csv.gz", "b.mcap.zst"]
    assert skipped_files(["memory://packed"]) == {".gz": 1, ".zip": 1}
    assert [source.place for source in find_sources(["memory://packed/c.zip"])] == ["c.zip"]


def test_memory_is_a_file_system_too(logs, tmp_path):
    system = fsspec.filesystem("memory")
    system.put(str(logs), "/archive", recursive=True)
    # A Path makes one slash of two; the address is understood all the same.
    run = ingest_logs([Path("memory://archive")], tmp_path / "drives")
    assert len(run.results) == 3
    ingest_logs([logs], tmp_path / "local")
    assert contents(tmp_path / "drives") == contents(tmp_path / "local")
    assert len(ingest_logs(["memory://archive"], tmp_path / "drives").unchanged) == 3
    system.pipe_file("/archive/a.csv", system.cat_file("/archive/monday/b.csv"))
    assert [r.log for r in ingest_logs(["memory://archive"], tmp_path / "drives").results] == ["a.csv"]
    with pytest.raises(SplitError, match=r"nowhere/x\.csv: does not exist"):
        ingest_logs(["memory://nowhere/x.csv"], tmp_path / "more")


@pytest.fixture
def bucket(logs, monkeypatch) -> Iterator[Any]:
    """A file system of an S3 server on this machine, with the logs in the bucket ``laps``."""
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    try:
        host, port = server.get_host_and_port()
        for name, value in {
            "AWS_ACCESS_KEY_ID": "test",
            "AWS_SECRET_ACCESS_KEY": "test",
            "AWS_DEFAULT_REGION": "us-east-1",
            "AWS_ENDPOINT_URL": f"http://{host}:{port}",
            "FSSPEC_S3_ENDPOINT_URL": f"http://{host}:{port}",
        }.items():
            monkeypatch.setenv(name, value)
        fsspec.config.set_conf_env(fsspec.config.conf)
        system = fsspec.filesystem("s3", skip_instance_cache=True)
        if system.exists("laps"):  # servers of one process share their buckets
            system.rm("laps", recursive=True)
        system.mkdir("laps")
        system.put(str(logs / "a.csv"), "laps/a.csv")
        system.put(str(logs / "monday"), "laps/monday", recursive=True)
        yield system
    finally:
        server.stop()
        fsspec.config.conf.pop("s3", None)


def test_a_bucket_of_an_s3_server(bucket, logs, tmp_path):
    run = ingest_logs(["s3://laps"], tmp_path / "drives")
    assert len(run.results) == 3
    bucket.put(str(logs / "monday" / "b.csv"), "laps/a.csv")
    fsspec.filesystem("s3").invalidate_cache()
    again = ingest_logs(["s3://laps"], tmp_path / "drives")
    assert [r.log for r in again.results] == ["a.csv"] and len(again.unchanged) == 2


@pytest.mark.parametrize("place", ["folder", "bucket"])
def test_drives_and_sets_are_the_same_bit_for_bit_on_every_engine(logs, tmp_path, place, request):
    """A folder with two processes; a bucket with two workers of Dask, who read it, beside the folder."""
    source, engine_name = logs, "process"
    if place == "bucket":
        system, source, engine_name = request.getfixturevalue("bucket"), "s3://laps", "dask"
    ingest_logs([source], tmp_path / "one")
    with open_engine(engine_name, jobs=2) as engine:
        assert engine.workers == 2
        run = ingest_logs([source], tmp_path / "many", engine=engine, keep_going=True)
        assert len(run.results) == 3
        if place == "bucket":
            system.put(str(tmp_path / "many"), "laps/drives", recursive=True)
            fsspec.filesystem("s3").invalidate_cache()
            train_set(["s3://laps/drives"], CAR, tmp_path / "many.split", engine=engine)
            train_set([tmp_path / "one"], CAR, tmp_path / "one.split")
            assert (tmp_path / "one.split").read_bytes() == (tmp_path / "many.split").read_bytes()
            ingest_logs([logs], tmp_path / "local")
            assert contents(tmp_path / "one") == contents(tmp_path / "local")
    assert contents(tmp_path / "one") == contents(tmp_path / "many")
    stored = [json.loads((tmp_path / f / MANIFEST_NAME).read_text()) for f in ("one", "many")]
    assert stored[0] == stored[1]


def test_a_scheduler_that_is_not_there_is_told():
    with (
        pytest.raises(SplitError, match="no Dask scheduler with workers answers"),
        open_engine("dask", scheduler="tcp://127.0.0.1:1"),
    ):
        pass
    with pytest.raises(SplitError, match="needs `--engine dask`"), open_engine(scheduler="tcp://127.0.0.1:1"):
        pass


def test_with_keep_going_the_command_lists_bad_logs_at_the_end_and_in_its_exit_code(archive, tmp_path, capsys):
    (archive / "bad.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(50))
    (archive / "monday" / "empty.csv").write_text("t,vx\n")
    words = ["ingest", str(archive), "-o", str(tmp_path / "drives"), "--jobs", "1"]
    with pytest.raises(SystemExit) as stopped:
        main(words)
    assert stopped.value.code == 1
    assert not (tmp_path / "drives").exists()
    capsys.readouterr()
    with pytest.raises(SystemExit) as stopped:
        main([*words, "--keep-going"])
    assert stopped.value.code == 1
    assert len(contents(tmp_path / "drives")) == 3
    *_, count, first, second = capsys.readouterr().err.splitlines()
    assert "2 of 5 logs gave no drive" in count
    assert first.startswith("split: bad.mcap: ") and second.startswith("split: monday/empty.csv: ")
