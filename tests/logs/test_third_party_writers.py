"""Ways of writing rows, titles, cells and clocks that were first met in logs as sixty kinds of programs write them."""

import base64
import struct

import numpy as np
import pytest

from split_cli.logs.assembling.assemble import assemble_drive
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.readers.cells import number_of
from split_cli.logs.readers.clock_of_day import counted_clock, over_midnight, spread_over_seconds
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping
from split_cli.signals import find_unit
from split_cli.workflows.ingesting.ingest import open_logs
from split_cli.workflows.ingesting.init import init_project
from split_cli.workflows.sources import find_sources, skipped_files
from tests.logs.planted import LOGGED, write_table
from tests.optional import needed

DEG = 180.0 / np.pi


@pytest.fixture(scope="module")
def rows(car):
    """Return time and values of three channels in the units of a logger, row by row."""
    t = np.arange(0.0, 40.0, 0.02)
    return np.column_stack([t, *(factor * car.at(channel, t) for channel, factor, _ in LOGGED.values())])


def check(recording, car, names=tuple(LOGGED)):
    """Compare what a recording holds with the truth, in the units that it states."""
    read = recording.read(list(names))
    for name, (channel, factor, unit) in zip(names, LOGGED.values(), strict=True):
        t = np.arange(0.0, 40.0, 0.02)
        good = np.isfinite(read[name].values)
        assert read[name].unit in (unit, None) and np.count_nonzero(good) == len(t)
        assert read[name].values[good] == pytest.approx(factor * car.at(channel, t), abs=1e-4 * factor)


def lines_of(rows, separator):
    return [separator.join(f"{value:.6f}" for value in row) for row in rows]


def test_rows_above_the_values_that_begin_with_their_label(rows, car, tmp_path):
    """The row of comments, next to the values, was taken for the names."""
    numbered = [f"{n}\t{line}" for n, line in enumerate(lines_of(rows, "\t"))]
    head = ["Vehicle:\tXC", "", "Name\tTime\t" + "\t".join(LOGGED), "Unit\ts\tkm/h\tdeg/s\tm/s2"]
    head += ["Comment\ttime\tspeed of travel\tgyro\tacceleration"]
    (tmp_path / "log.txt").write_text("\n".join([*head, *numbered]))
    check(open_recording(tmp_path / "log.txt"), car)
    traced = [("trace_values," if n == 0 else ",") + line for n, line in enumerate(lines_of(rows, ","))]
    head = ["meta_end,,,,", "name,time," + ",".join(LOGGED), "path,,Plant/v,Plant/r,Plant/a"]
    (tmp_path / "log.csv").write_text("\n".join([*head, "unit,s,km/h,deg/s,m/s^2", *traced]))
    recording = open_recording(tmp_path / "log.csv")
    check(recording, car)
    assert draft_map(recording).time == "time: {source: time, unit: s}"


def test_titles_that_commas_part_stand_above_values_that_blanks_part(rows, car, tmp_path):
    """The titles of POSPac hold blanks themselves: they were called too many for the values."""
    titles = "TIME, Z ANGULAR RATE, Y ACCELERATION, GROUND SPEED\n( TIME IN Sec, RATE IN Degrees )\n\n"
    order = rows[:, [0, 2, 3, 1]]
    (tmp_path / "log.txt").write_text(titles + "\n".join(lines_of(order, "   ")))
    names = ("GROUND SPEED", "Z ANGULAR RATE", "Y ACCELERATION")
    check(open_recording(tmp_path / "log.txt"), car, names)


@pytest.mark.parametrize(
    "form", ["t:{:.0f},v:{:.6f},yaw_rate:{:.6f},ay:{:.6f}", "t={:.0f} v={:.6f}  yaw_rate={:.6f} ay={:.6f}"]
)
def test_lines_of_names_with_values_are_a_table(form, rows, car, tmp_path):
    written = [form.format(1e3 * row[0], *row[1:]) for row in rows]
    (tmp_path / "log.log").write_text("Booting...\nGPS: waiting\n" + "\n".join(written) + "\n")
    recording = open_recording(tmp_path / "log.log")
    check(recording, car, ("v", "yaw_rate", "ay"))
    draft = draft_map(recording)
    assert draft.time == "time: {source: t, unit: ms}" and draft.of("r").unit == "deg/s"
    assert [note.count for note in recording.notes if "another form" in note.what] == [1]  # GPS: is a pair


@pytest.mark.parametrize("lines", [["12:00:01,1.5,2.5"] * 9, ["a: 1"] * 9, ["x:hello,y:world"] * 9])
def test_other_lines_are_no_names_with_values(lines):
    from split_cli.logs.readers.labelled_lines import is_labelled

    assert not is_labelled("\n".join([*lines, ""]).encode())


def test_cells_with_their_unit_are_read_in_si(rows, car, tmp_path):
    """A dashboard scales each cell by itself: 950 mm/s beside 1.2 m/s."""
    written = [f"{r[0]:.3f},{r[1] / 3.6 * (1e3 if n % 2 else 1):.4f} {'mm/s' if n % 2 else 'm/s'},"
               f"{r[2]:.5f} °/s,{r[3]:.5f} m/s²" for n, r in enumerate(rows)]  # fmt: skip
    (tmp_path / "log.csv").write_text("Time,speed,yaw_rate,lat_acc\n" + "\n".join(written))
    recording = open_recording(tmp_path / "log.csv")
    read = recording.read(["speed", "yaw_rate"])
    t = np.arange(0.0, 40.0, 0.02)
    assert (read["speed"].unit, read["yaw_rate"].unit) == ("m/s", "rad/s")
    assert read["speed"].values == pytest.approx(car.at("vx", t), abs=1e-3)
    assert read["yaw_rate"].values == pytest.approx(car.at("r", t), abs=1e-5)


@pytest.mark.parametrize("cell", ["5200.12 N", "3D", "12 laps", "v 3 m", "1-2 m"])
def test_other_cells_are_no_number_with_a_unit(cell):
    assert np.isnan(number_of(cell, "."))


def test_a_count_behind_the_point_without_leading_zeros_is_read_as_such(rows, car, tmp_path):
    """12.5 for 12.005 s: 71 % of the rows were lost, and the others at wrong times."""
    stamps = [f"{1_718_000_000 + int(t)}.{round(1e6 * (t % 1.0)):d}" for t in rows[:, 0]]
    written = [f"{stamp},{line}" for stamp, line in zip(stamps, lines_of(rows[:, 1:], ","), strict=True)]
    (tmp_path / "log.csv").write_text("time," + ",".join(LOGGED) + "\n" + "\n".join(written))
    time = open_recording(tmp_path / "log.csv").read(["time"])["time"].values
    assert time - 1_718_000_000 == pytest.approx(rows[:, 0], abs=1e-6)
    # A clock that starts again rises in neither reading, and one with all its digits in the usual one.
    assert counted_clock(["1.5", "1.50", "0.5", "0.6"]) is None
    assert counted_clock(["1.05", "1.10", "1.15"]) == pytest.approx([1.05, 1.10, 1.15])


@pytest.mark.parametrize(("second", "unit"), [(1.0, "s"), (1e3, "ms")])
def test_a_clock_of_the_week_goes_on_over_its_end(second, unit, rows, car, tmp_path):
    tow = (604_780.0 + rows[:, 0]) % 604_800.0 * second
    titles = f"GPS TOW ({unit}),Speed (km/h),YawRate (deg/s),LatAcc (m/s^2)"
    write_table(tmp_path / "log.csv", dict(zip(titles.split(","), [tow, *rows.T[1:]], strict=True)), fmt="%.6f")
    recording = open_recording(tmp_path / "log.csv")
    sources = {"vx": "Speed", "r": "YawRate", "ay": "LatAcc", "vy": "LatAcc", "T": "LatAcc", "delta": "YawRate"}
    entries = {c: {"source": s, "unit": "m/s"} if c == "vy" else {"source": s} for c, s in sources.items()}
    entries["vy"] |= {"scale": 0.1}
    entries["T"] = {"source": "LatAcc", "unit": "N m", "scale": 100.0}
    entries["delta"] = {"source": "YawRate", "unit": "deg", "scale": 0.1}
    named = map_from_mapping({"time": {"source": "GPS TOW", "unit": unit}, "channels": entries})
    drive = assemble_drive(recording, named, car.vehicle).drive
    assert len(np.unique(drive.segment)) == 1
    assert drive.columns["vx"] == pytest.approx(car.at("vx", drive.columns["t"]), abs=0.01)
    # An hour counter that falls far from the end of a week began anew.
    assert over_midnight(np.array([400_000.0, 400_001.0, 5.0])) == pytest.approx([400_000.0, 400_001.0, 5.0])


def test_a_value_beside_the_number_of_its_parameter_is_a_signal(rows, car, tmp_path):
    written = [
        f'"{50_000 + row[0] + 0.001 * k:.3f}";"{name}";"{row[k + 1]:.6f}";"{unit}";"";'
        for row in rows
        for k, (name, (_, _, unit)) in enumerate(LOGGED.items())
    ]
    (tmp_path / "log.csv").write_text('"SECONDS";"PID";"VALUE";"UNITS";"LATITUDE";\n' + "\n".join(written))
    check(open_recording(tmp_path / "log.csv"), car)


def test_files_of_one_drive_meet_by_a_clock_in_words_of_any_title(rows, car, tmp_path):
    """The column of dates counted as no time, though the file alone was read by it."""
    day = "2026-11-28T14:03:{:06.3f}Z"
    for name, column in (("gps", 1), ("gyro", 2)):
        written = [f'"{1e3 * r[0]:.3f}","{day.format(r[0])}","{r[column]:.6f}"' for r in rows]
        (tmp_path / f"{name}.csv").write_text(f'"cts","date","{[*LOGGED][column - 1]}"\n' + "\n".join(written))
    read = open_logs([tmp_path / "gps.csv", tmp_path / "gyro.csv"]).read(["Speed", "YawRate"])
    assert read["Speed"].time == pytest.approx(read["YawRate"].time)
    assert np.diff(read["Speed"].time) == pytest.approx(0.02, abs=1e-6)


def test_rows_of_a_clock_of_whole_seconds_are_spread_over_them(rows, car, tmp_path):
    """Five rows a second with one stamp: four of them were dropped, and the next command was refused for a gap."""
    write_table(tmp_path / "obd.csv", {"time": np.floor(1_718_000_000.4 + rows[::10, 0]), "speed_kmh": rows[::10, 1]})
    stamps = 1e3 * (1_718_000_000.4 + rows[:, 0])
    imu = {"timestamp_ms": stamps, "yaw_rate_dps": rows[:, 2], "ay_ms2": rows[:, 3]}
    write_table(tmp_path / "imu.csv", imu, fmt="%.9f")
    speed = open_logs([tmp_path / "obd.csv", tmp_path / "imu.csv"]).read(["speed_kmh"])["speed_kmh"]
    assert speed.time - 1_718_000_000.4 == pytest.approx(rows[::10, 0], abs=1e-3)
    step = init_project([tmp_path / "obd.csv", tmp_path / "imu.csv"], tmp_path / "car", together=True).next_steps[-1]
    assert "--gap 0.5" in step


def test_whole_seconds_beside_a_finer_clock_are_left_as_they_are(rows, tmp_path):
    """A phone writes the time of the fix and its own: the one with parts of seconds is the time."""
    columns = {"GPS Time": np.floor(rows[:, 0]), "Device Time": rows[:, 0], "speed_kmh": rows[:, 1]}
    write_table(tmp_path / "log.csv", columns)
    recording = open_recording(tmp_path / "log.csv")
    assert recording.read(["GPS Time"])["GPS Time"].values == pytest.approx(np.floor(rows[:, 0]))
    assert draft_map(recording).time.startswith("time: {source: Device Time, unit: s}")


def test_only_seconds_of_alike_numbers_of_rows_are_spread():
    even = np.repeat(np.arange(20.0), 5)
    assert spread_over_seconds(even) == pytest.approx(np.arange(100) / 5.0)
    cut = even[3:-2]  # the first second ends where the second one begins
    assert spread_over_seconds(cut) == pytest.approx(np.arange(100)[3:-2] / 5.0)
    lost = np.delete(even, [31, 32])
    assert np.all(np.diff(spread_over_seconds(lost)) > 0.0)
    unlike = np.repeat(np.arange(20.0), [1, 9] * 10)
    for other in (np.arange(100.0), even + 0.5, unlike, even[::-1], np.concatenate([even, even])):
        assert spread_over_seconds(other) is None


def test_a_folder_of_a_phone_holds_a_file_for_each_sensor(rows, tmp_path):
    """A table about the device, without a row of numbers, had been refused as a log."""
    folder = tmp_path / "phone"
    for name, (title, column) in {"Gyroscope": ("YawRate (deg/s)", 2), "Location": ("Speed (km/h)", 1)}.items():
        folder.mkdir(exist_ok=True)
        write_table(folder / f"{name}.csv", {"Time (s)": rows[:, 0], title: rows[:, column]})
    (folder / "device.csv").write_text('"property","value"\n"deviceModel","X"\n')
    assert [source.name for source in find_sources([folder])] == ["Gyroscope.csv", "Location.csv"]
    assert skipped_files([folder]) == {".csv": 1}
    steps = init_project([folder], tmp_path / "car").next_steps
    assert any(f"split init {folder} --together -o " in step for step in steps)
    assert "not judged; by" in (tmp_path / "car" / "map.yaml").read_text()


def test_titles_of_several_lines_in_quotes_are_one_row(rows, car, tmp_path):
    """A spreadsheet with the unit under the name in one cell was told that its titles do not fit its rows."""
    titles = ['"Time\n(s)"', *(f'"{name}\r\n({unit})"' for name, (_, _, unit) in LOGGED.items())]
    (tmp_path / "log.csv").write_bytes((",".join(titles) + "\n" + "\n".join(lines_of(rows, ","))).encode())
    check(open_recording(tmp_path / "log.csv"), car)


def test_inches_before_the_titles_open_no_quote(rows, car, tmp_path):
    head = ['Rims,15" front', 'Note,"two 15"" rims"', "time," + ",".join(LOGGED), "s,km/h,deg/s,m/s^2"]
    (tmp_path / "log.csv").write_text("\n".join([*head, *lines_of(rows, ",")]))
    check(open_recording(tmp_path / "log.csv"), car)


def test_rows_whose_cells_all_say_what_they_hold_are_units_or_nothing(rows, car, tmp_path):
    """Simulink's Data Inspector writes units, types and interpolation so, under the names."""
    head = ["time," + ",".join(LOGGED), '"","Unit: km/h","Unit: deg/s","Unit: m/s^2"']
    head += ['"",' + ",".join(['"Type: double"'] * 3), '"",' + ",".join(['"Interp: zoh"'] * 3)]
    (tmp_path / "log.csv").write_text("\n".join([*head, *lines_of(rows, ",")]))
    recording = open_recording(tmp_path / "log.csv")
    check(recording, car)
    assert [info.unit for info in recording.channels()][1:] == ["km/h", "deg/s", "m/s^2"]


def test_frames_of_python_can_in_base_64_are_decoded(rows, car, tmp_path):
    """With their DBC they had been listed as four columns of numbers."""
    needed("can")
    signals = 'BO_ 256 ESP: 8 E\n SG_ Speed : 0|16@1+ (0.01,0) [0|655] "km/h" E\n'
    signals += ' SG_ YawRate : 16|16@1- (0.01,0) [-300|300] "deg/s" E\n'
    (tmp_path / "bus.dbc").write_text(f'VERSION ""\nBU_: E\n{signals}')
    frames = ["timestamp,arbitration_id,extended,remote,error,dlc,data"]
    rows = rows[::20]
    for row in rows:
        data = struct.pack("<Hhxxxx", round(100.0 * row[1]), round(100.0 * row[2]))
        frames.append(f"{1_718_000_000 + row[0]:.6f},0x100,0,0,0,8,{base64.b64encode(data).decode()}")
    frames.append("1718000041.0,0x100,0,0,0,8,%%%")
    (tmp_path / "log.csv").write_text("\n".join(frames))
    read = open_recording(tmp_path / "log.csv", message_paths=[tmp_path / "bus.dbc"]).read(
        ["/ESP/Speed", "/ESP/YawRate"]
    )
    assert read["/ESP/Speed"].values == pytest.approx(rows[:, 1], abs=0.0051)
    assert read["/ESP/YawRate"].values == pytest.approx(rows[:, 2], abs=0.0051)


@pytest.mark.parametrize(("packed", "south", "west"), [(False, True, False), (True, False, True), (True, True, True)])
def test_coordinates_have_the_sign_of_the_half_that_stands_behind_them(packed, south, west, car, tmp_path):
    """Without it a track in the south is a mirror image: every sign of a sound car was turned, and called judged."""
    t = np.arange(0.0, 40.0, 0.1)
    half = (-1.0 if south else 1.0), (-1.0 if west else 1.0)
    radius, at = 6_378_137.0, (half[0] * 39.02, half[1] * 9.01)
    lat = at[0] + DEG * car.at("Y", t) / radius
    lon = at[1] + DEG * car.at("X", t) / radius / np.cos(at[0] / DEG)

    def cell(degrees, wide):
        whole, part = divmod(abs(degrees), 1.0)
        return f"{100 * whole + 60.0 * part:0{wide}.7f}" if packed else f"{abs(degrees):.9f}"

    rows = ["time_s,Latitude,N/S,Longitude,E/W,speed_mps,yaw_rate_dps,ay_mps2"]
    for k in range(len(t)):
        motion = (car.at("vx", t[k]), DEG * car.at("r", t[k]), car.at("ay", t[k]))
        place = f"{cell(lat[k], 12)},{'S' if south else 'N'},{cell(lon[k], 13)},{'W' if west else 'E'}"
        rows.append(f"{t[k]:.2f},{place}," + ",".join(f"{value:.6f}" for value in motion))
    (tmp_path / "log.csv").write_text("\n".join(rows))
    recording = open_recording(tmp_path / "log.csv")
    read = recording.read(["Latitude", "Longitude"])
    assert read["Latitude"].values == pytest.approx(lat, abs=1e-8)
    assert read["Longitude"].values == pytest.approx(lon, abs=1e-8)
    draft = draft_map(recording)
    assert {draft.of(c).scale for c in ("r", "ay")} == {1.0} and draft.left == "east and north"
    assert {draft.of(c).status for c in ("r", "ay", "X", "Y")} == {"judged"}


def test_a_fix_is_read_in_the_unit_of_angles_that_its_file_states(car, tmp_path):
    t = np.arange(0.0, 40.0, 0.1)
    radius = 6_378_137.0
    lat, lon = 0.9 + car.at("Y", t) / radius, 0.17 + car.at("X", t) / radius / np.cos(0.9)
    columns = {"t": t, "latitude [rad]": lat, "longitude [rad]": lon, "v_fwd [m/s]": car.at("vx", t)}
    write_table(tmp_path / "log.csv", {**columns, "yaw_rate [rad/s]": car.at("r", t)})
    draft = draft_map(open_recording(tmp_path / "log.csv"))
    assert {draft.of(c).status for c in ("X", "Y", "vx", "r")} == {"judged"}


def test_a_row_of_the_steps_that_whole_numbers_count_is_one_of_units(rows, car, tmp_path):
    """`0.01 km/h` under a title is no value of it."""
    steps = (1e-2, 1e-3, 1e-4)
    counts = np.rint(rows[:, 1:] / steps)
    written = [f"{t:.2f};" + ";".join(f"{v:.0f}" for v in values) for t, values in zip(rows[:, 0], counts, strict=True)]
    head = ["time;" + ";".join(LOGGED), "s;0.01 km/h;0.001 deg/s;0.0001 m/s^2"]
    (tmp_path / "log.csv").write_text("\n".join([*head, *written]))
    recording = open_recording(tmp_path / "log.csv")
    read = recording.read(list(LOGGED))
    for (name, (channel, _, _)), value in zip(LOGGED.items(), read.values(), strict=True):
        unit = find_unit(value.unit)
        assert value.values * unit.factor == pytest.approx(car.at(channel, rows[:, 0]), abs=unit.factor), name


def test_a_gear_and_a_mode_in_letters_are_no_halves_of_the_globe(rows, tmp_path):
    written = [f"{row[0]:.2f},{900 + n},N,{row[1]:.3f},E" for n, row in enumerate(rows)]
    (tmp_path / "log.csv").write_text("time,rpm,gear,speed_kmh,mode\n" + "\n".join(written))
    read = open_recording(tmp_path / "log.csv").read(["rpm", "speed_kmh"])
    assert read["rpm"].values == pytest.approx(900.0 + np.arange(len(rows)))
    assert read["speed_kmh"].values == pytest.approx(rows[:, 1], abs=1e-3)


def test_a_few_damaged_rows_are_left_out_and_not_filled_up(rows, tmp_path):
    """A lost separator moves all cells behind it into other columns."""
    written = lines_of(rows, ",")
    for n in range(10, 400, 40):
        written[n] = written[n].replace(",", "", 1)
    (tmp_path / "log.csv").write_text("time," + ",".join(LOGGED) + "\n" + "\n".join(written))
    recording = open_recording(tmp_path / "log.csv")
    assert len(recording.read(["Speed"])["Speed"].values) == len(rows) - 10
    assert any(note.count == 10 and "too few" in note.what for note in recording.notes)
