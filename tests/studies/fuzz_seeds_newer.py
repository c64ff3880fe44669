"""Valid files of the kinds that came last: rows, blocks, tables of frames, long columns in pieces.

Used by `tests.studies.fuzz_seeds`.
"""

import json
import shutil
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from unittest.mock import patch

import numpy as np

from split_cli.files import sha256_of_file
from split_cli.logs import scratch
from split_cli.logs.readers import can as can_reader
from split_cli.logs.readers import open_recording
from split_cli.logs.readers.together import open_together
from split_cli.workflows.info import describe_file
from split_cli.workflows.ingesting.ingest_manifest import MANIFEST_NAME, IngestManifest
from split_cli.workflows.verifying.verify import verify
from tests.logs import readers_support as support
from tests.logs.test_readers_third_party import DBC

GOLDEN = Path(__file__).parents[1] / "golden" / "files"
LONG_HERE = 16
"""Values from which on a column is kept in a file [1]: so that the short ones of these files are."""

NEWER = (
    "json rows", "json list", "json columns", "pi toolbox", "pi toolbox block", "csv etas", "csv labview",
    "csv spreadsheet", "together", "mat carmaker", "mat motec 7.3", "can savvycan", "can cabana",
    "mcap ros2 in pieces", "mcap json in pieces", "bag in pieces", "db3 in pieces", "mat 5 in pieces",
    "mat 7.3 in pieces", "csv in pieces", "can asc in pieces", "json rows in pieces", "verify drive",
    "verify labels", "verify set", "verify vehicle", "verify map", "verify diagnosis", "json channels",
    "named csv", "named json", "set of the past", "info diagnosis", "info export", "verify manifest",
    "verify document", "verify answers", "verify drives",
)  # fmt: skip
"""The kinds of this module."""

Kind = tuple[str, Path, Callable[[Path], object]]


def read_recording(path: Path) -> bool:
    """Open a recording and read every channel; tell whether anything was dropped."""
    recording = open_recording(path)
    recording.read([info.name for info in recording.channels()][:200])
    return bool(recording.notes)


def rows(folder: Path, planted: support.Planted) -> Iterator[Kind]:
    """JSON in its three forms, and Pi Toolbox in its two."""
    count = len(planted.vx)
    made = [
        {
            "stamp": {"sec": 1_700_000_000 + k, "nanosec": 500},
            "imu": {"r": planted.r[k]},
            "v": [planted.vx[k], 0.5],
        }
        for k in range(count)
    ]
    lines = folder / "rows.jsonl"
    lines.write_text("".join(json.dumps(row) + "\n" for row in made))
    yield "json rows", lines, read_recording
    listed = folder / "list.json"
    listed.write_text(json.dumps({"car": "A7", "samples": made}, indent=1))
    yield "json list", listed, read_recording
    columns = folder / "columns.json"
    times = [f"2026-05-02T10:00:{0.3 * k:09.6f}Z" for k in range(2 * count)]
    columns.write_text(json.dumps({"time": times, "vx [km/h]": [*planted.vx, *planted.vy]}))
    yield "json columns", columns, read_recording
    channels = folder / "channels.json"
    told = [
        {"name": name, "unit": unit, "frequency": 50, "data": [*values]}
        for name, unit, values in (("vx", "km/h", planted.vx), ("r", "deg/s", planted.r))
    ]
    channels.write_text(json.dumps({"session": "FP1", "channels": told}))
    yield "json channels", channels, read_recording
    named = [(0.01 * k, name, v) for k in range(count) for name, v in (("vx", planted.vx[k]), ("r", planted.r[k]))]
    table = folder / "named.csv"
    table.write_text("timestamp,signal,value\n" + "".join(f"{t:.2f},{name},{v}\n" for t, name, v in named))
    yield "named csv", table, read_recording
    traced = folder / "named.json"
    traced.write_text("".join(json.dumps({"name": n, "value": v, "timestamp": t}) + "\n" for t, n, v in named))
    yield "named json", traced, read_recording
    head = "PiToolboxVersionedASCIIDataSet\nVersion\t2\n\n{OutingInformation}\nCarName\tCar 7\n\n"
    blocks = {
        title: "{ChannelBlock}\n"
        + f"Time\t{title}\n"
        + "".join(f"{0.01 * k:.3f}\t{v}\n" for k, v in enumerate(values))
        for title, values in {"Speed[kph]": planted.vx, "YawRate[deg/s]": planted.r}.items()
    }
    exported = folder / "outing.txt"
    exported.write_text(head + "\n".join(blocks.values()))
    yield "pi toolbox", exported, read_recording
    alone = folder / "block.txt"
    alone.write_text(head + blocks["Speed[kph]"])
    yield "pi toolbox block", alone, read_recording


def tables(folder: Path, planted: support.Planted) -> Iterator[Kind]:
    """Exports of ETAS, LabVIEW, CarMaker and spreadsheets, and two tables that belong together."""
    etas = folder / "etas.ascii"
    values = "".join(f"{0.01 * k}\t{k}\t1.5\t2\n" for k in range(40))
    units = 'f8\tf8\tf8\tf8\n"s"\t"km/h"\t"deg/s"\t"-"\n'
    etas.write_text(f"ETASAsciiItemFile\trecord\tCrLf\tTab\nsampleCount\t40\ntime\tv\tr\ta\n{units}{values}")
    yield "csv etas", etas, read_recording
    labview = folder / "labview.lvm"
    head = "LabVIEW Measurement\nWriter_Version\t2\nSeparator\tTab\n***End_of_Header***\n\nChannels\t2\n"
    values = "".join(f"{0.01 * k:.6f}\t{v:.6f}\t{k}\n" for k, v in enumerate(planted.vx))
    labview.write_text(f"{head}***End_of_Header***\nX_Value\tvx [m/s]\tax [m/s^2]\n{values}")
    yield "csv labview", labview, read_recording
    grouped = folder / "grouped.csv"
    cells = ["999,5", "1.000,25", "-12.345,5", "1.234.567,0"] * 10
    clock = [f"14:00:{0.5 * k:06.3f}".replace(".", ",") for k in range(40)]
    values = "".join(f"{c};{t};1\n" for c, t in zip(clock, cells, strict=True))
    grouped.write_text(f"Uhrzeit;T;Modus\nhh:mm:ss,000;N-m;-\n{values}")
    yield "csv spreadsheet", grouped, read_recording
    first, second = folder / "speed.csv", folder / "rate.csv"
    for path, column in ((first, planted.vx), (second, planted.r)):
        path.write_text("time,value\n" + "".join(f"{0.01 * k:.2f},{v}\n" for k, v in enumerate(column)))

    def joined(path: Path) -> bool:
        recording = open_together([open_recording(path), open_recording(second)])
        recording.read([info.name for info in recording.channels()])
        return bool(recording.notes)

    yield "together", first, joined
    from scipy.io import savemat

    fields = {"Time": (np.arange(40.0), "s"), "Car_vx": (planted.vx, "km/h"), "Car_YawRate": (planted.r, "deg/s")}
    savemat(folder / "erg.mat", {name: {"data": v[None, :], "unit": unit} for name, (v, unit) in fields.items()})
    yield "mat carmaker", folder / "erg.mat", read_recording
    import h5py

    with h5py.File(folder / "motec.mat", "w") as file:
        for name, (values, unit) in fields.items():
            group = file.create_group(name)
            group["Time"], group["Value"] = np.arange(40.0)[None], values[None]
            group["Units"] = np.array([[ord(letter)] for letter in unit], dtype=np.uint16)
            group["Units"].attrs["MATLAB_class"] = np.bytes_("char")
    yield "mat motec 7.3", folder / "motec.mat", read_recording


def frames(folder: Path) -> Iterator[Kind]:
    """Tables of CAN frames, with a database."""
    if not (find_spec("can") and find_spec("cantools")):
        return
    import cantools

    known = folder / "tables.dbc"
    known.write_text(DBC)
    database = cantools.database.load_file(str(known))
    payloads = [database.encode_message("Motion", {"YawRate": 0.02 * k, "LatAcc": 1.0}) for k in range(40)]

    def read(path: Path) -> bool:
        # The database is a sound one: it is not read again in a process of its own for each log.
        with patch.object(can_reader, "read_databases", lambda paths: database):
            recording = open_recording(path, message_paths=[known])
        recording.read([info.name for info in recording.channels()])
        return bool(recording.notes)

    titles = "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
    savvy = folder / "savvycan.csv"
    savvy.write_text(
        titles
        + "".join(
            f"{10_000 * k},00000101,false,Rx,0,{len(data)},{','.join(f'{byte:02X}' for byte in data)},\n"
            for k, data in enumerate(payloads)
        )
    )
    yield "can savvycan", savvy, read
    cabana = folder / "cabana.csv"
    cabana.write_text(
        "time,addr,bus,data\n" + "".join(f"{0.01 * k},0x101,0,0x{d.hex()}\n" for k, d in enumerate(payloads))
    )
    yield "can cabana", cabana, read


def in_pieces(kinds: dict[str, tuple[Path, Callable[[Path], object]]], folder: Path) -> Iterator[Kind]:
    """The same files as of other kinds, with their columns in files, as those of a long recording are."""

    def long(read: Callable[[Path], object]) -> Callable[[Path], object]:
        def reads(path: Path) -> object:
            with patch.object(scratch, "LONG", LONG_HERE):
                return read(path)

        return reads

    (folder / "pieces").mkdir(exist_ok=True)
    for kind in ("mcap ros2", "mcap json", "bag", "db3", "mat 5", "mat 7.3", "csv", "can asc", "json rows"):
        if kind in kinds:
            path, read = kinds[kind]
            copy = Path(shutil.copy(path, folder / "pieces" / path.name))
            yield f"{kind} in pieces", copy, long(read)


def ours_verified(folder: Path) -> Iterator[Kind]:
    """What `split verify` is given."""
    kept = folder / "verified"
    shutil.copytree(GOLDEN, kept, dirs_exist_ok=True)
    for kind, name in {
        "drive": "drive-1.parquet",
        "labels": "labels-1.parquet",
        "set": "set-2.split",
        "vehicle": "vehicle-1.yaml",
        "map": "map-1.yaml",
        "diagnosis": "diagnosis-1/diagnosis.json",
    }.items():
        yield f"verify {kind}", kept / name, lambda path: verify(path) and False
    yield "info diagnosis", Path(shutil.copytree(kept / "diagnosis-1", folder / "told")) / "diagnosis.json", told
    exported = Path(shutil.copytree(kept / "export-1", folder / "exported"))
    yield "info export", exported / "manifest.json", told
    for kind, name in {"manifest": "manifest", "document": "set_2", "answers": "set_2_check"}.items():
        copy = Path(shutil.copytree(kept / "export-1", folder / f"export {kind}"))
        yield f"verify {kind}", copy / f"{name}.json", verify_export
    drives = folder / "drives"
    drives.mkdir()
    manifest = IngestManifest(drives / MANIFEST_NAME)
    manifest.add("lap.csv", "0" * 64, "0", "drive-1.parquet", Path(shutil.copy(kept / "drive-1.parquet", drives)))
    manifest.write()
    yield "verify drives", manifest.path, lambda path: verify(path) and False


def told(path: Path) -> bool:
    """Describe a file as `split info` does."""
    return describe_file(path) and False


def verify_export(path: Path) -> bool:
    """Verify the export in which a file lies, with a manifest that has the file's digest."""
    manifest = path.parent / "manifest.json"
    if path != manifest:
        content = json.loads(manifest.read_text())
        content["files"][path.name] = sha256_of_file(path)
        manifest.write_text(json.dumps(content))
    return verify(path.parent) and False
