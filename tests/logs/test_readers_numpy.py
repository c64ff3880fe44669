"""NumPy arrays as recordings: what NumPy wrote comes back, and what is damaged or unsafe is refused."""

import zipfile

import numpy as np
import pytest

from split_cli.errors import LogError
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.readers.opening import open_recording
from split_cli.workflows.sources import find_sources


def motion(period=0.02, seconds=40.0):
    """Return time, speed, yaw rate, yaw and path of a car that winds, shapes (N,)."""
    t = np.arange(0.0, seconds, period)
    v, r = 15.0 + 3.0 * np.sin(0.3 * t), 0.3 * np.sin(0.8 * t)
    yaw = np.cumsum(r) * period
    return t, v, r, yaw, np.cumsum(v * np.cos(yaw)) * period, np.cumsum(v * np.sin(yaw)) * period


def read(recording):
    return recording.read([info.name for info in recording.channels()])


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_an_archive_gives_back_what_was_saved_with_the_clock_of_each_length(tmp_path, save):
    t, v, r, yaw, *_ = motion()
    fine = np.arange(0.0, 40.0, 0.005)
    imu = np.rec.fromarrays([fine, np.sin(fine)], names="t,ax")
    save(
        tmp_path / "a.npz",
        t_gps=t * 1e3,
        gps=np.column_stack([v, yaw]).astype(np.float32),
        imu=imu,
        name=np.array("car"),
        flags=np.asfortranarray(np.ones((len(t), 2), dtype=bool)),
    )
    found = read(open_recording(tmp_path / "a.npz"))
    assert set(found) == {"t_gps", "gps[0]", "gps[1]", "imu.t", "imu.ax", "flags[0]", "flags[1]"}
    np.testing.assert_allclose(found["gps[0]"].values, v, rtol=1e-7)
    np.testing.assert_allclose(found["gps[0]"].time, t, atol=1e-9)
    np.testing.assert_array_equal(found["imu.ax"].values, np.sin(fine))
    np.testing.assert_allclose(found["imu.ax"].time, fine, atol=1e-12)


def test_a_structured_array_is_a_table(tmp_path):
    t, v, r, yaw, x, y = motion()
    np.save(tmp_path / "a.npy", np.rec.fromarrays([t, v, r, yaw, x, y], names="t,vx,yaw_rate,yaw,x,y"))
    draft = draft_map(open_recording(tmp_path / "a.npy"))
    assert draft.time == "time: {source: t, unit: s}"
    assert draft.of("vx").status == "judged" and draft.of("r").sources == ("yaw_rate",)
    stamps = np.datetime64("2024-04-23T13:15:46") + (t * 1e9).astype("timedelta64[ns]")
    stamps[7] = "NaT"
    np.savez(tmp_path / "b.npz", stamp=stamps, vx=v)
    moved = read(open_recording(tmp_path / "b.npz"))["stamp"].values
    t[7] = np.nan
    np.testing.assert_allclose(moved - moved[0], t, atol=1e-6)


def test_what_is_no_vector_and_columns_beyond_the_most_are_counted(tmp_path):
    np.savez(tmp_path / "a.npz", image=np.zeros((9, 8, 8)), scan=np.ones((200, 70)), vx=np.arange(200.0))
    recording = open_recording(tmp_path / "a.npz")
    assert [note.count for note in recording.notes] == [1, 6] and len(recording.channels()) == 65


def test_a_folder_of_arrays_is_one_recording_as_comma2k19_and_tartandrive_write_it(tmp_path):
    """An array and its times in a folder for each signal, with or without an ending; matrices of ROS messages."""
    t, v, r, yaw, x, y = motion()
    zero = np.zeros_like(t)
    turn = (zero, zero, np.sin(yaw / 2), np.cos(yaw / 2))
    odometry = np.column_stack([x, y, zero, *turn, v, zero, zero, zero, zero, r])
    imu = np.column_stack([zero, zero, r, zero, v * r, zero + 9.8])
    for folder, stamps, name, values in (
        ("CAN/speed", "t", "value", v),
        ("odom", "timestamps.txt", "odometry.npy", odometry),
        ("imu", "timestamps.txt", "imu.npy", imu),
    ):
        (tmp_path / folder).mkdir(parents=True)
        with open(tmp_path / folder / name, "wb") as stream:
            np.save(stream, values)
        if stamps == "t":
            with open(tmp_path / folder / stamps, "wb") as stream:
                np.save(stream, t)
        else:
            np.savetxt(tmp_path / folder / stamps, 1.7e9 + t)
    assert [source.address for source in find_sources([str(tmp_path)])] == [str(tmp_path)]
    recording = open_recording(tmp_path)
    found = read(recording)
    np.testing.assert_array_equal(found["CAN.speed"].values, v)
    np.testing.assert_allclose(found["imu.linear_acceleration.y"].values, v * r)
    np.testing.assert_allclose(found["odom.twist.angular.z"].time - 1.7e9, t, atol=1e-6)
    draft = draft_map(recording)
    assert draft.of("yaw").convert == "yaw_from_quaternion"
    assert draft.of("r").sources[0].endswith(("angular.z", "angular_velocity.z"))


def test_a_state_of_six_numbers_is_no_imu(tmp_path):
    """BARC's laps: progress, offset, angle, v_x, v_y, r; the first three are 9 m long on the median."""
    t, v, r, *_ = motion()
    zero = np.zeros_like(t)
    np.savetxt(tmp_path / "x.txt", np.column_stack([0.5 * t, zero, zero, v, zero, r]))
    np.savetxt(tmp_path / "t.txt", t)
    np.savetxt(tmp_path / "k.txt", r / v)
    found = read(open_recording(tmp_path))
    assert set(found) == {"t", "k", *(f"x[{k}]" for k in range(6))}
    np.testing.assert_allclose(found["x[3]"].values, v)


def test_texts_of_one_number_a_line_are_the_columns_of_one_table(tmp_path):
    """One text for each channel, as MATLAB's `save -ascii` writes a workspace; a remark is left out."""
    t, v, r, *_ = motion()
    for name, values in (("t", t), ("vx", v), ("yawRate", r)):
        np.savetxt(tmp_path / f"{name}.txt", values, fmt="%16.7e")
    (tmp_path / "LINK.txt").write_text("See the university's page.\nThe car is an old one.\nAnd so on.\n")
    recording = open_recording(tmp_path)
    found = read(recording)
    assert set(found) == {"t", "vx", "yawRate"}
    np.testing.assert_allclose(found["yawRate"].values, r, rtol=1e-6, atol=1e-9)
    assert draft_map(recording).time == "time: {source: t, unit: s}"


def test_python_objects_are_never_loaded_and_are_told(tmp_path):
    class Trap:
        def __reduce__(self):
            return (open, (str(tmp_path / "sprung"), "w"))

    np.savez(tmp_path / "a.npz", vx=np.arange(50.0), trap=np.array([Trap()], dtype=object))
    recording = open_recording(tmp_path / "a.npz")
    assert [info.name for info in recording.channels()] == ["vx"]
    assert any("objects" in note.what for note in recording.notes)
    np.save(tmp_path / "b.npy", np.array([Trap()], dtype=object))
    with pytest.raises(LogError, match="no vector of numbers"):
        open_recording(tmp_path / "b.npy")
    assert not (tmp_path / "sprung").exists()


def test_damaged_archives_are_refused(tmp_path):
    np.savez(tmp_path / "a.npz", t=np.arange(500.0), vx=np.arange(500.0))
    whole = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    np.save(tmp_path / "b.npy", np.arange(500.0))
    array = (tmp_path / "b.npy").read_bytes()
    (tmp_path / "cut.npy").write_bytes(array[:-100])
    (tmp_path / "claims.npy").write_bytes(array.replace(b"(500,)", b"(5e9,)".replace(b"5e9", b"999")))
    (tmp_path / "junk.npy").write_bytes(array[:20] + b"\xff" * 60 + array[80:])
    flipped = bytearray(whole)
    flipped[2000] ^= 1
    (tmp_path / "flipped.npz").write_bytes(flipped)
    for name in ("cut.npz", "cut.npy", "claims.npy", "junk.npy", "flipped.npz"):
        with pytest.raises(LogError):
            open_recording(tmp_path / name)


def test_an_archive_that_unfolds_without_end_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive, archive.open("x.npy", "w") as f:
        np.lib.format.write_array_header_1_0(f, {"descr": "<f8", "fortran_order": False, "shape": (10_000_000,)})
        for _ in range(80):
            f.write(bytes(1_000_000))
    with pytest.raises(LogError, match="no recording is like that"):
        open_recording(tmp_path / "a.npz")
