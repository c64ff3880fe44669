"""A source without checksums says once that a flipped bit goes unnoticed; one whose checksums are compared does not."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

import tests.logs.readers_support as support
from split_cli.logs.assembling.assemble import Assembled, IngestSettings, _unverified, assemble_drive
from split_cli.logs.assembling.quality import render_quality
from split_cli.logs.drive import metadata_of_drive, write_drive
from split_cli.logs.raw import NO_CHECKSUMS
from split_cli.logs.readers import open_recording
from split_cli.logs.signal_map import map_from_mapping
from tests.factories import make_drive, road_car
from tests.logs.planted import PlantedDrive
from tests.optional import needed

CHANNELS = ("vx", "vy", "r", "T", "delta")
MESSAGES = [("/car", stamp, stamp) for stamp in range(10**9, 31 * 10**9, 2 * 10**7)]
PLAIN = {"use_chunking": False}
NAMES = ("csv", "parquet", "feather", "mat", "npz")


def columns_of(drive: PlantedDrive) -> dict[str, np.ndarray]:
    t = np.arange(0.0, 30.0, 0.02)
    return {"t": t, **{name: drive.at(name, t) for name in CHANNELS}}


def made(path, source: str = "{}") -> Assembled:
    channels = {name: {"source": source.format(name)} for name in CHANNELS}
    clock = {"clock": "log"} if "/" in source else {"source": "t", "unit": "s"}
    given = map_from_mapping({"time": clock, "channels": channels})
    return assemble_drive(open_recording(path), given, None, IngestSettings())


def told(assembled: Assembled) -> int:
    """Return how often the quality report says it; as a command prints it, too."""
    shown = render_quality(assembled.quality).count(NO_CHECKSUMS)
    assert json.dumps(assembled.quality.to_mapping()).count(NO_CHECKSUMS) == shown
    return shown


@pytest.mark.parametrize("kind", NAMES)
def test_a_table_says_it_once_unless_its_members_have_checksums(tmp_path, kind):
    columns, path = columns_of(PlantedDrive(seconds=30.0)), tmp_path / f"log.{kind}"
    frame = pd.DataFrame(columns)
    write = {
        "csv": lambda: frame.to_csv(path, index=False),
        "parquet": lambda: frame.to_parquet(path),
        "feather": lambda: frame.to_feather(path),
        "mat": lambda: savemat(path, columns),
        "npz": lambda: np.savez(path, **columns),
    }
    write[kind]()
    assert told(made(path)) == (kind != "npz")


def test_a_measurement_of_a_bus_says_it_once(tmp_path):
    asammdf = needed("asammdf")
    columns = columns_of(PlantedDrive(seconds=30.0))
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(columns[name], columns["t"], name=name) for name in CHANNELS])
        path = file.save(tmp_path / "log.mf4", overwrite=True)
    given = map_from_mapping({"channels": {name: {"source": name} for name in CHANNELS}})
    assert told(assemble_drive(open_recording(path), given, None, IngestSettings())) == 1


@pytest.mark.parametrize("options", [{}, PLAIN, {"enable_crcs": False}, {**PLAIN, "enable_data_crcs": True}])
def test_an_mcap_file_says_it_only_where_its_writer_left_checksums_out(tmp_path, options):
    columns = columns_of(PlantedDrive(seconds=30.0))
    rows = [{name: float(columns[name][row]) for name in CHANNELS} for row in range(len(MESSAGES))]
    messages = [(*message, json.dumps(row).encode()) for message, row in zip(MESSAGES, rows, strict=True)]
    schema = ("Car", "jsonschema", b'{"type": "object"}')
    path = support.write_mcap(tmp_path / "log.mcap", schema, "json", messages, **options)
    has_none = options in (PLAIN, {"enable_crcs": False})
    assert told(made(path, "/car/{}")) == has_none


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_a_folder_of_rosbag2_says_it_of_a_database(tmp_path, storage):
    folder = support.write_rosbag2(tmp_path / "run", support.plant(count=50), storage)
    (folder / "notes.md").write_text("nothing of the recording")
    assert bool(_unverified(folder, None)) == (storage == "SQLITE3")


def test_a_drive_of_ours_has_checksums(tmp_path):
    write_drive(make_drive(1, 2, 2.0, vehicle=road_car()), tmp_path / "d.parquet")
    assert _unverified(tmp_path / "d.parquet", metadata_of_drive(tmp_path / "d.parquet")) == ""
