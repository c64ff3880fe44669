"""Yaw rate from the lateral acceleration: a planted car without a gyro, and what is said of such a drive."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from split_cli.diagnosis.recording.screening import unfit
from split_cli.errors import DriveError, MapError
from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.assembling.derivation import DerivationInputs
from split_cli.logs.assembling.derivations import derivation_named, derivations_for
from split_cli.logs.assembling.turning import turning_of_measured_lateral_velocity, turning_of_rear_tires
from split_cli.logs.drive import write_drive
from split_cli.plots.charts.tires import tire_charts
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.calibrate import calibrate_files
from split_cli.workflows.evaluation_notes import derived_states
from split_cli.workflows.report.recording import recording_page
from tests.factories import road_car
from tests.logs.planted import PlantedDrive, planted_map

CAR = road_car()
PERIOD = 0.02
NAME = "yaw-rate-from-lateral-acceleration"


def _driven(seconds: float = 40.0) -> dict[str, np.ndarray]:
    """Return a single track with the rear tyres of the file, and a front force that no tyre of the file makes.

    The front force is written down and not a tyre's, so the truth needs no front tyre and no steering.
    """
    t = np.arange(0.0, seconds, PERIOD)
    speed, tire = (lambda s: 22.0 + 4.0 * np.sin(0.2 * s)), CAR.rear_tire
    gate = lambda s: np.minimum(s / 3.0, 1.0)  # noqa: E731
    front = lambda s: gate(s) * (2600.0 * np.sin(0.9 * s) + 900.0 * np.sin(4.0 * s))  # noqa: E731

    def rear(s: float, vy: float, r: float) -> float:
        slip = -np.arctan((vy - CAR.cg_to_rear_axle * r) / speed(s))
        return tire.D * np.sin(tire.C * np.arctan(tire.B * slip))

    def rates(s: float, x: np.ndarray) -> list[float]:
        force = rear(s, *x)
        turned = front(s) * CAR.cg_to_front_axle - force * CAR.cg_to_rear_axle
        return [(front(s) + force) / CAR.mass - speed(s) * x[1], turned / CAR.yaw_inertia]

    vy, r = solve_ivp(rates, (0.0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-10).y
    ay = np.array([(front(s) + rear(s, a, b)) / CAR.mass for s, a, b in zip(t, vy, r, strict=True)])
    return {"t": t, "vx": speed(t), "vy": vy, "r": r, "ay": ay}


DRIVEN = _driven()
WHOLE = [slice(0, len(DRIVEN["t"]))]


def _given(*names: str, **changed: np.ndarray) -> dict[str, np.ndarray]:
    return {name: DRIVEN[name] for name in names} | changed


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(error**2)))


def test_rear_tires_of_the_file_give_the_yaw_rate_and_the_sideslip_of_their_car():
    made = turning_of_rear_tires(_given("vx", "ay"), PERIOD, WHOLE, CAR)
    plain = DRIVEN["ay"] / DRIVEN["vx"]
    # Left is what straight lines between samples of a_y miss, h^2 w^2/12 of it: 0.05 % at 4 rad/s.
    assert _rms(made.r - DRIVEN["r"]) < 2e-3 * _rms(DRIVEN["r"])
    assert _rms(made.vy - DRIVEN["vy"]) < 2e-3 * _rms(DRIVEN["vy"])
    assert _rms(plain - DRIVEN["r"]) > 0.1 * _rms(DRIVEN["r"])  # the usual a_y/v_x, beside it
    assert made.beyond == made.slow == 0.0


def test_a_wrong_rear_tire_is_wrong_sideslip_and_hardly_wrong_yaw_rate():
    """What cannot be seen must be said: half the stiffness doubles the slip of the rear axle, and nothing objects."""
    softer = replace(CAR, rear_tire=replace(CAR.rear_tire, B=0.5 * CAR.rear_tire.B))
    made = turning_of_rear_tires(_given("vx", "ay"), PERIOD, WHOLE, softer)
    assert _rms(made.r - DRIVEN["r"]) < 0.35 * _rms(DRIVEN["r"])
    assert _rms(made.vy - DRIVEN["vy"]) > 0.5 * _rms(DRIVEN["vy"])


def test_with_a_measured_lateral_velocity_no_tire_is_needed():
    softer = replace(CAR, rear_tire=replace(CAR.rear_tire, B=0.5 * CAR.rear_tire.B))
    made = turning_of_measured_lateral_velocity(_given("vx", "vy", "ay"), PERIOD, WHOLE, softer)
    assert _rms((made.r - DRIVEN["r"])[10:-10]) < 2e-3 * _rms(DRIVEN["r"])


def test_a_wrong_guess_at_the_start_is_left_out_and_forgotten():
    late = 330  # in the middle of a turn, where the car is not steady
    segments = [slice(0, late), slice(late, WHOLE[0].stop)]
    made = turning_of_rear_tires(_given("vx", "ay"), PERIOD, segments, CAR)
    lost = np.flatnonzero(np.isnan(made.r[late:]))
    assert 0 < len(lost) * PERIOD < 2.0 and lost[-1] == len(lost) - 1
    kept = late + len(lost)
    # After three time constants 5 % of the wrong guess are left.
    assert abs(made.r[kept] - DRIVEN["r"][kept]) < 0.02
    assert _rms(made.r[kept + 100 :] - DRIVEN["r"][kept + 100 :]) < 2e-3 * _rms(DRIVEN["r"])


def test_rows_beyond_the_rear_tires_slow_ones_and_spikes_are_left_out():
    ay, vx = DRIVEN["ay"].copy(), DRIVEN["vx"].copy()
    ay[800:850] = 14.0
    vx[1200:1250] = 0.5
    ay[1500] = 300.0  # no car's
    made = turning_of_rear_tires({"vx": vx, "ay": ay}, PERIOD, WHOLE, CAR)
    assert np.isnan(made.r[845]) and np.isnan(made.r[1200:1250]).all() and np.isnan(made.r[1500])
    assert made.beyond > 0.0 and made.slow == pytest.approx(51 / len(ay))
    assert np.abs(made.r[1000:1190] - DRIVEN["r"][1000:1190]).max() < 5e-3  # and it comes back to the truth
    nowhere = DerivationInputs({"vx": 0.0 * vx, "ay": ay}, PERIOD, WHOLE, CAR, {})
    with pytest.raises(MapError, match="finds no row to use: 100 % slower than"):
        derivation_named(NAME).run(nowhere)


def test_a_path_gives_the_lateral_acceleration_that_its_yaw_rate_takes():
    t = np.arange(0.0, 30.0, 0.05)
    noise = np.random.default_rng(0).normal(0.0, 0.01, (2, len(t)))
    X, Y = 50.0 * np.cos(0.3 * t) + noise[0], 50.0 * np.sin(0.3 * t) + noise[1]
    path = DerivationInputs({"X": X, "Y": Y}, 0.05, [slice(0, len(t))], None, {})
    ay = derivation_named("lateral-acceleration-from-path").run(path).columns["ay"]
    assert ay[20:-20] == pytest.approx(50.0 * 0.3**2, rel=0.05)


@pytest.mark.parametrize(
    ("mapped", "asked"),
    [
        ({"vx", "ay", "delta"}, [NAME]),
        ({"vx", "vy", "ay", "delta"}, [NAME]),
        ({"vx", "X", "Y", "delta"}, ["lateral-acceleration-from-path", NAME]),
        ({"vx", "yaw", "ay", "delta"}, ["yaw-rate-from-yaw", "lateral-velocity-from-accelerations"]),
        ({"vx", "r", "ay", "delta"}, ["lateral-velocity-from-accelerations"]),
        ({"vx", "X", "Y", "yaw", "ay", "delta"}, ["velocity-from-pose"]),
        ({"vx", "delta"}, []),
    ],
)
def test_it_is_asked_for_only_where_nothing_measures_how_the_body_turns(mapped, asked):
    missing = {"vx", "vy", "r", "delta", "T"} - mapped
    found = derivations_for([c for c in ("vx", "vy", "r", "T", "delta") if c in missing], mapped)
    assert found == [*asked, "torque-from-acceleration"]


def _ingested(channels: tuple[str, ...], sign: float = 1.0):
    planted = PlantedDrive()
    recording = planted.recording(channels, noise={"ay": 0.05}, altered={"ay": lambda ay: sign * ay})
    return assemble_drive(recording, planted_map(channels), planted.vehicle, IngestSettings(derive=(NAME,)))


def test_a_drive_without_a_gyro_says_so_and_is_neither_diagnosed_nor_calibrated(tmp_path):
    made = _ingested(("vx", "ay", "delta", "T"))
    drive = made.drive
    assert drive.metadata.is_derived("r") and drive.metadata.is_derived("vy")
    assert any("nothing of its sideslip" in text for text in made.quality.warnings)
    # A controller should not have it, and the map is not at fault.
    assert (
        any("no yaw rate was recorded" in text for text in drive.metadata.faults) and not drive.metadata.contradictions
    )
    # r is of a_y, so that these two agree says nothing.
    assert not any(relation.name.startswith("a_y against") for relation in made.quality.consistency.relations)
    assert "Record a gyro or a heading" in unfit(drive, CAR)[0]
    # v_y is of the model that is judged: no headline of an evaluation may be of it.
    assert "intervals of v_y say nothing" in derived_states([drive.metadata])["v_y"]
    write_drive(drive, tmp_path / "d.parquet")
    write_vehicle(CAR, tmp_path / "car.yaml")
    with pytest.raises(DriveError, match="cannot determine tyres"):
        calibrate_files([tmp_path / "d.parquet"], tmp_path / "car.yaml", None)


def test_a_measured_lateral_velocity_makes_the_yaw_rate_a_remark_and_no_fault():
    metadata = _ingested(("vx", "vy", "ay", "delta", "T")).drive.metadata
    assert metadata.is_derived("r") and not metadata.is_derived("vy")
    assert not derived_states([metadata])
    assert not metadata.faults and metadata.remarks[-1] == "no yaw rate was recorded: r follows from a_y and v_y"


def test_a_turned_sign_of_the_acceleration_is_reported_beside_the_steering():
    found = _ingested(("vx", "ay", "delta", "T"), sign=-1.0).quality.consistency.findings
    (steering,) = [f for f in found if f.channel == "delta"]
    assert "may be one of a_y instead" in steering.text


def test_a_steering_sensor_that_is_not_at_zero_is_found_without_a_gyro():
    """A Formula Ford's steering read 1.7 deg on every straight, and its channels were said to fit."""
    planted = PlantedDrive()
    channels = ("vx", "ay", "delta", "T")
    recording = planted.recording(channels, noise={"ay": 0.05}, altered={"delta": lambda delta: delta + 0.03})
    made = assemble_drive(recording, planted_map(channels), planted.vehicle, IngestSettings(derive=(NAME,)))
    (found,) = made.quality.consistency.findings
    assert found.channel == "delta" and found.measured == pytest.approx(0.03, abs=0.003)


def test_the_page_calls_derived_motion_derived():
    """The rear axle's cloud lay on its curve and was called measured."""
    drive = _ingested(("vx", "ay", "delta", "T")).drive
    front, rear, _ = tire_charts(drive, CAR)
    assert [chart.series[0].name for chart in (front, rear)] == ["derived", "derived"]
    assert "derived from it" in rear.note and "derived" not in front.note
    text = recording_page(drive, drive.metadata.quality, ())
    assert "No yaw rate was recorded" in text.split("Length")[0]


def test_a_log_of_a_satellite_receiver_alone_becomes_a_drive():
    """Course over ground is no yaw, but it is a lateral acceleration, and the rear tyres do the rest."""
    planted = PlantedDrive(seconds=90.0)
    channels = ("X", "Y", "vx", "delta", "T")
    recording = planted.recording(channels, rate=20.0, noise={"X": 0.02, "Y": 0.02, "vx": 0.02})
    settings = IngestSettings(derive=("lateral-acceleration-from-path", NAME))
    made = assemble_drive(recording, planted_map(channels), planted.vehicle, settings)
    assert not made.quality.consistency.findings and len(made.drive) > 0.9 * 90.0 * 20.0
    t = made.drive["t"] + made.quality.origin
    r, vy = planted.at("r", t), planted.at("vy", t)
    assert _rms(made.drive["r"] - r) < 0.1 * _rms(r) and _rms(made.drive["vy"] - vy) < 0.25 * _rms(vy)
