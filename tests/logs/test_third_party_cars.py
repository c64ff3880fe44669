"""Logs of production and model cars: wheel speeds only, messages written out flat, no clock, damaged samples."""

import numpy as np
import pytest

from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.assembling.clean import clean_series, isolated_spikes
from split_cli.logs.assembling.conversion import RawSeries
from split_cli.logs.assembling.derivation import DerivationInputs
from split_cli.logs.assembling.derivations import DERIVATIONS
from split_cli.logs.assembling.gather import row_rate_from_path
from split_cli.logs.checking.checks import NOT_RECORDED
from split_cli.logs.checking.consistency import check_consistency
from split_cli.logs.drafting.suggest import draft_map, render_draft
from split_cli.logs.raw import unit_of_time
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import read_map
from split_cli.workflows.ingesting.init import init_project
from tests.factories import one_run
from tests.logs.test_third_party_loggers import table

DEG, G = 180.0 / np.pi, 9.80665
HALF_TRACK = 0.8


@pytest.fixture(scope="module")
def driven(planted) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    t = np.arange(0.0, 59.0, 0.02)
    return t, {name: planted.at(name, t) for name in ("X", "Y", "yaw", "vx", "vy", "r", "ax", "ay", "delta", "T")}


def test_v_x_of_a_car_that_records_wheel_speeds_alone_is_that_of_the_rear_wheels(planted, driven, tmp_path):
    """The left rear wheel of a rigid car has v_x - r w/2, the right one v_x + r w/2: their mean is v_x."""
    t, c = driven
    left, right = c["vx"] - HALF_TRACK * c["r"], c["vx"] + HALF_TRACK * c["r"]
    columns = {
        "time": t,
        "VelRL (km/h)": left * 3.6,
        "VelRR (km/h)": right * 3.6,
        "delta (rad)": c["delta"],
        "yaw_rate (deg/s)": c["r"] * DEG,
        "slip_angle (deg)": np.arctan2(c["vy"], c["vx"]) * DEG,
        "wheel_torque_total (Nm)": c["T"],
    }
    draft = table(tmp_path / "obd.csv", columns)
    (tmp_path / "map.yaml").write_text(render_draft(draft, "obd.csv"))
    steps = init_project([tmp_path / "obd.csv"], tmp_path / "car").next_steps[-1]
    names = ("longitudinal-velocity-from-wheels", "lateral-velocity-from-sideslip")
    assert " --derive ".join(("", *names)).strip() in steps
    made = assemble_drive(
        open_recording(tmp_path / "obd.csv"),
        read_map(tmp_path / "map.yaml"),
        planted.vehicle,
        IngestSettings(derive=names),
    )
    rows = made.drive.columns["t"]
    # Only resampling between rows of 20 ms is left, and the rounding of the text.
    np.testing.assert_allclose(made.drive.columns["vx"], planted.at("vx", rows), atol=2e-3)
    np.testing.assert_allclose(made.drive.columns["vy"], planted.at("vy", rows), atol=2e-3)
    assert "mean speed of the rear wheels" in made.drive.metadata.kinds["vx"]


def test_v_x_of_four_wheels_is_that_of_the_axle_without_slip(planted, driven):
    """Driven rear wheels run 3 % fast, braked front wheels 3 % slow: the other axle tells v_x."""
    (t, c), car = driven, planted.vehicle
    pulls = c["T"] > 0.0
    rear = c["vx"] * np.where(pulls, 1.03, 1.0)
    front = np.hypot(c["vx"], car.wheelbase * c["r"]) * np.where(pulls, 1.0, 0.97)
    columns = {"r": c["r"]} | {f"wheel_speed_f{side}": front for side in "lr"}
    columns |= {f"wheel_speed_r{side}": rear for side in "lr"}
    inputs = DerivationInputs(columns, 0.02, [slice(0, len(t))], car, {})
    made = DERIVATIONS["longitudinal-velocity-from-wheels"].run(inputs).columns["vx"]
    error = np.abs(made - c["vx"])
    # Around T = 0 these wheels jump, and their mean tells driving from braking too late.
    assert np.quantile(error, 0.9) < 0.02 < 0.03 * c["vx"].min()


def test_wheels_of_one_axle_are_in_one_unit_though_a_circle_makes_one_of_them_slower(planted):
    """Left turns of 10 m radius alone: the left wheel in km/h rolls at 3.3 times v_x, which looks like ft/s."""
    t = np.arange(0.0, 60.0, 0.02)
    vx = 6.0 + 2.0 * np.sin(0.4 * t)
    r = vx / 10.0
    columns = {"vx": vx, "r": r}
    columns |= {f"wheel_speed_f{side}": 3.6 * (vx + hand * HALF_TRACK * r) for side, hand in (("l", -1), ("r", 1))}
    kinds = dict.fromkeys(("vy", "T", "delta"), NOT_RECORDED)
    drive = one_run(columns, 0.02, "log")
    texts = [f.text for f in check_consistency(drive, planted.vehicle, kinds).findings if "wheel" in f.channel]
    assert texts and not any("ft/s" in text for text in texts)
    assert any("km/h" in text for text in texts)


def test_without_a_judge_the_size_of_an_angle_tells_degrees(driven, tmp_path):
    """A yaw rate of 25, a steering wheel at 300: no car does that in radians, and no v_x judges them here."""
    t, c = driven
    columns = {"time": t, "VelRL": c["vx"] * 3.6, "yaw_rate": c["r"] * DEG * 1.5, "SW_pos": c["delta"] * DEG * 60.0}
    draft = table(tmp_path / "obd.csv", columns)
    assert draft.of("r").unit == "deg/s" and "no car's exceeds 15 rad/s" in draft.of("r").reason
    assert draft.of("steering_wheel_angle").unit == "deg"


def test_fields_of_messages_written_out_flat_are_told_apart_by_the_message(driven, tmp_path):
    """A converter writes x, y, z of each message after a column of the message's own, which is empty."""
    t, c = driven
    rng = np.random.default_rng(2)
    row = np.arange(len(t))
    stamp = 1_716_990_952 * 10**9 + row // 3 * 60_000_000 + row % 3 * 10_000  # written in bursts of three
    still = np.zeros(len(t))
    world = np.stack(
        [
            c["vx"] * np.cos(c["yaw"]) - c["vy"] * np.sin(c["yaw"]),
            c["vx"] * np.sin(c["yaw"]) + c["vy"] * np.cos(c["yaw"]),
        ]
    )
    gnss, ins = world + rng.normal(0.0, 0.03, world.shape), world
    columns = [
        ("bagTimestamp", stamp),
        ("stamp", None),
        ("secs", still + 316.0),
        ("nsecs", still + 2.5e9),
        ("acc_body", None),
        ("x", c["ax"] / G),
        ("y", c["ay"] / G),
        ("z", still + 1.0),
        ("rate_body", None),
        ("x", rng.normal(0.0, 0.1, len(t))),
        ("y", rng.normal(0.0, 0.1, len(t))),
        ("z", c["r"] * DEG),
        ("gnss_vel_frame", None),
        ("x", gnss[0]),
        ("y", gnss[1]),
        ("z", still),
        ("ins_vel_frame", None),
        ("x", ins[0]),
        ("y", ins[1]),
        ("z", still),
        ("ext_vel_x", c["vx"]),
        ("pos_rel_x", c["X"]),
        ("pos_rel_y", c["Y"]),
        ("ins_yaw", c["yaw"] * DEG),
    ]
    lines = [",".join(name for name, _ in columns)]
    for k in range(len(t)):
        lines.append(",".join("" if values is None else repr(values[k].item()) for _, values in columns))
    (tmp_path / "flat.csv").write_text("\n".join(lines) + "\n")
    recording = open_recording(tmp_path / "flat.csv")
    names = [info.name for info in recording.channels()]
    assert {"acc_body.x", "rate_body.z", "ins_vel_frame.y", "ext_vel_x"} <= set(names) and "x" not in names
    draft = draft_map(recording)
    assert draft.time.startswith("time: {source: bagTimestamp, unit: ns}"), "a stamp of 2.5e9 ns is none"
    assert draft.of("r").sources == ("rate_body.z",) and draft.of("r").unit == "deg/s"
    # Both velocities of the world are left out, one after the other, and what is left judges all others.
    assert draft.of("vx").sources == ("ext_vel_x",) and draft.of("vx").status in ("judged", "unsided")
    assert {draft.of("ax").unit, draft.of("ay").unit} == {"g"}


def test_nanoseconds_since_1970_tell_their_unit_in_bursts_and_other_clocks_by_their_steps():
    burst = 1.7e18 + np.repeat(np.arange(40.0) * 5e7, 3) + np.tile([0.0, 1e4, 2e4], 40)
    assert unit_of_time(burst) == "ns"
    assert unit_of_time(1.7e9 + np.arange(50.0) * 0.01) == "s"
    assert unit_of_time(1.7e12 + np.arange(50.0) * 10.0) == "ms"


def test_a_path_and_a_speed_tell_the_rate_of_rows_without_time(driven, tmp_path):
    t, c = driven
    assert row_rate_from_path(c["X"], c["Y"], c["vx"]) == pytest.approx(50.0, rel=0.01)
    still = np.zeros_like(t)
    assert row_rate_from_path(still, still, c["vx"]) is None
    assert row_rate_from_path(c["X"], c["Y"], np.random.default_rng(1).permutation(c["vx"])) is None
    draft = table(tmp_path / "model.csv", {"X": c["X"], "Y": c["Y"], "vx": c["vx"], "throttle": 0.5 + still + 0.1 * t})
    assert draft.time.startswith("time: {period: 0.02") and "a few per cent are open" in draft.time


def test_spikes_that_are_more_than_a_hundredth_of_a_signal_do_not_hide_each_other(driven):
    """The scale of a signal's roughness is a quantile, which three damaged samples of a hundred would move."""
    t, c = driven
    rng = np.random.default_rng(4)
    r = c["r"] + rng.normal(0.0, 0.02, len(t))
    damaged = np.sort(rng.choice(np.arange(10, len(t) - 10, 4), len(t) // 33, replace=False))
    spiked = r.copy()
    spiked[damaged] += rng.choice([-1.0, 1.0], len(damaged)) * rng.uniform(100.0, 900.0, len(damaged))
    np.testing.assert_array_equal(np.flatnonzero(isolated_spikes(spiked)), damaged)
    assert not isolated_spikes(r).any()
    # A brake that is mostly at rest is pressed for two samples now and then: no damage.
    taps = np.where(np.arange(len(t)) % 50 < 2, 3.0, 0.0)
    assert not isolated_spikes(taps).any()


def test_what_no_car_reaches_is_dropped_and_counted_unless_it_is_the_unit(driven):
    t, c = driven
    r = c["r"].copy()
    r[500:504] = [40.0, 300.0, 300.0, 90.0]  # too long for a spike
    cleaned = clean_series(RawSeries("r", "gyro", t, r))
    assert {d.reason: d.count for d in cleaned.drops} == {"beyond what any car reaches, and far beyond the others": 4}
    # In degrees nearly all are as large: then the unit is wrong, and every sample stays to show it.
    assert clean_series(RawSeries("r", "gyro", t, c["r"] * DEG * 3.0)).drops == ()


def test_damaged_samples_are_no_wrong_unit(planted, driven):
    """Some of a yaw rate in rad/s jump to 300: the 99 % quantile is theirs, the unit is that of all others."""
    t, c = driven
    damaged = c["r"].copy()
    damaged[np.arange(len(t)) % 400 < 4] = 300.0
    kinds = dict.fromkeys(("vy", "T", "delta"), NOT_RECORDED)

    def findings(r):
        drive = one_run({"vx": c["vx"], "r": r}, 0.02, "log")
        return [f.text for f in check_consistency(drive, planted.vehicle, kinds).findings]

    assert not any("deg/s" in text for text in findings(damaged))
    assert any("deg/s" in text for text in findings(c["r"] * DEG * 1.5))
