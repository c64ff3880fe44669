"""Faults seen when fifty logs of forms not yet tried met the draft: marks, columns of several cars, sizes, names."""

import json

import numpy as np
import pytest
from openpyxl import Workbook
from scipy.io import savemat

from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.assembling.marks_of_nothing import without_marks
from split_cli.logs.drafting.naming import meanings
from split_cli.logs.drafting.suggest import draft_map, render_draft
from split_cli.logs.raw import RawChannelInfo, RawSignal
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping
from tests.logs.planted import PlantedDrive, write_table

DEG = 180.0 / np.pi
T = np.arange(0.0, 40.0, 0.05)


def named(name: str) -> str:
    found = meanings(RawChannelInfo(name, "column", None))
    return found[0].channel if found else ""


def test_what_a_bus_sends_where_it_knows_nothing_is_no_measurement(car, tmp_path):
    """A yaw rate held 327.67 deg/s for three seconds, and was called stated; a speed of 655.35 km/h hid v_x."""
    lost = (T > 20.0) & (T < 23.0)
    speed = np.where(lost, 655.35, 3.6 * car.at("vx", T))
    rate = np.where(lost, 327.67, DEG * car.at("r", T))
    path = tmp_path / "bus.csv"
    write_table(path, {"time [s]": T, "speed [km/h]": speed, "yaw rate [deg/s]": rate, "ay [m/s^2]": car.at("ay", T)})
    draft = draft_map(open_recording(path))
    assert draft.of("vx").status == "judged" and draft.of("r").status in ("judged", "unsided")
    channels = {"vx": {"source": "speed"}, "r": {"source": "yaw rate"}, "ay": {"source": "ay"}}
    made = {"name": "x", "time": {"source": "time"}, "channels": channels}
    settings = IngestSettings(derive=("lateral-velocity-from-accelerations", "torque-from-acceleration"))
    made["channels"]["delta"] = {"source": "ay", "scale": 0.003, "unit": "rad"}
    drive = assemble_drive(open_recording(path), map_from_mapping(made), car.vehicle, settings).drive
    assert np.abs(drive["r"]).max() < 1.1 * np.abs(car.at("r", T)).max()
    assert not np.any((drive["t"] > 20.2) & (drive["t"] < 22.8))
    said = " ".join(drive.metadata.conversions)
    assert f"yaw rate: {lost.sum()} samples of 327.67 are a mark of missing values" in said


@pytest.mark.parametrize(
    "mark, left_out", [(655.35, True), (-999.0, True), (4095.9375, True), (120.0, False), (655.37, False)]
)
def test_a_mark_is_a_number_at_which_counters_end_far_from_all_others(mark, left_out):
    values = np.sin(np.arange(400.0)) * 30.0
    values[50:53] = mark
    kept, said = without_marks(RawSignal("x", None, values, None))
    assert np.isnan(kept.values).sum() == (3 if left_out else 0) and bool(said) == left_out
    # One sample may be a spike, and what is near the others is one of them.
    single = np.where(np.arange(400) == 50, mark, np.sin(np.arange(400.0)) * 30.0)
    assert without_marks(RawSignal("x", None, single, None))[1] == ""
    assert without_marks(RawSignal("x", None, np.clip(values, -25.5, 25.5), None))[1] == ""


def columns_of(car: PlantedDrive, front: str) -> dict[str, np.ndarray]:
    yaw = car.at("yaw", T)
    along, across = car.at("vx", T), car.at("vy", T)
    return {
        f"{front}Vel_X [m/s]": along * np.cos(yaw) - across * np.sin(yaw),
        f"{front}Vel_Y [m/s]": along * np.sin(yaw) + across * np.cos(yaw),
        f"{front}World_Position_X [m]": car.at("X", T),
        f"{front}World_Position_Y [m]": car.at("Y", T),
        f"{front}World_Heading_Angle [rad]": yaw,
    }


@pytest.mark.parametrize("fronts", [("#1 ", "#2 "), ("ego.", "npc1."), ("car_1/", "car_2/")])
def test_columns_of_two_cars_are_said_and_never_mixed(car, fronts, tmp_path):
    """The position was that of one car and v_x, a_x, v_y, a_y were those of another, called judged and stated."""
    other = PlantedDrive(seconds=40.0, seed=5)
    write_table(tmp_path / "two.csv", {"t": T, **columns_of(other, fronts[1]), **columns_of(car, fronts[0])})
    draft = draft_map(open_recording(tmp_path / "two.csv"))
    own = fronts[0].strip("#")
    taken = [name for s in draft.suggestions for name in s.sources]
    assert taken
    if fronts[0] == "ego.":
        assert all(name.startswith(own) for name in taken)
    assert len({name.split(" ")[0].split(".")[0].split("/")[0] for name in taken}) == 1
    assert "columns of 2 cars" in render_draft(draft, "two.csv")


def test_two_sensors_of_one_car_are_no_two_cars(car, tmp_path):
    table = {f"imu{n}.{name}": car.at(c, T) for n in (1, 2) for name, c in (("ax", "ax"), ("ay", "ay"), ("wz", "r"))}
    write_table(tmp_path / "imus.csv", {"t": T, "vx": car.at("vx", T), **table})
    assert not draft_map(open_recording(tmp_path / "imus.csv")).cars


def test_cars_one_behind_the_other_that_share_the_numbers_of_pictures_are_told_apart(car, tmp_path):
    """A street seen from above, a car after the other, by frames: all were one, and a clock 25 times too slow."""
    other, frames = PlantedDrive(seconds=40.0, seed=5), np.arange(1000.0)
    rows = []
    for number, one in enumerate((car, other)):
        t = frames * 0.04
        yaw = DEG * one.at("yaw", t) % 360.0
        rows.append(np.column_stack([0 * t + number, frames, one.at("X", t), one.at("Y", t), yaw, one.at("vx", t)]))
    table = dict(
        zip(["trackId", "frame", "xCenter", "yCenter", "heading", "lonVelocity"], np.vstack(rows).T, strict=True)
    )
    write_table(tmp_path / "street.csv", table)
    draft = draft_map(open_recording(tmp_path / "street.csv"))
    assert draft.rows.startswith("rows: {trackId:") and "CHECK" in draft.rows
    assert draft.time.startswith("time: {period: 0.04}")


def test_a_path_that_only_turns_with_the_car_is_of_no_judged_size(car, tmp_path):
    """Positions in 65,536 parts of a metre were metres, of a size that their turning was said to judge."""
    write_table(
        tmp_path / "game.csv",
        {"t": T, "PosX": 65536 * car.at("X", T), "PosY": 65536 * car.at("Y", T), "YawRate": car.at("r", T)},
    )
    draft = draft_map(open_recording(tmp_path / "game.csv"))
    assert draft.of("X").status == "assumed" and "nothing judges its size" in draft.of("X").reason
    write_table(
        tmp_path / "speed.csv",
        {"t": T, "PosX": car.at("X", T), "PosY": car.at("Y", T), "YawRate": car.at("r", T), "Vx": car.at("vx", T)},
    )
    assert draft_map(open_recording(tmp_path / "speed.csv")).of("X").status in ("judged", "unsided")


def test_one_axis_alone_is_no_position(car, tmp_path):
    write_table(tmp_path / "x.csv", {"t": T, "pos_x": car.at("X", T), "YawRate": car.at("r", T)})
    draft = draft_map(open_recording(tmp_path / "x.csv"))
    assert draft.of("X").status == "open" and "one alone is no position" in draft.of("X").reason


@pytest.mark.parametrize(
    "name, channel",
    [
        ("RelativeSpeedFrontAxleLeftWheel", ""),  # was the speed of a wheel
        ("ESP_wheelSpeedFrL", "wheel_speed_fl"),  # was the right one
        ("ESP_wheelSpeedReR", "wheel_speed_rr"),
        ("chassis_velocities.yaw", "r"),  # was an angle
        ("chassis.orientation.yaw", "yaw"),
        ("LRW", "steering_wheel_angle"),
        ("車速", "vx"),
        ("ヨーレート", "r"),
        ("横加速度", "ay"),
        ("前後加速度", "ax"),
        ("Угловая скорость рыскания", "r"),
        ("Поперечное ускорение", "ay"),
        ("Угол поворота руля", "steering_wheel_angle"),
    ],
)
def test_names_that_were_missed_or_meant_something_else(name, channel):
    assert named(name) == channel


TITLES = {
    "cp932": ("時間［ｓ］", "車速［km/h］", "ヨーレート［deg/s］", "横加速度［m/s2］"),
    "cp1251": ("Время, с", "Скорость, км/ч", "Угловая скорость рыскания, град/с", "Поперечное ускорение, м/с2"),
}


@pytest.mark.parametrize("encoding", [*TITLES])
def test_japanese_and_russian_tables_are_read_in_their_code_pages(car, encoding, tmp_path):
    """Their titles were letters with accents, of which an a_x was made."""
    table = np.column_stack([T, 3.6 * car.at("vx", T), DEG * car.at("r", T), car.at("ay", T)])
    rows = "\n".join(";".join(f"{v:.6f}" for v in row) for row in table)
    (tmp_path / "log.csv").write_bytes(f"{';'.join(TITLES[encoding])}\n{rows}\n".encode(encoding))
    draft = draft_map(open_recording(tmp_path / "log.csv"))
    assert {c: draft.of(c).unit for c in ("vx", "r", "ay")} == {"vx": "km/h", "r": "deg/s", "ay": "m/s^2"}
    assert draft.of("ax") is None and draft.of("vx").status == "judged"


def test_an_angle_of_the_globe_and_one_of_artillery(car, tmp_path):
    """Receivers count a half turn in 32 bits, and 6,400 thousandths go round."""
    degrees = {"lat": 52.1 + car.at("Y", T) / 111195.0, "long": 10.2 + car.at("X", T) / 68305.0}
    columns = {f"position_{name} [semicircles]": np.round(v * 2**31 / 180.0) for name, v in degrees.items()}
    heading = (90.0 - DEG * car.at("yaw", T)) % 360.0
    extra = {"speed [m/s]": car.at("vx", T), "heading_mil": heading / 360.0 * 6400.0}
    extra["yaw_rate_mrad_s"] = 1e3 * car.at("r", T)
    write_table(tmp_path / "fit.csv", {"t": T, **columns, **extra})
    draft = draft_map(open_recording(tmp_path / "fit.csv"))
    assert draft.of("X").status == "judged" and draft.of("yaw").status == "judged"
    assert draft.of("yaw").unit == "mil" and draft.of("r").unit == "mrad/s"


def test_factors_in_comments_that_name_each_channel(car, tmp_path):
    """Whole numbers were quantities without a unit: 650 rad/s."""
    listed = {"Time": ("s", 0.001, 0.0, T), "VehSpd": ("km/h", 0.01, 0.0, 3.6 * car.at("vx", T))}
    listed["YawRate"] = ("deg/s", 0.005, -163.84, DEG * car.at("r", T))
    for form in ("keys", "table"):
        lines = ["Signal;Unit;Factor;Offset"] if form == "table" else []
        for name, (unit, factor, offset, _) in listed.items():
            keyed = f"# name={name} unit={unit} factor={factor} offset={offset}"
            lines.append(keyed if form == "keys" else f"{name};{unit};{factor};{offset}")
        lines.append(";".join(listed))
        counts = [np.round((v - offset) / factor).astype(int) for _, factor, offset, v in listed.values()]
        lines += [";".join(map(str, row)) for row in zip(*counts, strict=True)]
        path = tmp_path / f"{form}.csv"
        path.write_text("\n".join(lines) + "\n")
        read = open_recording(path).read(["VehSpd", "YawRate"])
        assert read["VehSpd"].values == pytest.approx(3.6 * car.at("vx", T), abs=0.006)
        assert read["YawRate"].values == pytest.approx(DEG * car.at("r", T), abs=0.003)
        assert (read["VehSpd"].unit, read["YawRate"].unit) == ("km/h", "deg/s")


def test_a_quaternion_of_motion_capture_whose_real_part_is_alone_in_its_group(car, tmp_path):
    """X, Y, Z, W under *Rotation* and X, Y, Z under *Position*, with y up: yaw was constant, or r a part of it."""
    yaw, zero = car.at("yaw", T), 0.0 * T
    columns = [T, zero, np.sin(yaw / 2), zero, np.cos(yaw / 2), car.at("X", T), zero + 0.1, -car.at("Y", T)]
    head = ",Rotation,Rotation,Rotation,Rotation,Position,Position,Position\nTime (Seconds),X,Y,Z,W,X,Y,Z\n"
    rows = "\n".join(",".join(f"{v:.7f}" for v in row) for row in zip(*columns, strict=True))
    (tmp_path / "take.csv").write_text(head + rows + "\n")
    draft = draft_map(open_recording(tmp_path / "take.csv"))
    assert draft.of("yaw").sources == ("Rotation.Z", "Rotation.X", "Rotation.Y", "Rotation.W")
    assert draft.of("yaw").status == "unsided" and draft.of("X").status != "judged"


def test_structures_with_data_and_time_beside_a_vector_of_times(car, tmp_path):
    """No drive could be made of them, since the vector of times had no clock; one of their times was the steering."""
    signals = {"YawRate": car.at("r", T), "VehSpd": car.at("vx", T), "SteerAngle": car.at("delta", T)}
    run = {name: {"Time": T, "Data": values, "Name": name} for name, values in signals.items()}
    savemat(tmp_path / "out.mat", {"out": run, "tout": T})
    recording = open_recording(tmp_path / "out.mat")
    draft = draft_map(recording)
    assert draft.of("delta").sources == ("out.SteerAngle.Data",)
    channels = {"vx": {"source": "out.VehSpd.Data"}, "r": {"source": "out.YawRate.Data"}}
    channels |= {"vy": {"source": "out.YawRate.Data", "unit": "m/s"}, "delta": {"source": "out.SteerAngle.Data"}}
    signal_map = map_from_mapping({"name": "x", "channels": channels})
    settings = IngestSettings(derive=("torque-from-acceleration",))
    drive = assemble_drive(recording, signal_map, car.vehicle, settings).drive
    assert drive["vx"] == pytest.approx(car.at("vx", drive["t"]), abs=1e-3)


def test_sheets_of_a_workbook_each_with_its_clock_are_one_log(car, tmp_path):
    """Only the sheet with the most numbers was read, and the others were said to be in another file perhaps."""
    book = Workbook()
    book.active.append(["mass", 1573])
    for sheet, rate, channel, scale, title in (
        ("CAN", 0.05, "vx", 3.6, "speed [km/h]"),
        ("IMU", 0.02, "r", DEG, "yaw rate [deg/s]"),
    ):
        page, t = book.create_sheet(sheet), np.arange(0.0, 40.0, rate)
        page.append(["t [s]", title])
        for row in zip(t, scale * car.at(channel, t), strict=True):
            page.append([float(v) for v in row])
    book.save(tmp_path / "log.xlsx")
    read = open_recording(tmp_path / "log.xlsx").read(["speed", "yaw rate"])
    assert len(read["speed"].values) == 800 and len(read["yaw rate"].values) == 2000
    assert read["yaw rate"].values == pytest.approx(DEG * car.at("r", read["yaw rate"].time))


def test_coordinates_of_geojson_are_longitude_and_latitude(car, tmp_path):
    points = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [10.2 + x / 68305.0, 52.1 + y / 111195.0, 100.0]},
            "properties": {"time": float(t), "speed": float(v)},
        }
        for t, x, y, v in zip(T, car.at("X", T), car.at("Y", T), car.at("vx", T), strict=True)
    ]
    (tmp_path / "track.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": points}))
    draft = draft_map(open_recording(tmp_path / "track.geojson"))
    assert draft.of("X").sources == ("geometry.coordinates[1]", "geometry.coordinates[0]")
    assert draft.of("X").status == "judged"


def test_a_quaternion_that_rolls_on_a_straight_keeps_its_axes(car, tmp_path):
    roll, yaw = 0.05 * np.sin(T), 0.002 * np.sin(0.3 * T)
    columns = {"q.x": roll / 2, "q.y": 0.0 * T, "q.z": yaw / 2, "q.w": np.sqrt(1.0 - (roll**2 + yaw**2) / 4)}
    write_table(tmp_path / "straight.csv", {"t": T, **columns, "vx": car.at("vx", T)})
    assert draft_map(open_recording(tmp_path / "straight.csv")).of("yaw").sources[0].startswith("q")
    assert not any("not up" in s.reason for s in draft_map(open_recording(tmp_path / "straight.csv")).suggestions)


def test_a_field_called_t_is_a_torque_and_no_time(car, tmp_path):
    write_table(tmp_path / "log.csv", {"t": T, "wheels.T [N m]": car.at("T", T), "car.vx [m/s]": car.at("vx", T)})
    assert draft_map(open_recording(tmp_path / "log.csv")).of("T").sources == ("wheels.T",)
