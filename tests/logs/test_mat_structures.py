"""MAT files of either kind whose structures have clocks of their own become one drive."""

import struct

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from split_cli.errors import LogError
from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.drafting.suggest import draft_map, render_draft
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping
from tests.logs.planted import PlantedDrive

SHARES = {
    "gps": ("t", 1.0, 20.0, {"x": "X", "y": "Y"}),
    "imu": ("time_ms", 1e3, 100.0, {"yaw_rate": "r", "ax": "ax", "ay": "ay"}),
    "est": ("timestamp", 1.0, 50.0, {"vx": "vx", "vy": "vy", "yaw": "yaw"}),
    "can": ("Time", 1.0, 80.0, {"road_wheel_angle": "delta", "wheel_torque": "T"}),
}


@pytest.mark.parametrize("kind", ["5", "7.3"])
def test_structures_with_clocks_of_their_own_are_one_drive(tmp_path, kind):
    planted = PlantedDrive(seconds=60.0)
    content = {}
    for number, (name, (clock, scale, rate, fields)) in enumerate(SHARES.items()):
        # Each begins at another instant: rows of two structures never share a time.
        time = np.arange(0.003 * number, 60.0, 1.0 / rate)
        content[name] = {clock: scale * time, **{field: planted.at(c, time) for field, c in fields.items()}}
    path = tmp_path / "log.mat"
    if kind == "5":
        savemat(path, {"data": content})
    else:
        with h5py.File(path, "w", userblock_size=512) as file:
            for name, fields in content.items():
                for field, values in fields.items():
                    file.create_dataset(f"data/{name}/{field}", data=values[None, :])
        with open(path, "r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file".ljust(512, b" "))
    recording = open_recording(path)
    draft = draft_map(recording)
    assert {s.channel for s in draft.suggestions if s.status != "open"} == {
        "X",
        "Y",
        "r",
        "ax",
        "ay",
        "vx",
        "vy",
        "yaw",
        "delta",
        "T",
    }
    import yaml

    signal_map = map_from_mapping(yaml.safe_load(render_draft(draft, "log.mat")))
    made = assemble_drive(recording, signal_map, planted.vehicle, IngestSettings())
    assert made.drive.rate == pytest.approx(50.0)
    # The clocks of the structures are no channels: each was kept as one beside those.
    assert set(made.drive.columns) == {s.channel for s in draft.suggestions if s.status != "open"} | {"t"}
    t = made.drive["t"] + made.quality.origin
    for channel, most in (("vx", 0.02), ("r", 2e-3), ("delta", 2e-3), ("ay", 0.05), ("yaw", 2e-3)):
        np.testing.assert_allclose(made.drive[channel][50:-50], planted.at(channel, t[50:-50]), atol=most)


@pytest.mark.parametrize("shorter", ["vx", "vy", "ax"])
def test_channels_of_several_lengths_are_refused_before_anything_is_derived(tmp_path, shorter):
    """Arrays of a file of version 7.3 need not be as long as its clock: a torque computed from them was an error."""
    planted = PlantedDrive(seconds=20.0)
    path = tmp_path / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name in ("t", "vx", "vy", "r", "delta", "ax"):
            time = np.linspace(0.0, 19.0, 400 if name == shorter else 1000)
            file.create_dataset(name, data=(time if name == "t" else planted.at(name, time))[None, :])
    with open(path, "r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(512, b" "))
    channels = {name: {"source": name} for name in ("vx", "vy", "r", "delta", "ax")}
    signal_map = map_from_mapping({"time": {"source": "t", "unit": "s"}, "channels": channels})
    derived = IngestSettings(derive=("torque-from-acceleration",))
    with pytest.raises(LogError, match=f"{shorter} has 400 samples and 1000 time stamps"):
        assemble_drive(open_recording(path), signal_map, planted.vehicle, derived)


def test_signals_of_simulink_are_named_by_their_labels_and_have_its_time(tmp_path):
    """A structure with time, as the blocks Scope and To Workspace save it."""
    planted = PlantedDrive(seconds=30.0)
    time = np.arange(0.0, 30.0, 0.02)
    labels = {"Vx [km/h]": ("vx", 3.6), "v.lat": ("vy", 1.0), "YawRate [deg/s]": ("r", 180.0 / np.pi)}
    fields = [(name, "O") for name in ("values", "dimensions", "label", "title")]
    signals = np.zeros((1, len(labels)), dtype=fields)
    for at, (label, (channel, factor)) in enumerate(labels.items()):
        signals[0, at] = (factor * planted.at(channel, time)[:, None], 1.0, label, "")
    savemat(tmp_path / "scope.mat", {"Scope": {"time": time[:, None], "signals": signals, "blockName": "car/Scope"}})
    recording = open_recording(tmp_path / "scope.mat")
    read = recording.read(["Scope.Vx", "Scope.v_lat", "Scope.YawRate"])
    assert [one.unit for one in read.values()] == ["km/h", None, "deg/s"]
    for one, (channel, factor) in zip(read.values(), labels.values(), strict=True):
        np.testing.assert_array_equal(one.time, time)
        np.testing.assert_allclose(one.values, factor * planted.at(channel, time))
    # Equal labels name nothing: their numbers do.
    signals[0, 1]["label"] = "Vx [km/h]"
    savemat(tmp_path / "twice.mat", {"Scope": {"time": time[:, None], "signals": signals}})
    assert "Scope.signals[1].values" in {info.name for info in open_recording(tmp_path / "twice.mat").channels()}


def test_objects_of_matlab_are_named_and_what_to_save_instead(tmp_path):
    """A timeseries in a file of version 7.3 is a number that only MATLAB can follow."""
    path = tmp_path / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file.create_dataset("logsout", data=np.arange(6, dtype=np.uint32)[None, :])
        file["logsout"].attrs["MATLAB_object_decode"] = 3
    with open(path, "r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(512, b" "))
    with pytest.raises(LogError) as told:
        open_recording(path)
    assert "logsout" in str(told.value) and "S.t = x.Time" in str(told.value)
    with h5py.File(path, "r+") as file:
        file.create_dataset("vx", data=np.arange(50.0)[None, :])
    recording = open_recording(path)
    assert [info.name for info in recording.channels()] == ["vx"]
    assert any("logsout" in note.what for note in recording.notes)


def test_an_object_of_a_class_beside_the_signals_is_named(tmp_path):
    """SciPy reads it, but cannot list it: a simulation's results with its track were called damaged."""

    def element(kind: int, data: bytes) -> bytes:
        return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)

    content = {"t": np.arange(40.0), "x": np.arange(80.0).reshape(2, 40), "u": np.arange(78.0).reshape(2, 39)}
    savemat(tmp_path / "log.mat", {"out": content})
    number = element(6, struct.pack("<II", 6, 0)) + element(5, struct.pack("<ii", 1, 1)) + element(1, b"")
    number = element(14, number + element(9, struct.pack("<d", 1.0)))
    texts = b"".join(element(1, text) for text in (b"track", b"MCOS", b"Track"))
    with (tmp_path / "log.mat").open("ab") as stream:
        stream.write(element(14, element(6, struct.pack("<II", 17, 0)) + texts + number))
    recording = open_recording(tmp_path / "log.mat")
    names = ["out.x[0]", "out.x[1]", "out.u[0]", "out.u[1]"]
    assert [info.name for info in recording.channels()] == ["out.t", *names]
    # Inputs, one less than the states, have their clock; the last lasts as long as it.
    assert {len(s.values) for s in recording.read(names).values()} == {40}
    assert all(s.time is not None for s in recording.read(names).values())
    assert any(note.what.endswith("outside it: track") for note in recording.notes)


def test_what_scipy_only_warns_of_is_counted_or_refused(tmp_path, recwarn):
    path = tmp_path / "log.mat"
    savemat(path, {"t": np.arange(40.0), "vx": np.arange(40.0)}, format="4")
    whole = path.read_bytes()
    # The type of a version 4 matrix has the order of bytes as thousands: 4 is Cray.
    path.write_bytes((4000).to_bytes(4, "little") + whole[4:])
    with pytest.raises(LogError, match="order of bytes"):
        open_recording(path)
    savemat(path, {"t": np.arange(40.0), "vx": np.arange(40.0)})
    whole = path.read_bytes()
    path.write_bytes(whole + whole[128:])
    assert [(n.what, n.count) for n in open_recording(path).notes] == [
        ("variables that cannot be read or stand twice, left out", 2)
    ]
    assert not recwarn.list


def test_an_array_that_lacks_what_its_flags_tell_ends_no_process(tmp_path):
    """SciPy's compiled reader follows a null pointer where a complex array has no imaginary part."""
    path = tmp_path / "log.mat"
    content = {"t": np.arange(40.0), "log": {"vx": np.arange(40.0)}, "cells": np.array([1, "a"], dtype=object)}
    savemat(path, content)
    whole = path.read_bytes()
    assert len(open_recording(path).channels()) == 2
    flags = [at for at in range(128, len(whole)) if whole[at : at + 8] == bytes((6, 0, 0, 0, 8, 0, 0, 0))]
    assert len(flags) == 6
    for at in flags:
        # Complex; then a sparse array, a structure and cells, which are made of other parts.
        for place, value in ((9, 8), (8, 5), (8, 2), (8, 1)):
            if whole[at + place] != value and (place == 8 or whole[at + 8] == 6):
                path.write_bytes(whole[: at + place] + bytes((value,)) + whole[at + place + 1 :])
                with pytest.raises(LogError, match="cut off or damaged"):
                    open_recording(path)


def test_a_structure_of_a_billion_elements_is_refused_before_it_is_counted_out(tmp_path):
    path = tmp_path / "log.mat"
    savemat(path, {"t": np.arange(40.0), "log": {"vx": np.arange(40.0)}})
    whole = path.read_bytes()
    one_by_one = bytes((5, 0, 0, 0, 8, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0))
    at = whole.rindex(one_by_one, 0, whole.index(b"log"))
    path.write_bytes(whole[: at + 8] + (1 << 30).to_bytes(4, "little") + whole[at + 12 :])
    with pytest.raises(LogError, match="its dimensions need 1,073,741,824"):
        open_recording(path)


def test_the_version_of_a_mat_file_is_told_by_its_bytes_and_not_by_its_text(tmp_path):
    """What SciPy reads as version 5 is checked as version 5, whatever the first line says."""
    path = tmp_path / "log.mat"
    savemat(path, {"t": np.arange(40.0), "vx": np.arange(40.0)})
    whole = path.read_bytes().replace(b"MATLAB 5.0", b"MATLAB 5.\xff", 1)
    path.write_bytes(whole)
    assert len(open_recording(path).channels()) == 2
    at = whole.index(bytes((6, 0, 0, 0, 8, 0, 0, 0)))
    path.write_bytes(whole[: at + 9] + bytes((8,)) + whole[at + 10 :])
    with pytest.raises(LogError, match="cut off or damaged"):
        open_recording(path)


def test_a_map_beside_the_signals_and_names_of_a_path_do_not_mislead_the_draft(tmp_path):
    """A car's logger saves structures of one length, the path of the course and the errors across it."""
    planted = PlantedDrive(seconds=60.0)
    t = np.arange(0.0, 60.0, 0.02)
    ins = {
        name: planted.at(c, t)
        for name, c in {
            "posE_m": "X",
            "posN_m": "Y",
            "yawAngle_rad": "yaw",
            "ux_mps": "vx",
            "uy_mps": "vy",
            "yawRate_radps": "r",
        }.items()
    }
    car = {"roadWheelAngle_rad": planted.at("delta", t)}
    across = {"e_m": 0.1 * np.sin(t), "dpsi_rad": 0.02 * np.cos(t), "deltaPsi": 0.02 * np.cos(t)}
    course = {"s_m": np.arange(900.0), "psi_rad": np.linspace(0.0, 6.0, 900), "k_1pm": np.full(900, 0.01)}
    path = tmp_path / "run.mat"
    savemat(path, {"t_20ms": t, "INSData": ins, "car": car, "match": across, "info": {"mapData": course}})
    draft = draft_map(open_recording(path))
    assert draft.time.startswith("time: {source: t_20ms") and draft.left == "east and north"
    found = {s.channel: s.sources[0].split(".")[-1] for s in draft.suggestions if s.status != "open"}
    assert found == {
        "X": "posE_m",
        "Y": "posN_m",
        "yaw": "yawAngle_rad",
        "vx": "ux_mps",
        "vy": "uy_mps",
        "r": "yawRate_radps",
        "delta": "roadWheelAngle_rad",
    }
