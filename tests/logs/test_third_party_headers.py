"""Headers that public programs write, filled from a known drive: games with y up, receivers of many names."""

import numpy as np
import pytest

from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.readers.opening import open_recording
from tests.logs.planted import PlantedDrive
from tests.logs.test_third_party_styles import DEG, Style, degrees_of, written


@pytest.fixture(scope="module")
def planted() -> PlantedDrive:
    return PlantedDrive(seconds=60.0)


def drafted(style: Style, planted: PlantedDrive, tmp_path):
    written(style, planted, tmp_path / "log.csv")
    return draft_map(open_recording(tmp_path / "log.csv"))


def sources(draft) -> dict[str, tuple[str, ...]]:
    return {s.channel: s.sources for s in draft.suggestions if s.status != "open"}


def height(t: np.ndarray) -> np.ndarray:
    return 120.0 + 0.02 * np.sin(0.7 * t)


def test_the_level_axes_of_a_game_are_those_that_change_though_the_path_is_long_and_narrow(planted, tmp_path):
    """X changes three times as much as z, and y is the height: the height was taken for Y, and called judged."""
    style = Style(
        lambda t, c: {
            "frame_id": np.arange(len(t)),
            "timestamp_ms": 1e3 * t,
            "pos_x": c["X"],
            "pos_y": height(t),
            "pos_z": c["Y"],
            "fwd_x": np.cos(c["yaw"]),
            "speed_kmh": 3.6 * np.hypot(c["vx"], c["vy"]),
            "steering": -c["delta"] / 0.6,
        }
    )
    draft = drafted(style, planted, tmp_path)
    assert (draft.of("X").sources, draft.of("Y").sources) == (("pos_x",), ("pos_z",))
    assert draft.of("Y").status == "unsided"


def test_a_path_that_hardly_turns_does_not_tell_which_axis_is_the_height(planted, tmp_path):
    """Along x, 5 % of it across: y and z fit the speed equally, and neither is called judged."""
    style = Style(
        lambda t, c: {
            "time": t,
            "pos_x": np.cumsum(c["vx"]) * 0.01,
            "pos_y": height(t),
            "pos_z": 0.05 * np.cumsum(c["vx"]) * 0.01,
            "speed_kmh": 3.6 * c["vx"],
        }
    )
    draft = drafted(style, planted, tmp_path)
    assert draft.of("Y").status == "assumed" and "one of them is the height" in draft.of("Y").reason


def test_a_position_without_y_has_its_other_level_axis_called_z(planted, tmp_path):
    style = Style(
        lambda t, c: {
            "Timestamp": t,
            "ParticipantID": np.full(len(t), 7),
            "PositionX": c["X"],
            "PositionZ": c["Y"],
            "Speed_KMH": 3.6 * np.hypot(c["vx"], c["vy"]),
            "SteeringInput": -c["delta"] / 0.6,
        }
    )
    draft = drafted(style, planted, tmp_path)
    assert sources(draft)["Y"] == ("PositionZ",) and "no y is recorded" in draft.of("Y").reason


def test_a_receiver_that_corrects_in_real_time_gives_a_position(planted, tmp_path):
    style = Style(
        lambda t, c: {
            "timestamp_us": 1e6 * t,
            "speed_kmh": 3.6 * c["vx"],
            "steering_angle_deg": -15.0 * DEG * c["delta"],
            "rtk_lat": degrees_of(c)[0],
            "rtk_lon": degrees_of(c)[1],
            "rtk_quality": np.full(len(t), 4),
        }
    )
    draft = drafted(style, planted, tmp_path)
    assert sources(draft)["X"] == ("rtk_lat", "rtk_lon")
    assert "and a minus sign" in draft.of("delta").reason


def test_an_arcade_car_with_y_to_the_right_is_marked_as_of_unknown_side(planted, tmp_path):
    style = Style(
        lambda t, c: {
            "time": t,
            "speed_kmh": 3.6 * np.hypot(c["vx"], c["vy"]),
            "forward_speed_kmh": 3.6 * c["vx"],
            "side_speed_kmh": -3.6 * c["vy"],
            "steering": -c["delta"] / 0.6,
            "slip_angle_deg": -DEG * np.arctan2(c["vy"], c["vx"]),
            "yaw_rate_deg_s": -DEG * c["r"],
            "up_velocity": 0.01 * np.sin(t),
        }
    )
    draft = drafted(style, planted, tmp_path)
    assert sources(draft)["vx"] == ("forward_speed_kmh",) and sources(draft)["r"] == ("yaw_rate_deg_s",)
    assert draft.of("vy").status == "unsided" and not draft.left
    assert draft.of("delta").status in ("assumed", "open")
