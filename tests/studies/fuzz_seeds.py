"""One small valid file of every kind that is read from others, and its reader: what the fuzz mutates.

Used by `tests.studies.fuzz`.
"""

import json
import shutil
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from split_cli.control.centerline import read_centerline
from split_cli.files import sha256_of_file
from split_cli.learning.features import parse_features
from split_cli.learning.kernel_file import read_kernel
from split_cli.learning.label_file import read_labels
from split_cli.learning.training_set import read_set, write_set
from split_cli.logs import scratch
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.drive import read_drive, write_drive
from split_cli.logs.presets import preset_path
from split_cli.logs.readers import can as can_reader
from split_cli.logs.readers import open_recording
from split_cli.logs.readers.joint import JointRecording
from split_cli.logs.readers.opening import open_parts
from split_cli.logs.signal_map import read_map
from split_cli.vehicle.parameters import EffectSpec, read_vehicle, write_vehicle
from split_cli.workflows.info import describe_file
from split_cli.workflows.ingesting.ingest_manifest import MANIFEST_NAME, IngestManifest
from split_cli.workflows.verifying.verify import verify
from tests.factories import make_drive, make_training_set, road_car
from tests.logs import readers_support as support
from tests.logs import test_readers_apart, test_readers_carmaker_erg, test_readers_motec_ld, test_readers_unpacking
from tests.logs.test_readers_third_party import DBC, VBO

GOLDEN = Path(__file__).parents[1] / "golden" / "files"
SLOW = {"mf4": 0.01, "mf4 bus": 0.005, "dbc": 0.01, "feather": 0.02, "draft": 0.1}
SLOW |= dict.fromkeys(("xrk", "ulog", "tdms"), 0.02)
"""Inputs of a kind against those of the others [1]: what a library reads in a process of its own takes 1 to 2 s each,
and a draft looks at every column in many ways."""
QUICK = dict.fromkeys(
    ("vbo", "mat 5", "mat 5 structure", "mat 4", "vehicle", "hyperparameters", "trained set", "centre line"), 20.0
)
"""The same of kinds that are read in less than a millisecond: with `--quick` they get most inputs."""
LONG_HERE = 16
"""Values from which on a column is kept in a file [1]: so that the short ones of these files are."""

NEWER = tuple(
    kind.strip()
    for kind in """
        json rows, json list, json columns, pi toolbox, pi toolbox block, csv etas, csv labview,
        csv spreadsheet, together, mat carmaker, mat motec 7.3, can savvycan, can cabana, mcap ros2 in pieces,
        mcap json in pieces, bag in pieces, db3 in pieces, mat 5 in pieces, mat 7.3 in pieces, csv in pieces,
        can asc in pieces, json rows in pieces, verify drive, verify labels, verify set, verify vehicle,
        verify map, verify diagnosis, json channels, named csv, named json, set of the past, info diagnosis,
        info export, verify manifest, verify document, verify answers, verify drives, motec ld, packed gz, packed bz2,
        packed xz, packed zst, zip, zip together, erg, erg info, xrk, ulog, tdms
    """.split(",")
)
"""Kinds that came last, of which `--newer` takes all inputs."""

Kind = tuple[str, Path, Callable[[Path], object]]


def seeds(folder: Path) -> dict[str, tuple[Path, Callable[[Path], object]]]:
    """Write one small valid file of every kind; return each with the function that reads it."""
    planted = support.plant(40)
    makers = (_messages, _text, _columns, _matlab_and_mdf, _can, rows, tables, _ours)
    kinds = {name: (path, read) for make in makers for name, path, read in make(folder, planted)}
    more = (
        frames(folder),
        packed(folder, planted),
        read_apart(folder, planted),
        in_pieces(kinds, folder),
        ours_verified(folder),
    )
    return kinds | {name: (path, read) for made in more for name, path, read in made}


def _drafted(path: Path) -> bool:
    draft_map(open_recording(path))
    return False


def _silently(read: Callable[[Path], object]) -> Callable[[Path], object]:
    return lambda path: read(path) and False


def _messages(folder: Path, planted: support.Planted) -> Iterator[Kind]:
    none = support.CompressionType.NONE
    yield "mcap ros2", support.write_ros2_mcap(folder / "ros2.mcap", planted), read_recording
    yield "mcap ros1", support.write_ros1_mcap(folder / "ros1.mcap", planted), read_recording
    yield "mcap json", support.write_json_mcap(folder / "json.mcap", planted, lambda t: t), read_recording
    yield "mcap protobuf", support.write_protobuf_mcap(folder / "proto.mcap", planted), read_recording
    plain = support.write_ros2_mcap(folder / "plain.mcap", planted, compression=none)
    yield "mcap plain", plain, read_recording
    yield "bag", support.write_bag1(folder / "plain.bag", planted), read_recording
    yield "bag bz2", support.write_bag1(folder / "packed.bag", planted, "BZ2"), read_recording
    bag = support.write_rosbag2(folder / "rosbag2", planted, "SQLITE3")
    yield "db3", next(bag.glob("*.db3")), read_recording
    # The description of the folder, with the database beside it.
    yield "bag metadata", bag / "metadata.yaml", read_recording


def _text(folder: Path, planted: support.Planted) -> Iterator[Kind]:
    columns = (planted.vx, planted.vy, planted.r)
    rows = ["t [s],vx [m/s],vy [m/s],r [rad/s]"]
    rows += [f"{0.01 * i}," + ",".join(str(c[i]) for c in columns) for i in range(40)]
    plain = folder / "lap.csv"
    plain.write_text("\n".join(rows) + "\n")
    yield "csv", plain, read_recording
    yield "draft", plain, _drafted
    german = folder / "german.csv"
    comma = [f"{0.01 * i:.2f};{9 + i};{i}".replace(".", ",") for i in range(40)]
    german.write_text("Zeit [s];v [km/h];Radlenkwinkel [°]\n" + "\n".join(comma) + "\n", encoding="latin-1")
    yield "csv decimal comma", german, read_recording
    chinese = folder / "chinese.csv"
    rows = [f"{0.01 * i:.2f},{30 + i},{i % 7},{-i}" for i in range(40)]
    titles = "时间(s),车速(km/h),横摆角速度(deg/s),方向盘转角(deg)\n"
    chinese.write_text(titles + "\n".join(rows) + "\n", encoding="gb18030")
    yield "csv gb18030", chinese, read_recording
    chrono = folder / "racechrono.csv"
    preamble = 'This file is created using RaceChrono Pro\nFormat,3\nSession title,"Lake"\nNote,\n\n'
    header = "timestamp,lap_number,speed,latitude,speed\nunix time,,m/s,deg,m/s\n,,100: gps,100: gps,calc\n"
    rows = [f"{1767150797 + 0.04 * k:.2f},8,{30 + k},31.07,{31 + k}" for k in range(40)]
    chrono.write_text(preamble + header + "\n".join(rows) + "\n")
    yield "csv racechrono", chrono, read_recording
    aim = folder / "aim.csv"
    names = "Time,GPS_Speed,Gear,RPM"
    head = ["Format,AIM CSV File,,", "Sample Rate,20,,", ",,,", names, names, "sec,mph,#,rpm", ",1,2,3", ",,,"]
    aim.write_text("\n".join([*head, *(f"{0.05 * i:.2f},{100 + i},4,5000" for i in range(40))]) + "\n")
    yield "csv aim", aim, read_recording
    dated = folder / "dated.csv"
    rows = [f'"14-Mar-2026 10:15:{0.5 * i:04.1f},{i},{-i}"' for i in range(40)]
    dated.write_text('"time,vx,r"\n' + "\n".join(rows) + "\n")
    yield "csv dates, quoted", dated, read_recording
    blanks = folder / "blanks.txt"
    blanks.write_text("# t vx r\n" + "".join(f"  {0.01 * i:.2f}  {i}   {-i}\n" for i in range(40)))
    yield "csv blanks", blanks, read_recording
    racelogic = folder / "lap.vbo"
    rows = [f"053 104758.{i:02d} +3608.25 -1087.02 072.00 195.27 +0.10 +1.5E-01 {i % 7}" for i in range(40)]
    racelogic.write_bytes((VBO + "\n".join(rows) + "\n").encode("latin-1"))
    yield "vbo", racelogic, read_recording


def _columns(folder: Path, planted: support.Planted) -> Iterator[Kind]:
    import pyarrow as pa
    import pyarrow.feather
    import pyarrow.parquet

    write_drive(make_drive(0, segments=2, seconds=2.0, vehicle=road_car()), folder / "lap.parquet")
    yield "parquet", folder / "lap.parquet", read_recording
    yield "drive", folder / "lap.parquet", _silently(read_drive)
    stamps = pa.array(planted.header, pa.timestamp("ns", "UTC"))
    # As pandas stores a table whose index is the clock, with a structure beside the numbers.
    described = b'{"index_columns": ["__index_level_0__"], "columns": [], "pandas_version": "2.2"}'
    columns = {
        "vx": pa.array(planted.vx),
        "pose": pa.StructArray.from_arrays([pa.array(planted.vy), pa.array(planted.r)], ["vy", "r"]),
        "__index_level_0__": stamps,
    }
    table = pa.table(columns).replace_schema_metadata({b"pandas": described})
    pa.parquet.write_table(table, folder / "pandas.parquet")
    yield "parquet pandas", folder / "pandas.parquet", read_recording
    pa.feather.write_feather(table, str(folder / "lap.feather"), compression="lz4")
    yield "feather", folder / "lap.feather", read_recording


def _matlab_and_mdf(folder: Path, planted: support.Planted) -> Iterator[Kind]:
    from scipy.io import savemat

    logged = {"t": np.arange(40.0), "log": {"vx": planted.vx, "signals": {"values": planted.vy}}}
    savemat(folder / "lap.mat", {"t": np.arange(40.0), "vx": planted.vx}, do_compression=True)
    yield "mat 5", folder / "lap.mat", read_recording
    savemat(folder / "struct.mat", logged)
    yield "mat 5 structure", folder / "struct.mat", read_recording
    savemat(folder / "lap4.mat", {"t": np.arange(40.0), "vx": planted.vx}, format="4")
    yield "mat 4", folder / "lap4.mat", read_recording
    import h5py

    with h5py.File(folder / "lap73.mat", "w") as file:
        file.create_dataset("vx", data=planted.vx, compression="gzip")
        file.create_dataset("t", data=np.arange(40.0))
    yield "mat 7.3", folder / "lap73.mat", read_recording
    if find_spec("asammdf"):
        from asammdf import MDF, Signal

        with MDF(version="4.10") as mdf:
            mdf.append([Signal(planted.vx, np.arange(40) * 0.01, name="vx", unit="m/s")])
            mdf.save(folder / "lap.mf4", overwrite=True)
        yield "mf4", folder / "lap.mf4", read_recording


def _with_database(known: Path) -> tuple[Path, Any, Callable[[Path], bool]]:
    """Write a CAN database; return it, what cantools makes of it, and what reads a log by it."""
    import cantools

    known.write_text(DBC)
    database = cantools.database.load_file(str(known))

    def read(path: Path) -> bool:
        # The database is a sound one: it is not read again in a process of its own for each log.
        with patch.object(can_reader, "read_databases", lambda paths: database):
            recording = open_recording(path, message_paths=[known])
        recording.read([info.name for info in recording.channels()][:200])
        return bool(recording.notes)

    return known, database, read


def _can(folder: Path, planted: support.Planted) -> Iterator[Kind]:
    if not (find_spec("can") and find_spec("cantools")):
        return
    import can

    known, database, read = _with_database(folder / "car.dbc")
    kinds = ("blf", "asc", "log", "trc", *(("mf4",) if find_spec("asammdf") else ()))
    for suffix in kinds:
        path = folder / f"frames.{suffix}"
        writer = can.Logger(str(path))
        for row in range(40):
            data = database.encode_message("Motion", {"YawRate": 0.02 * row, "LatAcc": 1.0})
            sent = {"timestamp": 1.7e9 + 0.01 * row, "arbitration_id": 257, "is_extended_id": False}
            writer.on_message_received(can.Message(data=data, **sent))
        writer.stop()
        if suffix == "mf4":
            yield "mf4 bus", path, lambda path: bool(open_recording(path, message_paths=[known]).notes)
        else:
            yield f"can {suffix}", path, read

    log = folder / "frames.log"
    yield "dbc", known, lambda path: bool(open_recording(log, message_paths=[path]).notes)


def _ours(folder: Path, planted: support.Planted) -> Iterator[Kind]:
    car = road_car()
    write_vehicle(car, folder / "car.yaml")
    yield "vehicle", folder / "car.yaml", _silently(read_vehicle)
    (folder / "map.yaml").write_text(preset_path("genesis_slow").read_text())
    yield "map", folder / "map.yaml", _silently(lambda path: read_map([path]))
    features = parse_features("z2")
    kernel = shutil.copy(GOLDEN / "hyperparameters-1.yaml", folder)
    yield "hyperparameters", Path(kernel), _silently(lambda path: read_kernel(path, features))
    yield "labels", Path(shutil.copy(GOLDEN / "labels-1.parquet", folder)), _silently(read_labels)
    write_set(make_training_set(points=60), folder / "a.split")
    yield "trained set", folder / "a.split", _silently(read_set)
    past = road_car().with_effects(EffectSpec("feature_lag", {"tau": 0.08}))
    write_set(make_training_set(points=60, features="z2,feature_lag", vehicle=past), folder / "past.split")
    yield "set of the past", folder / "past.split", _silently(read_set)
    angle = np.arange(0.0, 2.0 * np.pi, 0.2)
    rows = "".join(f"{40 * np.cos(a):.3f},{40 * np.sin(a):.3f},4.0,4.0\n" for a in angle)
    (folder / "track.csv").write_text("# x_m,y_m,w_tr_right_m,w_tr_left_m\n" + rows)
    yield "centre line", folder / "track.csv", _silently(read_centerline)


def read_recording(path: Path) -> bool:
    """Open a recording and read every channel; tell whether anything was dropped."""
    recording = open_recording(path)
    recording.read([info.name for info in recording.channels()][:200])
    return bool(recording.notes)


def rows(folder: Path, planted: support.Planted) -> Iterator[Kind]:
    """JSON in its three forms, and Pi Toolbox in its two."""
    count = len(planted.vx)
    made = [
        {"stamp": {"sec": 1_700_000_000 + k, "nanosec": 500}, "imu": {"r": planted.r[k]}, "v": [planted.vx[k], 0.5]}
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
        title: "{ChannelBlock}\n" + f"Time\t{title}\n" + "".join(f"{0.01 * k:.3f}\t{v}\n" for k, v in enumerate(values))
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
        recording = JointRecording([open_recording(path), open_recording(second)])
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
    _, database, read = _with_database(folder / "tables.dbc")
    payloads = [database.encode_message("Motion", {"YawRate": 0.02 * k, "LatAcc": 1.0}) for k in range(40)]

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


def packed(folder: Path, planted: support.Planted) -> Iterator[Kind]:
    """A log of MoTeC, and tables in compressed files and archives."""
    lap = test_readers_motec_ld.lap(4.0)
    test_readers_motec_ld.written(folder / "lap.ld", lap)
    yield "motec ld", folder / "lap.ld", read_recording
    columns = zip(planted.vx, planted.vy, planted.r, strict=True)
    rows = "".join(f"{0.01 * k:.2f},{x},{y},{r}\n" for k, (x, y, r) in enumerate(columns))
    content = f"t [s],vx [m/s],vy [m/s],r [rad/s]\n{rows}".encode()
    for ending, pack in test_readers_unpacking.PACKERS.items():
        if ending != ".zstd":
            path = folder / f"packed.csv{ending}"
            path.write_bytes(pack(content))
            yield f"packed {ending[1:]}", path, read_recording
    yield (
        "zip",
        test_readers_unpacking.zipped(
            folder / "lap.zip", {"lap.csv": content, "README.txt": "Car 7, wind from the left.\n"}
        ),
        read_recording,
    )
    parts = {"lap.csv": content, "gyro.csv": content.replace(b"v", b"w"), "setup.json": "{}"}

    def joined(path: Path) -> bool:
        recording = JointRecording(open_parts(path))
        recording.read([info.name for info in recording.channels()])
        return bool(recording.notes)

    yield "zip together", test_readers_unpacking.zipped(folder / "parts.zip", parts), joined

    test_readers_carmaker_erg.written(folder / "lap.erg", test_readers_carmaker_erg.lap(1.0))
    yield "erg", folder / "lap.erg", read_recording
    whole = folder / "whole.erg"
    test_readers_carmaker_erg.written(whole, test_readers_carmaker_erg.lap(1.0))
    yield "erg info", whole.with_name("whole.erg.info"), lambda path: read_recording(whole)


def read_apart(folder: Path, planted: support.Planted) -> Iterator[Kind]:
    """What libraries read in processes of their own, where they are installed."""
    if find_spec("libxrk"):
        (folder / "lap.xrk").write_bytes(test_readers_apart.aim_log(1.0))
        yield "xrk", folder / "lap.xrk", read_recording
    if find_spec("pyulog"):
        (folder / "lap.ulg").write_bytes(test_readers_apart.ulog(1.0))
        yield "ulog", folder / "lap.ulg", read_recording
    if find_spec("nptdms"):
        test_readers_apart.tdms(folder / "lap.tdms", {"Data": {"t": ({}, np.arange(40.0)), "vx": ({}, planted.vx)}})
        yield "tdms", folder / "lap.tdms", read_recording


def in_pieces(kinds: dict[str, tuple[Path, Callable[[Path], object]]], folder: Path) -> Iterator[Kind]:
    """The same files as of other kinds, with their columns in files, as those of a long recording are."""

    def long(read: Callable[[Path], object]) -> Callable[[Path], object]:
        def reads(path: Path) -> object:
            with patch.multiple(scratch, LONG=LONG_HERE, FORESEEN=LONG_HERE):
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
