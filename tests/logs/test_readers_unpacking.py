"""Compressed files and archives: what was packed comes back under the user's name; damage and tricks are refused."""

import binascii
import bz2
import gzip
import io
import json
import lzma
import re
import struct
import tarfile
import tempfile
import zipfile

import numpy as np
import pytest
import zstandard
from scipy.io import savemat

import tests.logs.readers_support as support
from split_cli.cli.main import main
from split_cli.errors import LogError, SplitError
from split_cli.files import sha256_of_file
from split_cli.logs.drive import read_drive
from split_cli.logs.raw import NO_CHECKSUMS
from split_cli.logs.readers.opening import open_parts, open_recording
from split_cli.workflows.ingesting.ingest import ingest_logs, open_logs, suggest_map_for
from split_cli.workflows.ingesting.init import init_project
from split_cli.workflows.sources import find_sources, skipped_files
from tests.logs.test_readers_motec_ld import lap, written

PACKERS = {
    ".gz": gzip.compress,
    ".bz2": bz2.compress,
    ".xz": lzma.compress,
    ".zst": zstandard.ZstdCompressor().compress,
    ".zstd": zstandard.ZstdCompressor().compress,
}
NAMES = ("vx", "vy", "r", "T", "delta")


@pytest.fixture(scope="module")
def table():
    """Return a drive's channels as CSV."""
    t = np.arange(0.0, 20.0, 0.02)
    speed, rate = 20.0 + 5.0 * np.sin(0.3 * t), 0.3 * np.sin(0.7 * t)
    columns = {"t": t, "vx": speed, "vy": 0.1 * rate, "r": rate, "T": 800.0 * np.cos(0.3 * t), "delta": 0.1 * rate}
    rows = "\n".join(",".join(f"{value:.9g}" for value in row) for row in zip(*columns.values(), strict=True))
    return (",".join(columns) + "\n" + rows + "\n").encode()


@pytest.fixture
def scratch(tmp_path, monkeypatch):
    """Return the folder for temporary files, of this test alone."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def zipped(path, members, method=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def channels_of(path):
    recording = open_recording(path)
    found = recording.read([info.name for info in recording.channels()])
    return {name: signal.values for name, signal in found.items()}


@pytest.mark.parametrize("ending", PACKERS)
def test_a_packed_table_is_the_table(table, ending, tmp_path):
    (tmp_path / "lap.csv").write_bytes(table)
    path = tmp_path / f"lap.csv{ending}"
    path.write_bytes(PACKERS[ending](table))
    recording = open_recording(path)
    assert (recording.name, recording.path) == (path.name, path)
    plain, packed = channels_of(tmp_path / "lap.csv"), channels_of(path)
    assert plain.keys() == packed.keys()
    for name, values in plain.items():
        np.testing.assert_array_equal(packed[name], values)


def test_what_is_packed_may_be_of_any_format_and_name(tmp_path):
    planted = support.plant(count=40)
    content = support.write_ros2_mcap(tmp_path / "plain.mcap", planted).read_bytes()
    for name in ("a.mcap.gz", "a.mcap.xz", "no_ending"):
        (tmp_path / name).write_bytes(PACKERS[".xz" if name.endswith("xz") else ".gz"](content))
        support.check_planted(open_recording(tmp_path / name), planted)
    savemat(tmp_path / "lap.mat", {"t": np.arange(40.0), "vx": planted.vx})
    (tmp_path / "lap.mat.bz2").write_bytes(bz2.compress((tmp_path / "lap.mat").read_bytes()))
    np.testing.assert_array_equal(channels_of(tmp_path / "lap.mat.bz2")["vx"], planted.vx)
    (tmp_path / "run.ld.gz").write_bytes(gzip.compress(written(tmp_path / "run.ld", lap(5.0))))
    assert channels_of(tmp_path / "run.ld.gz").keys() == channels_of(tmp_path / "run.ld").keys()


@pytest.mark.parametrize("ending", [".gz", ".bz2", ".xz", ".zst"])
def test_several_streams_in_one_file_are_one_content(table, ending, tmp_path):
    """As parallel packers write it, and `cat` of two files."""
    pack, cut = PACKERS[ending], len(table) // 3
    (tmp_path / f"lap.csv{ending}").write_bytes(pack(table[:cut]) + pack(table[cut:]))
    (tmp_path / "lap.csv").write_bytes(table)
    assert len(channels_of(tmp_path / f"lap.csv{ending}")["vx"]) == len(channels_of(tmp_path / "lap.csv")["vx"])


def test_a_drive_is_made_of_the_file_that_the_user_named(table, tmp_path, scratch):
    """Its digest, its name in a folder, and the words on checksums are of the packed file."""
    (tmp_path / "logs").mkdir()
    path = tmp_path / "logs" / "lap.csv.gz"
    path.write_bytes(gzip.compress(table))
    ingest_logs([tmp_path / "logs"], tmp_path / "drives")
    drive = read_drive(tmp_path / "drives" / "lap.parquet")
    (source,) = drive.metadata.sources
    assert (source.name, source.sha256) == ("lap.csv.gz", sha256_of_file(path))
    assert NO_CHECKSUMS not in json.dumps(drive.metadata.quality)
    assert ingest_logs([tmp_path / "logs"], tmp_path / "drives").unchanged == ("lap.csv.gz",)
    assert list(scratch.iterdir()) == []


@pytest.mark.parametrize("ending", [".gz", ".bz2", ".xz", ".zst"])
def test_a_cut_or_changed_file_is_one_error_and_leaves_nothing(table, ending, tmp_path, scratch):
    whole = PACKERS[ending](table)
    changed = bytearray(whole)
    changed[len(whole) // 2] ^= 0x40
    for content in (whole[: len(whole) // 2], whole[:40] if ending == ".zst" else bytes(changed)):
        (tmp_path / f"lap.csv{ending}").write_bytes(content)
        with pytest.raises(LogError, match=rf"lap\.csv\{ending}: cannot be unpacked") as caught:
            open_recording(tmp_path / f"lap.csv{ending}")
        del caught
    assert list(scratch.iterdir()) == []


def test_an_error_within_names_the_packed_file(tmp_path, scratch):
    (tmp_path / "letter.csv.gz").write_bytes(gzip.compress(b"Dear reader,\nno numbers here.\n" * 9))
    with pytest.raises(LogError) as caught:
        open_recording(tmp_path / "letter.csv.gz")
    assert str(caught.value).startswith("letter.csv.gz: ") and str(scratch) not in str(caught.value)
    zipped(tmp_path / "a.zip", {"letter.csv": "no numbers here\n" * 9})
    with pytest.raises(LogError, match=r"^a\.zip/letter\.csv: "):
        open_recording(tmp_path / "a.zip")


def test_what_is_packed_twice_is_refused(table, tmp_path):
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress(gzip.compress(table)))
    zipped(tmp_path / "b.csv", {"a.csv": table})
    (tmp_path / "b.csv.gz").write_bytes(gzip.compress((tmp_path / "b.csv").read_bytes()))
    zipped(tmp_path / "c.zip", {"a.csv.gz": gzip.compress(table)})
    # An archive may hold itself.
    zipped(tmp_path / "d.zip", {"inner.zip": (tmp_path / "b.csv").read_bytes()})
    for name in ("a.csv.gz", "b.csv.gz", "c.zip", "d.zip"):
        with pytest.raises(LogError, match="is packed twice"):
            open_recording(tmp_path / name)


def test_memory_that_a_header_asks_for_is_not_given(table, tmp_path):
    """The dictionary of xz may be 4 GB by its header."""
    content = bytearray(lzma.compress(table))
    size = 4 * (content[12] + 1)
    block = content[12 : 12 + size]
    place = block.index(b"\x21\x01") + 2
    block[place] = 40
    block[-4:] = struct.pack("<I", binascii.crc32(bytes(block[:-4])))
    content[12 : 12 + size] = block
    (tmp_path / "a.csv.xz").write_bytes(content)
    with pytest.raises(LogError, match="cannot be unpacked.*[Mm]emory"):
        open_recording(tmp_path / "a.csv.xz")


def test_an_archive_with_one_recording_is_that_recording(table, tmp_path):
    (tmp_path / "lap.csv").write_bytes(table)
    extra = {"README.txt": "Car 7, wind from the left.\n", "__MACOSX/._lap.csv": b"\0\1", "setup.json": "{}"}
    path = zipped(tmp_path / "session.zip", {"day/lap.csv": table, **extra})
    recording = open_recording(path)
    assert (recording.name, recording.path) == ("session.zip", path)
    np.testing.assert_array_equal(channels_of(path)["vx"], channels_of(tmp_path / "lap.csv")["vx"])
    zipped(tmp_path / "odd.zip", {"telemetry": table})
    assert channels_of(tmp_path / "odd.zip").keys() == channels_of(path).keys()


def test_an_archive_with_several_lists_them_and_says_how_to_choose(table, tmp_path):
    path = zipped(tmp_path / "laps.zip", {f"lap_{k}.csv": table for k in range(7)})
    with pytest.raises(LogError) as caught:
        open_recording(path)
    text = str(caught.value)
    assert "laps.zip: holds 7 recordings: lap_0.csv, lap_1.csv" in text and "and 2 more" in text
    assert "--together" in text and "unpack it" in text


@pytest.fixture
def parts(table):
    """Return the channels of a drive in two tables, each with the clock."""
    lines = [line.split(",") for line in table.decode().splitlines()]
    return {
        "motion.csv": "\n".join(",".join(line[:4]) for line in lines),
        "inputs.csv": "\n".join(",".join((line[0], *line[4:])) for line in lines),
    }


def test_the_files_of_an_archive_are_one_drive_together(parts, table, tmp_path, scratch):
    (tmp_path / "map.yaml").write_text("channels: {" + ", ".join(f"{n}: {{source: {n}}}" for n in NAMES) + "}\n")
    path = zipped(tmp_path / "drive.zip", parts)
    for logs, output in (([path], "of_archive"), ([tmp_path / "folder"], "of_folder")):
        (tmp_path / "folder").mkdir(exist_ok=True)
        for name, text in parts.items():
            (tmp_path / "folder" / name).write_text(text)
        ingest_logs(logs, tmp_path / f"{output}.parquet", maps=[tmp_path / "map.yaml"], together=True)
    one, other = (read_drive(tmp_path / f"{name}.parquet") for name in ("of_archive", "of_folder"))
    for name in NAMES:
        np.testing.assert_array_equal(one[name], other[name])
    assert [(s.name, s.sha256) for s in one.metadata.sources] == [("drive.zip", sha256_of_file(path))]
    assert list(scratch.iterdir()) == []
    assert {part.name for part in open_parts(path)} == {"motion.csv", "inputs.csv"}


def test_an_archive_of_a_rosbag2_folder_is_that_recording(tmp_path):
    planted = support.plant(count=40)
    bag = support.write_rosbag2(tmp_path / "bag", planted, "SQLITE3")
    zipped(tmp_path / "bag.zip", {f"bag/{file.name}": file.read_bytes() for file in bag.iterdir()})
    support.check_planted(open_recording(tmp_path / "bag.zip"), planted, ("header", "log"))


def test_names_that_lead_outside_are_not_followed(table, tmp_path, scratch):
    members = {"../outside.csv": table, "/tmp/absolute.csv": table, "a\\b.csv": table, ".hidden.csv": table}
    before = {file for file in tmp_path.rglob("*") if file.is_file()}
    path = zipped(tmp_path / "a.zip", members)
    with pytest.raises(LogError, match="archive without a recording"):
        open_recording(path)
    assert {file for file in tmp_path.rglob("*") if file.is_file()} == before | {path}


def test_archives_that_cannot_be_read_are_one_error(table, tmp_path, scratch):
    sound = zipped(tmp_path / "sound.zip", {"lap.csv": table}).read_bytes()
    damaged = bytearray(sound)
    damaged[len(sound) // 2] ^= 0x40
    encrypted, other = bytearray(sound), bytearray(sound)
    central = sound.index(b"PK\x01\x02")
    for place in (6, central + 8):
        encrypted[place] |= 1
    for place in (8, central + 10):
        other[place : place + 2] = struct.pack("<H", 14)  # xz's method, whose memory no header bounds
    empty = b"PK\x05\x06".ljust(22, b"\0")
    for name, content, said in (
        ("cut.zip", sound[: len(sound) // 2], "cannot be unpacked"),
        ("damaged.zip", bytes(damaged), "cannot be unpacked"),
        ("encrypted.zip", bytes(encrypted), "is encrypted"),
        ("other.zip", bytes(other), "in a way that is not read"),
        ("empty.zip", empty, "an archive without a recording|no known format"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(LogError, match=said):
            open_recording(tmp_path / name)
    zipped(tmp_path / "many.zip", {f"{k}.csv": b"" for k in range(2001)}, zipfile.ZIP_STORED)
    with pytest.raises(LogError, match="more than 2,000 files"):
        open_recording(tmp_path / "many.zip")
    listed = bytearray((tmp_path / "many.zip").read_bytes())
    listed[-10:-6] = struct.pack("<I", 5 << 20)  # as of 70,000 files, which would take seconds to list
    (tmp_path / "many.zip").write_bytes(listed)
    for use in (open_recording, open_parts):
        with pytest.raises(LogError, match="lists more files than any recording"):
            use(tmp_path / "many.zip")
    assert skipped_files([tmp_path])[".zip"] >= 1
    assert list(scratch.iterdir()) == []


def test_archives_of_other_kinds_are_named(table, tmp_path):
    content = io.BytesIO()
    with tarfile.open(fileobj=content, mode="w") as archive:
        member = tarfile.TarInfo("lap.csv")
        member.size = len(table)
        archive.addfile(member, io.BytesIO(table))
    for name, packed, said in (
        ("lap.tar", content.getvalue(), "tar archive, which is not read. Unpack it with `tar -xf`"),
        ("lap.tar.gz", gzip.compress(content.getvalue()), "^lap.tar.gz: is a tar archive"),
        ("lap.7z", b"7z\xbc\xaf\x27\x1c" + bytes(40), "pack it as .zip"),
        ("lap.csv.lz4", b"\x04\x22\x4d\x18" + bytes(40), "lz4 -d"),
    ):
        (tmp_path / name).write_bytes(packed)
        with pytest.raises(LogError, match=said):
            open_recording(tmp_path / name)


def test_a_folder_is_searched_for_packed_recordings_and_archives_of_them(table, tmp_path):
    for name in ("a.csv.gz", "b.MCAP.ZST", "c.mat.xz", "pictures.tar.gz", "notes.md.gz", "d.gz"):
        (tmp_path / name).write_bytes(b"")
    zipped(tmp_path / "e.zip", {"lap.csv": table})
    zipped(tmp_path / "pictures.zip", {"a.png": b"\x89PNG"})
    assert [source.place for source in find_sources([tmp_path])] == ["a.csv.gz", "b.MCAP.ZST", "c.mat.xz", "e.zip"]
    assert skipped_files([tmp_path]) == {".gz": 3, ".zip": 1}
    with pytest.raises(SplitError, match="holds no drive"):
        find_sources([tmp_path], (".parquet", ".pq", ".csv"), what="drive")


def test_first_contact_with_a_packed_log_prints_what_works(table, tmp_path, capsys):
    """What `split init` prints takes the packed file again, and names the drive after the log."""
    path = tmp_path / "lap.csv.xz"
    path.write_bytes(lzma.compress(table))
    result = init_project([path], tmp_path / "car")
    step = next(step for step in result.next_steps if "split ingest" in step)
    assert f"split ingest {path}" in step and re.search(r"-o lap\.parquet", step)
    assert "vx: {source: vx" in suggest_map_for(path)
    for command in (["info", str(path), "--json"], ["ingest", str(path), "--list", "--json"]):
        with pytest.raises(SystemExit, match="0"):
            main(command)
        assert json.loads(capsys.readouterr().out) and "vx" in str(open_logs(path).channels())
