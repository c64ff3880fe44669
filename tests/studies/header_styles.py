"""Draft a map for each header style and each recording of others, and count right, open and wrong channels.

Example: ``SPLIT_DATASETS=FOLDER python -m tests.studies.header_styles``. Without the folder only the styles of
`tests.logs.test_suggest` are drafted. *Marked* are channels whose line says CHECK; *wrong* have another source, unit,
sign or axis than the recording's description says, and are in silence unless they are marked.
"""

import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from split_cli.logs.drafting.suggest import Draft, Suggestion, draft_map
from split_cli.logs.readers.joint import JointRecording
from split_cli.logs.readers.opening import open_recording
from split_cli.signals import find_unit
from tests.logs.planted import PlantedDrive
from tests.logs.test_suggest import STYLES, drafted, is_right

#: Per channel: source, or several; unit as `find_unit` knows it; sign; ``ned`` for a bearing.
Truth = Mapping[str, str]
_WHEELS = {f"wheel_speed_{corner.lower()}": f"{corner}whlspd [m/s]" for corner in ("FL", "FR", "RL", "RR")}
_KTH = {
    "vx": "Lng._Vel. [km/h]",
    "vy": "Lat._Vel. [km/h]",
    "yaw": "True_Head [deg] ned",
    "r": "YawRate1 [rad/s] | -YawRate [deg/s]",
    "ax": "Longacc [g] | ALgt1 [m/s^2]",
    "ay": "Latacc [g] | ALat1 [m/s^2]",
    "X": "lat+long",
    "Y": "lat+long",
    "T": "PtTqAtW_FL+PtTqAtW_FR [N m]",
    "throttle": "AccrPedlLn [%]",
    "sideslip": "Slip_Angle [deg]",
    "steering_wheel_angle": "SWA [rad]",
    **_WHEELS,
}
_DART = {
    "vx": "vel encoder [m/s]",
    "r": "W [rad/s]",
    "ax": "acc x [m/s^2]",
    "ay": "acc y [m/s^2]",
    "X": "vicon x [m]",
    "Y": "vicon y [m]",
    "yaw": "vicon yaw [rad]",
    "throttle": "throttle [1]",
}
_TUM = {
    "vx": "vx_mps [m/s]",
    "vy": "vy_mps [m/s]",
    "r": "dpsi_radps [rad/s]",
    "ax": "ax_mps2 [m/s^2]",
    "ay": "ay_mps2 [m/s^2]",
    "T": "TwheelRL_Nm+TwheelRR_Nm [N m]",
    "brake_pressure": "pBrakeF_bar+pBrakeR_bar [bar]",
    "delta": "deltawheel_rad [rad]",
}
_STATES = {f: f"states[{k}] [{u}]" for f, k, u in (("vx", 0, "m/s"), ("vy", 1, "m/s"), ("r", 2, "rad/s"))}
_STATES |= {f: f"states[{k}] [{u}]" for f, k, u in (("yaw", 5, "rad"), ("X", 6, "m"), ("Y", 7, "m"))}
_COMMA = {
    "vx": "can_83Hz.speed_mps [m/s]",
    "r": "-gyro_z_radps [rad/s]",
    "ax": "acc_x [m/s^2]",
    "ay": "-acc_y [m/s^2]",
    "X": "lat_deg+lon_deg",
    "Y": "lat_deg+lon_deg",
    "steering_wheel_angle": "steering_wheel_deg [deg]",
    **{f"wheel_speed_{corner}": f"wheel_{corner}_mps [m/s]" for corner in ("fl", "fr", "rl", "rr")},
}
RECORDINGS: dict[str, Truth] = {
    "kth_s90/S90__035.VBO": _KTH,
    "kth_s90/S90__038.VBO": _KTH,
    "kth_s90/S90__040.VBO": _KTH,
    "kth_s90/S90__040_CRLF.VBO": _KTH,
    "genesis_slow/cpg_slow_lap.mat": {
        "vx": "vx [m/s]",
        "vy": "vy [m/s]",
        "r": "wz [rad/s]",
        "yaw": "psi [rad]",
        "ax": "a_long [m/s^2]",
        "ay": "a_lat [m/s^2]",
        "X": "x [m]",
        "Y": "y [m]",
        "delta": "df [rad]",
    },
    "av21_lvms/LVMS_23_01_04_B.csv": {
        "X": "x [m]",
        "Y": "y [m]",
        "vx": "vx [m/s]",
        "vy": "vy [m/s]",
        "yaw": "phi [rad]",
        "r": "omega [rad/s]",
        "delta": "delta [rad]",
        "throttle": "throttle_ped_cmd [%]",
        "brake_pressure": "brake_ped_cmd [kPa]",
        **{f"wheel_speed_{corner}": f"wheel_{corner} [km/h]" for corner in ("fl", "fr", "rl", "rr")},
    },
    "tum_sim/data_to_run.csv": _TUM,
    "tum_sim/data_to_train_12.csv": _TUM,
    "dart/free_driving.csv": _DART,
    # Its encoder reads 15 % more than the pose moves.
    "dart/rubber_steer03_ramp.csv": {c: source for c, source in _DART.items() if c != "vx"},
    "dart/tape_tiles_steer03_ramp.csv": _DART,
    "dart/racetrack_lap_v_1.csv": _DART,
    "dart/steer_id.csv": _DART,
    "dart/sine.csv": _DART,
    "dart/slippery_2025-04-16-17-36-01.csv": {
        "X": "vicon x [m]",
        "Y": "vicon y [m]",
        "yaw": "vicon yaw [rad]",
        "r": "w [rad/s]",
        "ax": "ax body [m/s^2]",
        # Without dv_y/dt's centrifugal part the name says; by the data it is a_y.
        "ay": "ay body no centrifugal [m/s^2]",
        "vx": "vx body [m/s]",
        "vy": "vy body [m/s]",
        "throttle": "throttle [1]",
    },
    "dart/random_slow.bag": {
        "X": "/tf/transforms[0].transform.translation.x [m]",
        "Y": "/tf/transforms[0].transform.translation.y [m]",
        "yaw": "/tf/transforms[0].transform.rotation",
        "throttle": "/throttle_1/data [1]",
    },
    "autorally/mppi_states_controls5.mat": _STATES,
    "autorally/mppi_states_controls6.mat": _STATES,
    "aim_formula_ford/SummitPointFF.csv": {
        "vx": "GPS_Speed [mph]",
        "ax": "Longitudinal_a [g]",
        "ay": "Lateral_acc [g]",
        "throttle": "FF_THROTTLE [%]",
        "brake_pressure": "FBP [psi]",
        "delta": "Steering [deg]",
    },
    "motec_simulated/blakelyauto.csv": {
        "vx": "Vehicle Speed [km/h]",
        "ax": "G Force Long [g]",
        "ay": "G Force Lat [g]",
        "throttle": "Throttle Pos [%]",
        "brake_pressure": "Brake Press [bar]",
        **{f"wheel_speed_{c.lower()}": f"Wheel Speed {c} [km/h]" for c in ("FL", "FR", "RL", "RR")},
    },
    "comma2k19": _COMMA,
    "ros2_db3_no_definitions/rosbag2_2023_05_01-19_05_16": {},
}


def is_true(s: Suggestion, truth: Truth) -> bool:
    """Whether a suggestion has the source, unit, sign and axes that the recording's description says."""
    for way in truth.get(s.channel, "").split(" | "):
        source, _, rest = way.partition(" [")
        unit, _, world = rest.partition("]")
        if source.removeprefix("-") != "+".join(s.sources) or (s.scale < 0.0) != way.startswith("-"):
            continue
        known = [found.factor if (found := find_unit(u)) else 1.0 for u in (unit, s.unit or unit)]
        if known[0] == known[1] and abs(s.scale) == 1.0 and world.strip() == s.world:
            return True
    return False


def row(name: str, draft: Draft, wrong: Iterable[Suggestion]) -> str:
    """Return a line of the table."""
    wrong = list(wrong)
    taken = [s for s in draft.suggestions if s.status != "open"]
    marked = [s for s in taken if s.status == "assumed"]
    sides = [s for s in taken if s.status == "unsided"]
    opened = ", ".join(dict.fromkeys(s.channel for s in draft.suggestions if s.status == "open"))
    said = ", ".join(f"{s.channel} ({'marked' if s.status == 'assumed' else '**in silence**'})" for s in wrong)
    sure = len(taken) - len(wrong)
    return f"| {name} | {sure} | {len(marked)}, {len(sides)} | {opened} | {len(wrong)}{': ' + said if said else ''} |"


def main() -> int:
    """Run from the command line."""
    print("| header style | right | CHECK, CHECK left and right | open | wrong |\n|---|---|---|---|---|")
    planted = PlantedDrive(seconds=60.0)
    for style in STYLES:
        with tempfile.TemporaryDirectory() as folder:
            draft, truth = drafted(planted, style, Path(folder))
        taken = [s for s in draft.suggestions if s.status != "open"]
        wrong = [s for s in taken if s.channel not in truth or not is_right(s, *truth[s.channel][1:])]
        print(row(style.name, draft, wrong), flush=True)
    if not (folder := os.environ.get("SPLIT_DATASETS")):
        return 0
    for name, truth in RECORDINGS.items():
        path = Path(folder) / name
        recording = (
            JointRecording([open_recording(one) for one in sorted(path.glob("*.csv"))])
            if name == "comma2k19"
            else open_recording(path)
        )
        draft = draft_map(recording)
        taken = [s for s in draft.suggestions if s.status != "open"]
        print(row(name, draft, [s for s in taken if not is_true(s, truth)]), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
