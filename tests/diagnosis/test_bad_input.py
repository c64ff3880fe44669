"""Recordings that tell little or nothing: said so, and never a confident name."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from split_cli.diagnosis.engine import diagnose
from split_cli.diagnosis.recording.cleaning import cleaned
from split_cli.diagnosis.recording.excitation import idle
from split_cli.diagnosis.recording.screening import unfit
from split_cli.diagnosis.recording.series import build_series
from split_cli.diagnosis.search.candidates import build_candidates
from split_cli.diagnosis.search.identifiable import identifiable
from split_cli.diagnosis.statement.result import Diagnosis
from split_cli.logs.drive import Drive, DriveMetadata, read_drive
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.parameters import Vehicle, read_vehicle
from split_cli.vehicle.tire import MagicFormula
from tests.diagnosis.recordings import verdict_of
from tests.factories import make_drive, one_run, road_car

NOISE = {"X": 0.01, "Y": 0.01, "yaw": 0.001, "vx": 0.01, "vy": 0.01, "r": 0.002}


def recorded(seed: int, *, runs: int = 8, period: float = 0.02, vehicle: Vehicle | None = None, terms=()) -> Drive:
    """Return runs of 10 s of random driving with sensor noise, position and yaw from the motion itself."""
    clean = make_drive(seed, runs, 10.0, period, vehicle=vehicle, terms=terms, name=f"{seed}.parquet")
    return noisy(with_position(clean), seed)


def with_position(drive: Drive) -> Drive:
    columns = dict(drive.columns)
    for channel in ("yaw", "X", "Y"):
        columns[channel] = np.zeros(len(drive))
    for run in drive.segments():

        def summed(rate: np.ndarray) -> np.ndarray:
            return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))]) * drive.period

        vx, vy, r = (drive[channel][run] for channel in ("vx", "vy", "r"))
        yaw = summed(r)
        columns["yaw"][run] = yaw
        columns["X"][run] = summed(vx * np.cos(yaw) - vy * np.sin(yaw))
        columns["Y"][run] = summed(vx * np.sin(yaw) + vy * np.cos(yaw))
    return replace(drive, columns=columns)


def noisy(drive: Drive, seed: int) -> Drive:
    rng = np.random.default_rng(seed)
    columns = {
        name: values + NOISE.get(name, 0.0) * rng.standard_normal(len(drive)) for name, values in drive.columns.items()
    }
    return replace(drive, columns=columns)


def altered(drive: Drive, **channels: np.ndarray) -> Drive:
    return replace(drive, columns={**drive.columns, **channels})


def without(drive: Drive, *channels: str) -> Drive:
    return replace(drive, columns={k: v for k, v in drive.columns.items() if k not in channels})


def said(diagnosis: Diagnosis) -> str:
    return " ".join([diagnosis.summary, *diagnosis.not_judged])


@pytest.fixture(scope="module")
def real() -> Drive:
    return recorded(1)


@pytest.fixture(scope="module")
def simulated() -> Drive:
    return with_position(make_drive(2, 8, 10.0, 0.02, name="2.parquet"))


def assert_undecided(diagnosis: Diagnosis, *words: str) -> None:
    assert diagnosis.verdict == "undecided"
    assert diagnosis.p_value is None
    assert not diagnosis.findings
    for word in words:
        assert word in said(diagnosis)


def assert_nothing_named(diagnosis: Diagnosis) -> None:
    assert diagnosis.verdict in ("match", "undecided")
    assert not diagnosis.findings


def test_recordings_that_hardly_overlap_are_not_compared_(real):
    # Runs begin at speeds of their own.
    mean = {k: real["vx"][real.segment == k].mean() for k in np.unique(real.segment)}
    order = sorted(mean, key=mean.get)
    first, second = (real.select(np.isin(real.segment, some)) for some in (order[:2], order[-2:]))
    assert_undecided(diagnose([first], road_car(), [second]), "operating points", "drive both over")


def formula_car() -> Vehicle:
    return road_car(
        name="other",
        mass=280.0,
        yaw_inertia=120.0,
        cg_to_front_axle=0.75,
        cg_to_rear_axle=0.78,
        wheel_radius=0.23,
        front_tire=MagicFormula(12.0, 1.5, 2200.0),
        rear_tire=MagicFormula(12.0, 1.5, 2200.0),
        rolling_resistance_front=20.0,
        rolling_resistance_rear=20.0,
        max_torque=900.0,
        max_brake_torque=1200.0,
    )


def test_a_simulation_of_another_car_is_called_that(real):
    other = recorded(3, vehicle=formula_car())
    assert_undecided(diagnose([real], road_car(), [other]), "3.parquet does not fit this vehicle file")


def test_the_vehicle_file_of_another_car_is_called_that(real, simulated):
    assert_undecided(diagnose([real], formula_car(), [simulated]), "does not fit this vehicle file", "wheelbase")


def test_bundled_cars_do_not_fit_each_others_files(sample_logs: Path):
    tests = {name: read_drive(sample_logs / f"{name}_tests.parquet") for name in ("road_car", "f1tenth_car")}
    cars = {name: read_vehicle(sample_logs / f"{name}.yaml") for name in tests}
    for name, drive in tests.items():
        for car, vehicle in cars.items():
            reasons = unfit(drive, vehicle)
            assert any("does not fit" in reason for reason in reasons) == (name != car), (name, car, reasons)


def test_a_heavy_fault_of_the_same_car_is_no_other_car():
    # The most that the proof conceals, and more.
    for term in (
        CATALOGUE["steer_gain"]({"gain": 0.8}),
        CATALOGUE["mass"]({"scale": 1.4}),
        CATALOGUE["drive_gain"]({"drive_gain": 0.7, "brake_gain": 0.7}),
        CATALOGUE["friction_scale"]({"scale": 0.6}),
    ):
        assert unfit(recorded(4, terms=(term,)), road_car()) == []


def test_a_file_that_is_off_for_the_simulation_as_well_speaks_of_no_other_car(real, simulated):
    """A steering ratio 1.4 times the file's in both, and a steering that answers 0.6 in reality, as cars can."""
    real, simulated = (altered(one, delta=by * one["delta"]) for one, by in ((real, 1.4 / 0.6), (simulated, 1.4)))
    assert len(unfit(real, road_car())) == 1
    assert unfit(simulated, road_car()) == unfit(real, road_car(), simulated=[simulated]) == []
    # No steering ratio of a car is off by a factor of 2.5.
    worse = altered(real, delta=1.5 * real["delta"])
    assert len(unfit(worse, road_car(), simulated=[simulated])) == 1


def test_front_wheels_that_slide_on_ice_make_no_other_car(real):
    """On three fifths of the road the wheels are turned five times as far as the turn needs, up to 0.45 rad."""
    turned = np.where(real.segment % 5 < 3, np.clip(5.0 * real["delta"], -0.45, 0.45), real["delta"])
    assert unfit(altered(real, delta=turned), road_car()) == []


def test_a_turned_sign_is_suspected(real):
    (reason,) = unfit(altered(real, delta=-real["delta"]), road_car())
    assert "sign may be turned" in reason


def test_too_short_says_how_long_it_has_to_be(real, simulated):
    short = real.select(real["t"] < 6.0)
    assert_undecided(diagnose([short], road_car(), [simulated]), "6.0 s", "8 s are needed")


def cruising(seed: int) -> Drive:
    rng, zero, car = np.random.default_rng(seed), np.zeros(4000), road_car()
    force = car.rolling_resistance_front + car.rolling_resistance_rear + car.drag_coefficient * 400.0
    columns = {
        "X": 0.4 * np.arange(4000),
        "Y": zero,
        "yaw": zero,
        "vx": zero + 20.0,
        "T": zero + force * car.wheel_radius,
        "delta": 1e-4 * rng.standard_normal(4000),
    }
    return noisy(one_run(columns, 0.02, f"cruise{seed}.parquet"), seed)


def test_straight_constant_driving_says_what_would_show_something():
    diagnosis = diagnose([cruising(1)], road_car(), [cruising(2)])
    assert_undecided(diagnosis, "slalom", "torque steps", "coast-down")
    assert_undecided(diagnose([cruising(1)], road_car()), "slalom")


def test_straight_driving_with_a_derived_torque_shows_nothing():
    """A motorway: speed changes, and the torque with it, but it was derived from them, and nothing turns."""
    drive = cruising(1)
    wave = np.sin(0.2 * drive["t"])
    told = altered(drive, vx=drive["vx"] + 3.0 * wave, T=drive["T"] + 200.0 * wave)
    derived = DriveMetadata(kinds={"T": "derived: torque from measured a_x by the nominal model", "delta": "command"})
    assert idle([told], road_car()) == []
    (reason,) = idle([replace(told, metadata=derived)], road_car())
    assert "hardly turns" in reason and "derived" in reason and "slalom" in reason


@pytest.mark.parametrize(("hardest", "is_told"), [(0.1, False), (6.0, True)])
def test_a_whole_curve_shows_only_beyond_its_linear_part(real, hardest, is_told):
    """Up to there it is the stiffness of both axles, which has a name and a range of its own."""
    share = hardest / float(np.quantile(np.abs(real["vx"] * real["r"]), 0.99))
    slow = altered(real, **{name: share * real[name] for name in ("vy", "r", "delta")})
    assert ("friction_scale (curve)" in names_of(slow)) == is_told
    assert "tire_stiffness" in names_of(slow)


@pytest.mark.parametrize("channel", ["vx", "vy", "r", "T", "delta"])
def test_a_channel_that_never_changes_is_named(real, channel):
    (reason,) = unfit(altered(real, **{channel: np.full(len(real), real[channel].mean())}), road_car())
    assert f"{channel} never changes" in reason


def test_a_channel_that_freezes_for_a_while_is_left_out(real):
    rows = slice(1000, 1300)
    for channel in ("vx", "vy", "r"):
        values = real[channel].copy()
        values[rows] = values[1000]
        drive, notes = cleaned(altered(real, **{channel: values}))
        # Six seconds, but for the edges of runs that begin and end a second off.
        assert len(real) - len(drive) == pytest.approx(300, abs=100)
        assert channel in notes[0]


def test_straight_running_without_noise_is_no_dropout():
    drive = make_drive(5, 8, 10.0, 0.02)
    straight = (drive["t"] > 11.0) & (drive["t"] < 16.0)
    columns = {name: np.where(straight, 0.0, drive[name]) for name in ("vy", "r", "delta")}
    kept, notes = cleaned(altered(drive, **columns))
    assert len(kept) == len(drive)
    assert notes == ()


def with_holes(values: np.ndarray) -> np.ndarray:
    values = values.copy()
    values[600:640], values[2200] = np.nan, np.inf
    return values


def test_samples_without_a_number_are_left_out_and_counted(real):
    drive, notes = cleaned(altered(real, vy=with_holes(real["vy"])))
    assert len(real) - len(drive) == 41
    assert len(drive.segments()) == len(real.segments()) + 2
    assert "41 samples without a number in vy" in notes[0]


def test_a_jump_of_the_speed_that_no_tyres_make_is_left_out_with_a_fifth_of_a_second_about_it(real):
    vx = real["vx"] + 60.0 * (np.arange(len(real)) % 1000 == 700)
    drive, notes = cleaned(altered(real, vx=vx), vehicle=road_car())
    assert len(real) - len(drive) == pytest.approx(4 * 21, abs=4) and "about jumps of the speed" in notes[0]
    assert cleaned(real, vehicle=road_car())[1] == ()


def test_a_simulation_of_less_than_ten_seconds_tells_nothing(real):
    said = diagnose([real], road_car(), [recorded(2, runs=1).select(np.arange(450))])
    assert said.verdict == "undecided" and "250 are needed" in said.summary


def jumping(time: np.ndarray) -> np.ndarray:
    return time + 3.0 * (np.arange(len(time)) > 1800) - 40.0 * (np.arange(len(time)) > 3000)


def test_nothing_is_computed_across_a_jump_of_the_clock(real):
    drive, notes = cleaned(altered(real, t=jumping(real["t"])))
    assert len(drive.segments()) == len(real.segments()) + 2
    assert "2 jumps of the clock" in notes[0]


def test_what_is_left_out_is_told_and_brings_no_name(real, simulated):
    """Everything at once: a frozen channel, samples without a number, jumps of the clock and a lost position."""
    vy = np.where((real["t"] > 22.0) & (real["t"] < 30.0), real["vy"][1000], with_holes(real["vy"]))
    x = real["X"].copy()
    x[3500:3700] = np.nan
    diagnosis = verdict_of([altered(real, t=jumping(real["t"]), vy=vy, X=x)], road_car(), [simulated])
    assert_nothing_named(diagnosis)
    told = (
        "vy stands still",
        "41 samples",
        "jumps of the clock",
        "not known for 4.0 s",
        "position and yaw are missing",
    )
    for words in told:
        assert words in said(diagnosis)


def test_the_rates_of_simulation_and_reality_need_not_agree(simulated):
    """At 50 Hz against real drives of twice and of half that."""
    real = [recorded(1, runs=4, period=0.01), recorded(4, runs=4, period=0.04)]
    diagnosis = verdict_of(real, road_car(), [simulated])
    assert diagnosis.verdict == "match", said(diagnosis)
    assert diagnosis.compared_share > 0.5


def names_of(drive: Drive, *simulated: Drive) -> set[str]:
    series, *others = (build_series(one, "real", np.cumsum(one["vx"]) * one.period) for one in (drive, *simulated))
    several = identifiable(build_candidates(road_car(), series), [series], road_car(), simulated=others)
    return {one.label for one in several}


def test_no_grade_is_told_where_torque_comes_from_pedals(real):
    """A wrong map of them looks like one; what turns with the wheels has no place, and is told."""
    kinds = {"T": "derived: torque from throttle by a map to 900 N m and brake times 1 N m a unit"}
    by_pedals = replace(real, metadata=replace(real.metadata, kinds=kinds))
    assert names_of(real) - names_of(by_pedals) == {"road_grade (wave)", "road_grade (stretch)"}


def test_places_and_wind_are_told_with_position_only(real):
    with_it, without_it = names_of(real), names_of(without(real, "X", "Y"))
    lost = with_it - without_it
    places = {"wind", "friction_patch", "road_grade", "road_bank"}
    known_by_position = {"velocity_bias", "yaw_rate_bias", "speed_scale", "yaw_rate_scale", "channel_delay"}
    assert {label.split()[0] for label in lost} == places | known_by_position
    assert "road_bank" in without_it
    assert "sensor_misalignment" in without_it


def test_scales_are_told_without_position_where_both_recordings_have_a_y(real, simulated):
    scales = {"speed_scale", "speed_scale (vx)", "yaw_rate_scale"}
    here, there = (without(one, "X", "Y") for one in (real, simulated))
    felt, also = (altered(one, ay=one["vx"] * one["r"]) for one in (here, there))
    assert scales <= names_of(felt, also)
    assert "yaw_rate_bias" in names_of(felt)
    for pair in ((felt,), (felt, there), (here, also)):
        assert not scales & names_of(*pair)


def test_derived_torque_tells_nothing_along_the_car(real, simulated):
    derived = DriveMetadata(kinds={"T": "derived: torque from measured a_x", "delta": "command"})
    lost = names_of(real) - names_of(replace(real, metadata=derived))
    assert {label.split()[0] for label in lost} >= {"drive_gain", "aero_drag", "rolling_resistance", "road_grade"}
    # A fault of the torque that is in the recording only because it was derived wrongly.
    scaled = replace(altered(real, T=0.9 * real["T"]), metadata=derived)
    diagnosis = verdict_of([scaled], road_car(), [simulated])
    assert_nothing_named(diagnosis)
    assert "torque is derived" in said(diagnosis)


def test_position_that_is_lost_is_not_used(real):
    x = real["X"].copy()
    x[100:105] = np.nan
    filled, notes = cleaned(altered(real, X=x))
    assert notes == ()
    np.testing.assert_allclose(filled["X"][100:105], real["X"][100:105], atol=0.1)
    x[1000:1200] = np.nan
    bare, notes = cleaned(altered(real, X=x))
    assert not bare.has_position
    assert "not known for 4.0 s" in notes[0]
    late = real["t"] > 40.0
    still, notes = cleaned(altered(real, X=np.where(late, 1.0, real["X"]), Y=np.where(late, 2.0, real["Y"])))
    assert not still.has_position
    assert "stands still" in notes[0]


def test_too_few_samples_a_second(real):
    slow = real.select(np.arange(len(real)) % 10 == 0)
    slow = replace(slow, period=0.2, segment=np.zeros(len(slow), dtype=np.int32))
    assert "5 samples a second" in unfit(slow, road_car())[0]


class TestWheelThatIsHeld:
    """Circles are driven with the wheel held on purpose; a recording that lost its steer angle is none."""

    @staticmethod
    def circle(yaw_rate_beside_speed: float) -> Drive:
        t = 0.01 * np.arange(6000)
        speed = 5.0 + 4.0 * np.sin(2.0 * np.pi * t / 50.0)
        # An understeering car: r = delta v/(L + K v^2), and what a driver would add to it with his hands.
        rate = 0.08 * speed / (2.7 + 0.01 * speed**2)
        rate = rate + yaw_rate_beside_speed * np.sin(2.0 * np.pi * t / 7.0)
        steer = np.where(t < 1.0, 0.0, 0.08)
        columns = {"t": t, "vx": speed, "vy": 0.9 * rate, "r": rate, "T": 50.0 * np.sin(t), "delta": steer}
        return one_run(columns, 0.01, "circle")

    def test_a_circle_is_kept_whole_and_a_lost_steer_angle_is_left_out(self):
        kept, notes = cleaned(self.circle(0.0))
        assert len(kept) == 6000 and notes == ()
        left, notes = cleaned(self.circle(0.2))
        assert len(left) < 200 and "delta stands still while the car turns" in notes[0]


class TestSpeedThatIsHeld:
    """A simulated car's controller holds its speed exactly; a frozen sensor does so while the path goes on."""

    @staticmethod
    def slalom(*, braking: bool) -> Drive:
        """Return 40 s that begin at rest, with a v_x that stays at 6 m/s from 8 s on, and its path."""
        t = 0.02 * np.arange(2000)
        speed = np.clip(2.0 * (t - 5.0), 0.0, 6.0)
        true = speed - (2.0 * np.sin(0.5 * t) ** 2 if braking else 0.0) * (t > 8.0)
        rate = 0.8 * np.sin(2.0 * t) * (t > 5.0)
        yaw = np.cumsum(rate) * 0.02
        columns = {
            "t": t,
            "vx": speed,
            "vy": -0.2 * rate,
            "r": rate,
            "T": np.sin(t),
            "delta": 0.3 * rate,
            "yaw": yaw,
            "X": np.cumsum(true * np.cos(yaw)) * 0.02,
            "Y": np.cumsum(true * np.sin(yaw)) * 0.02,
        }
        return one_run(columns, 0.02, "slalom")

    def test_what_the_path_confirms_is_kept_with_the_position_of_a_car_at_rest(self):
        kept, notes = cleaned(self.slalom(braking=False))
        assert notes == () and len(kept) == 2000 and kept.has_position

    def test_what_the_path_contradicts_is_left_out(self):
        left, notes = cleaned(self.slalom(braking=True))
        assert len(left) < 600 and "vx stands still while the car turns" in notes[0]
