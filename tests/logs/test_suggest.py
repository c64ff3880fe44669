"""Twenty header styles: every channel right, or left open with its reason, never wrong in silence."""

from dataclasses import dataclass

import numpy as np
import pytest

from split_cli.logs.drafting.draft import in_ranges
from split_cli.logs.drafting.suggest import Draft, Suggestion, draft_map, render_draft
from split_cli.logs.readers.joint import JointRecording
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping, read_map
from split_cli.signals import find_unit
from split_cli.workflows.ingesting.init import init_project
from tests.logs.planted import PlantedDrive

DEG = 180.0 / np.pi
FACTORS = {
    "km/h": 3.6,
    "mph": 1 / 0.44704,
    "kn": 1 / 0.514444,
    "deg": DEG,
    "deg/s": DEG,
    "g": 1 / 9.80665,
    "ft": 1 / 0.3048,
    "%": 100.0,
    "ms": 1e3,
    "ns": 1e9,
    "bar": 1e-5,
}


@dataclass(frozen=True)
class HeaderStyle:
    """A header style: the column's title, the channel and the unit its numbers are in; a sign where it is turned."""

    name: str
    columns: tuple[tuple[str, str, str] | tuple[str, str, str, float], ...]
    separator: str = ","


def _style(name: str, columns: str) -> HeaderStyle:
    """Return a style of `title = channel unit` (and ` x factor`), parted by bars; with a semicolon, as in Germany."""
    read = []
    for column in columns.split("|"):
        title, meaning = column.strip().split(" = ")
        channel, unit = meaning.split(maxsplit=1)
        unit, *factor = unit.split(" x ")
        read.append((title, channel, unit, *map(float, factor)))
    return HeaderStyle(name, tuple(read), ";" if ";" in columns else ",")


STYLES = tuple(
    _style(name, columns)
    for name, columns in {
        "SI with brackets": """
            time [s] = t s | vx [m/s] = vx m/s | vy [m/s] = vy m/s | yaw rate [rad/s] = r rad/s |
            steering angle [rad] = delta rad | torque [Nm] = T N m""",
        "suffixes, mixed units": """
            Time_ms = t ms | speed_kph = vx km/h | lat_vel_mps = vy m/s | yaw_rate_dps = r deg/s |
            road_wheel_angle_deg = delta deg | wheel_torque_Nm = T N m | accel_x_g = ax g | accel_y_g = ay g |
            heading_deg = yaw deg | east_m = X m | north_m = Y m""",
        "camel case without units": """
            timestamp = t s | longitudinalVelocity = vx km/h | lateralVelocity = vy km/h | yawRate = r deg/s |
            posX = X m | posY = Y m | yaw = yaw rad | accelX = ax g | accelY = ay g""",
        "no units, SI": """
            t = t s | x = X m | y = Y m | psi = yaw rad | vx = vx m/s | vy = vy m/s | omega = r rad/s |
            ax = ax m/s^2 | ay = ay m/s^2 | delta = delta rad""",
        "right-handed down, no units": """
            time = t s | x = X m | y = Y m | yaw = yaw rad | u = vx m/s | v_y = vy m/s x -1 |
            yaw_rate = r rad/s x -1 | a_y = ay m/s^2 x -1 | delta_f = delta rad x -1""",
        "Bosch-like CAN names": """
            Time = t s | ESP_VehicleSpeed [km/h] = vx km/h | YawRate1 [deg/s] = r deg/s |
            LatAcc [m/s^2] = ay m/s^2 | LongAcc [m/s^2] = ax m/s^2 |
            SteeringWheelAngle [deg] = steering_wheel_angle deg | WheelSpeedFL [km/h] = wheel_speed_fl km/h""",
        "ISO 8855 words": """
            Time (s) = t s | Longitudinal velocity (m/s) = vx m/s | Lateral velocity (m/s) = vy m/s |
            Yaw velocity (rad/s) = r rad/s | Longitudinal acceleration (m/s2) = ax m/s^2 |
            Lateral acceleration (m/s2) = ay m/s^2 | Yaw angle (rad) = yaw rad""",
        "simulator state log": """
            time_ns = t ns | pose.x = X m | pose.y = Y m | pose.yaw = yaw rad | twist.vx = vx m/s |
            twist.vy = vy m/s | twist.yaw_rate = r rad/s | input.delta = delta rad""",
        "German decimal commas, semicolons": """
            Zeit;t = t s | vx_kmh = vx km/h | vy_kmh = vy km/h | psip_degps = r deg/s | ay_g = ay g |
            ax_g = ax g""",
        "American": """
            Time = t s | GPS Speed (mph) = vx mph | Gyro Z (deg/s) = r deg/s | Lat Accel (g) = ay g |
            Long Accel (g) = ax g | Pos X (ft) = X ft | Pos Y (ft) = Y ft""",
        "OxTS-like": """
            Time = t s | VelForward (m/s) = vx m/s | VelLateral (m/s) = vy m/s | AngRateZ (deg/s) = r deg/s |
            AccelX (m/s2) = ax m/s^2 | AccelY (m/s2) = ay m/s^2""",
        "no column of time": "vx_mps = vx m/s | dpsi_radps = r rad/s | psi_rad = yaw rad | ay_mps2 = ay m/s^2",
    }.items()
)


@pytest.fixture(scope="module")
def planted() -> PlantedDrive:
    return PlantedDrive(seconds=60.0)


def values_of(planted: PlantedDrive, time: np.ndarray, channel: str, unit: str, sign: float) -> np.ndarray:
    factor = FACTORS.get(unit, 1.0) * sign
    if channel == "t":
        return (time + 12.0) * factor
    if channel == "steering_wheel_angle":
        return 15.0 * planted.at("delta", time) * factor
    return planted.at(channel, time) * factor


def drafted(planted: PlantedDrive, style: HeaderStyle, tmp_path) -> tuple[Draft, dict]:
    time = np.arange(0.0, 60.0, 0.02)
    truth, columns, titles = {}, [], []
    for title, channel, unit, *sign in style.columns:
        title = title.split(style.separator)[0]
        titles.append(title)
        columns.append(values_of(planted, time, channel, unit, sign[0] if sign else 1.0))
        truth[channel] = (title, unit, sign[0] if sign else 1.0)
    rng = np.random.default_rng(3)
    noisy = [c + (0.0 if c is columns[0] else 1e-4 * np.std(c) * rng.standard_normal(len(c))) for c in columns]
    lines = [style.separator.join(titles)]
    for row in np.stack(noisy, 1):
        cells = [f"{value:.9g}" if abs(value) < 1e10 else f"{value:.0f}" for value in row]
        lines.append(style.separator.join(c.replace(".", ",") if style.separator == ";" else c for c in cells))
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines) + "\n")
    return draft_map(open_recording(path)), truth


def is_right(s: Suggestion, unit: str, sign: float) -> bool:
    """Whether a suggestion gives SI values: the factors of its unit and scale undo those of the column."""
    found = find_unit(s.unit) if s.unit else None
    factor = (found.factor if found else 1.0) * s.scale
    return factor * FACTORS.get(unit, 1.0) * sign == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize("style", STYLES, ids=lambda style: style.name)
def test_a_style_is_read_right_or_left_open_with_a_reason(planted, style, tmp_path):
    draft, truth = drafted(planted, style, tmp_path)
    right, opened = [], []
    for s in draft.suggestions:
        if s.status == "open":
            assert s.reason
            opened.append(s.channel)
            continue
        assert s.channel in truth, s
        title, unit, sign = truth[s.channel]
        assert is_right(s, unit, sign), s
        right.append(s.channel)
    wanted = set(truth) - {"t"}
    assert wanted <= set(right) | set(opened), wanted - set(right) - set(opened)
    # Left open may be what names and data cannot tell: steering without a unit, or the steering wheel's ratio, and
    # whether the car's axes or the world's are the mirrored ones.
    undecided = {"r", "vy", "ay", "yaw", "X", "Y"} if "right-handed" in style.name else set()
    assert set(opened) <= {"delta"} | undecided, opened
    # What was drafted is a map that can be read.
    path = tmp_path / "map.yaml"
    path.write_text(render_draft(draft, "log.csv"))
    assert {entry.channel for entry in read_map(path).channels} == set(right)


def entries(draft: Draft) -> dict[str, str]:
    return {s.channel: "+".join(s.sources) for s in draft.suggestions if s.status != "open"}


FOREIGN = {
    "kth_s90/S90__038.VBO": {"vx", "vy", "r", "yaw", "ax", "ay", "X", "Y", "T", "throttle", "steering_wheel_angle"},
    "genesis_slow/cpg_slow_lap.mat": {"vx", "vy", "r", "yaw", "ax", "ay", "X", "Y", "delta"},
    "av21_lvms/LVMS_23_01_04_B.csv": {"vx", "vy", "r", "yaw", "X", "Y", "delta", "throttle", "brake_pressure"},
    "tum_sim/data_to_run.csv": {"vx", "vy", "r", "ax", "ay", "delta", "T", "brake_pressure"},
    "dart/slippery_2025-04-16-17-36-01.csv": {"vx", "vy", "r", "yaw", "ax", "ay", "X", "Y", "throttle"},
    "dart/free_driving.csv": {"vx", "r", "yaw", "X", "Y", "throttle"},
    "aim_formula_ford/SummitPointFF.csv": {"vx", "ax", "ay", "delta", "throttle", "brake_pressure"},
    "motec_simulated/blakelyauto.csv": {"vx", "ax", "throttle", "brake_pressure", "wheel_speed_fl"},
}


@pytest.mark.foreign
@pytest.mark.parametrize("name", FOREIGN)
def test_foreign_recordings_are_drafted(name, datasets):
    draft = draft_map(open_recording(datasets / name))
    assert FOREIGN[name] <= set(entries(draft)), FOREIGN[name] - set(entries(draft))
    assert all(s.reason for s in draft.suggestions if s.status in ("open", "judged", "assumed"))


@pytest.mark.foreign
def test_what_decides_in_foreign_recordings(datasets):
    kth = draft_map(open_recording(datasets / "kth_s90" / "S90__038.VBO"))
    # Two yaw rates of opposite sign: whichever is taken ends up counter-clockwise positive; yaw is a compass bearing.
    assert kth.of("r").status == "judged" and kth.of("yaw").world == "ned"
    assert kth.of("delta").status == "open" and "scale: 1/RATIO" in kth.of("delta").reason
    dart = draft_map(open_recording(datasets / "dart" / "free_driving.csv"))
    assert dart.of("delta").status == "open" and "-1..1" in dart.of("delta").reason
    assert "vicon time" in dart.time
    comma = JointRecording([open_recording(path) for path in sorted((datasets / "comma2k19").glob("*.csv"))])
    assert draft_map(comma).of("course").status == "open"
    bag = datasets / "ros2_db3_no_definitions" / "rosbag2_2023_05_01-19_05_16"
    assert draft_map(open_recording(bag)).undefined
    assert map_from_mapping({"channels": entries(dart)}).channel("vx") is not None


def test_a_command_beside_a_pose_alone_is_compared_with_the_turning_of_the_path(planted, tmp_path):
    """Right-positive, in -1..1 and without a yaw rate: the draft says so, and with which scale it is an angle."""
    largest = np.max(np.abs(planted.at("delta", np.arange(0.0, 60.0, 0.02))))
    style = _style("pose", f"time = t s | X = X m | Y = Y m | yaw = yaw rad | steering = delta rad x {-1.0 / largest}")
    draft, _ = drafted(planted, style, tmp_path)
    reason = next(s.reason for s in draft.suggestions if s.channel == "delta")
    size = float(reason.split("WHEELBASE/")[1].split("`")[0])
    assert "it is right-positive; `scale: -WHEELBASE" in reason
    # What the planted car's understeer adds at speed is told apart.
    assert size * largest == pytest.approx(planted.vehicle.wheelbase, rel=0.1)


def test_elements_of_one_array_stand_as_one_name_among_what_is_not_used():
    names = ["/odom/seq", *(f"/odom/pose.covariance[{k}]" for k in range(36)), "field.cov0", "field.cov1", "gear"]
    assert in_ranges(names) == ["/odom/seq", "/odom/pose.covariance[0..35]", "field.cov0", "field.cov1", "gear"]


def test_an_angle_that_a_user_asks_for_is_a_steering_command_and_no_radian(planted, tmp_path):
    """Donkeycar's `user/angle`: a share of the lock, though its size over curvature may be a wheelbase's."""
    columns = "time = t s | enc/speed = vx m/s | imu/gyr_z = r rad/s | user/angle = delta rad x 2"
    style = _style("donkey", f"{columns} | user/mode = ay m/s^2")
    draft, _ = drafted(planted, style, tmp_path)
    steering = next(s for s in draft.suggestions if s.channel == "delta")
    assert steering.sources == ("user/angle",) and steering.status == "open"
    size = float(steering.reason.split("WHEELBASE/")[1].split("`")[0])
    assert size / 2.0 == pytest.approx(planted.vehicle.wheelbase, rel=0.35)


def test_next_steps_name_what_must_be_recorded(planted, tmp_path):
    """A sideslip gives v_y as soon as v_x is there."""
    columns = "time = t s | yaw_rate = r rad/s | sideslip = yaw rad | torque_cmd = T N m | delta_cmd = delta rad"
    style = _style("no speed", columns)
    drafted(planted, style, tmp_path)
    log = tmp_path / "log.csv"
    alone = init_project([log], tmp_path / "one").next_steps
    assert alone[0].startswith("Nothing in this log gives vx, and")
    assert "--derive lateral-velocity-from-sideslip" in alone[-1] and alone[-1].startswith("With vx")


def test_a_heading_of_a_car_that_stands_is_a_bearing_to_be_confirmed(planted, tmp_path):
    """Beside a satellite fix, 110 to 111 degrees: neither its range nor its turning shows how it is counted."""
    style = HeaderStyle(
        "standing",
        (
            ("time [s]", "t", "s"),
            ("latitude [deg]", "X", "m"),
            ("longitude [deg]", "Y", "m"),
            ("true_heading [deg]", "yaw", "deg"),
            ("speed [km/h]", "vx", "km/h"),
        ),
    )
    standing = Altered(planted, {"X": (57.1, 1e-7), "Y": (12.3, 1e-7), "yaw": (1.93, 0.01), "vx": (0.0, 0.01)})
    yaw = drafted(standing, style, tmp_path)[0].of("yaw")
    assert (yaw.status, yaw.world) == ("assumed", "ned") and "by custom" in yaw.reason


def test_a_clock_that_nobody_states_is_among_what_to_check(planted, tmp_path):
    """A table without time: the period comes from how v_x changes, and no step asked to look at it."""
    columns = "vx_mps = vx m/s | vy_mps = vy m/s | yaw_rate_radps = r rad/s | ax_mps2 = ax m/s^2 | ay_mps2 = ay m/s^2"
    drafted(planted, _style("no time", f"{columns} | delta_rad = delta rad | torque_cmd = T N m"), tmp_path)
    result = init_project([tmp_path / "log.csv"], tmp_path / "car")
    assert "# CHECK" in result.draft.time
    assert any("CHECK in" in step and ": time" in step for step in result.next_steps)


def test_a_steering_ratio_is_taken_from_the_log_with_the_least_understeer(planted, tmp_path):
    """On a log at the limit of grip angle over curvature was 1.8 times wheelbase times ratio, and that was told."""
    columns = "time = t s | X = X m | Y = Y m | yaw = yaw rad"
    logs = []
    for name, factor in (("limit", 1.8), ("gentle", 1.0)):
        folder = tmp_path / name
        folder.mkdir()
        drafted(
            planted,
            _style(name, f"{columns} | steering wheel angle [rad] = steering_wheel_angle rad x {factor}"),
            folder,
        )
        logs.append(folder / "log.csv")
    whole, best = (init_project(given, tmp_path / str(len(given))).draft for given in (logs, logs[1:]))
    reach = [s.reach for draft in (whole, best) for s in draft.all_of("delta")]
    assert reach[0] == reach[1] == pytest.approx(15.0 * planted.vehicle.wheelbase, rel=0.35)
    assert whole.of("delta") is None or str(logs[1]) in next(s.reason for s in whole.all_of("delta"))


def test_a_speed_that_the_failing_relation_blames_is_not_called_judged(planted, tmp_path):
    """A wheel's encoder reads 10 % more than the car drives: a_y against v_x r alone tolerates it."""
    style = HeaderStyle(
        "encoder",
        (
            ("time", "t", "s"),
            ("vicon x [m]", "X", "m"),
            ("vicon y [m]", "Y", "m"),
            ("vicon yaw [rad]", "yaw", "rad"),
            ("vel encoder [m/s]", "vx", "m/s"),
            ("W [rad/s]", "r", "rad/s"),
            ("acc y [m/s^2]", "ay", "m/s^2"),
        ),
    )
    right = drafted(planted, style, tmp_path)[0].of("vx")
    assert right.status == "judged"
    # a_y sides with the pose, so the speed goes. X and Y went before, for a --derive that needs them.
    draft = drafted(Altered(planted, {}, vx=1.1), style, tmp_path)[0]
    doubted = draft.of("vx")
    assert doubted.status == "open" and "v_x against the speed of X, Y 1.1" in doubted.reason
    assert {draft.of(channel).status == "open" for channel in ("X", "Y", "yaw", "r", "ay")} == {False}
    advised = init_project([tmp_path / "log.csv"], tmp_path / "car").next_steps[-1]
    assert "--derive velocity-from-pose" in advised and "accelerations" not in advised
    # From some size on the checks name it themselves.
    assert drafted(Altered(planted, {}, vx=1.15), style, tmp_path)[0].of("vx").status == "open"


class Altered:
    """A planted drive whose channels stand near a value (value, deviation), or are a factor too large."""

    def __init__(self, planted: PlantedDrive, standing: dict[str, tuple[float, float]], **factors: float) -> None:
        self._planted, self._standing, self._factors = planted, standing, factors
        self.vehicle = planted.vehicle

    def at(self, channel: str, time: np.ndarray) -> np.ndarray:
        if channel in self._standing:
            value, deviation = self._standing[channel]
            return value + deviation * np.random.default_rng(len(channel)).standard_normal(len(time))
        return self._planted.at(channel, time) * self._factors.get(channel, 1.0)
