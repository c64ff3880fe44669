"""Logs as other programs write them, from header to drive: own names, units, clocks, hands, holds and gaps.

Each style is written from a planted drive, drafted by `draft_map`, ingested with the drafted map, and compared with
what was planted. Right is a channel within the tolerance below; open is one the map leaves out with a reason.
"""

# ruff: noqa: E501

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
import yaml

from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.drafting.naming import meanings, named_by_axis
from split_cli.logs.drafting.suggest import draft_map, render_draft
from split_cli.logs.drafting.vocabulary import read_concepts, tokens_of
from split_cli.logs.raw import RawChannelInfo
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping, read_map
from tests.logs.planted import PlantedDrive

DEG = 180.0 / np.pi
G = 9.80665
LBFT = 1.3558179483314
TOLERANCES = {"vx": 0.02, "vy": 0.01, "r": 2e-3, "yaw": 2e-3, "X": 0.15, "Y": 0.15, "ax": 0.05, "ay": 0.05,
              "delta": 2e-3, "T": 40.0, "steering_wheel_angle": 0.03, "sideslip": 1e-3}  # fmt: skip
"""Of the root mean square, SI: what rounding, a hold of two samples and the drive's low-pass leave."""
Columns = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Style:
    """How another program writes: `write` returns title and values of every column from time and SI channels."""

    write: Callable[[np.ndarray, Columns], dict[str, np.ndarray]]
    opened: frozenset[str] = frozenset()
    separator: str = ","
    decimal: str = "."
    before: str = ""
    mark: bytes = b""
    rows: Callable[[int], np.ndarray] | None = None
    tolerances: Mapping[str, float] = field(default_factory=dict)
    encoding: str = "utf-8"
    quoted: bool = False
    units: tuple[str, ...] = ()


def held(values: np.ndarray, every: int) -> np.ndarray:
    return np.repeat(values[::every], every)[: len(values)]


def on_change(values: np.ndarray, every: int) -> np.ndarray:
    steps = held(values, every)
    return np.where(np.append(True, np.diff(steps) != 0.0), steps, np.nan)


def degrees_of(c: Columns) -> tuple[np.ndarray, np.ndarray]:
    """Latitude and longitude of a plane of the earth's mean radius; the drive has the ellipsoid's, 0.3 % off."""
    return 48.1 + c["Y"] / 111_194.93, 11.6 + c["X"] / (111_194.93 * np.cos(np.radians(48.1)))


def bearing(c: Columns) -> np.ndarray:
    return np.mod(90.0 - c["yaw"] * DEG, 360.0)


def text_times(t: np.ndarray, pattern: str) -> np.ndarray:
    start = datetime(2026, 3, 14, 23, 59, 40, tzinfo=UTC)
    return np.array([(start + timedelta(seconds=float(s))).strftime(pattern)[:-3] for s in t])


def quaternion(c: Columns, names: tuple[str, str, str, str]) -> dict[str, np.ndarray]:
    zero = 0.0 * c["yaw"]
    return dict(zip(names, (zero, zero, np.sin(0.5 * c["yaw"]), np.cos(0.5 * c["yaw"])), strict=True))


def shuffled(count: int) -> np.ndarray:
    rows = np.concatenate([np.arange(0, 1500), np.arange(1600, count)])
    rows[700:740] = np.random.default_rng(1).permutation(rows[700:740])
    return rows


STYLES = {
    "German words, decimal commas, BOM": Style(lambda t, c: {
        "Zeit [ms]": t * 1e3, "Geschwindigkeit [km/h]": c["vx"] * 3.6, "Quergeschwindigkeit [m/s]": c["vy"],
        "Gierrate [°/s]": c["r"] * DEG, "Gierwinkel [°]": c["yaw"] * DEG, "Querbeschleunigung [m/s²]": c["ay"],
        "Längsbeschleunigung [m/s²]": c["ax"], "Lenkradwinkel [°]": c["delta"] * 15.0 * DEG,
        "Antriebsmoment [Nm]": c["T"], "Position X [m]": c["X"], "Position Y [m]": c["Y"],
    }, frozenset({"delta"}), ";", ",", mark=b"\xef\xbb\xbf"),
    "epoch in microseconds, no units": Style(lambda t, c: {
        "timestamp": 1.7e15 + np.round(t * 1e6), "pos_x": c["X"], "pos_y": c["Y"], "heading": c["yaw"],
        "speed_x": c["vx"], "speed_y": c["vy"], "yawrate": c["r"], "steer": c["delta"], "torque": c["T"],
    }),
    "rows out of order, a gap": Style(lambda t, c: {
        "time_s": t, "v_x": c["vx"], "v_y": c["vy"], "yaw_rate": c["r"], "yaw": c["yaw"], "x": c["X"], "y": c["Y"],
        "steering_angle": c["delta"], "wheel_torque": c["T"],
    }, rows=shuffled),
    "position held at 10 Hz, commands at 50 Hz": Style(lambda t, c: {
        "t": t, "x [m]": held(c["X"], 10), "y [m]": held(c["Y"], 10), "yaw [rad]": held(c["yaw"], 10),
        "v_long [m/s]": c["vx"], "v_lat [m/s]": c["vy"], "gyro_z [deg/s]": c["r"] * DEG,
        "steer_cmd [deg]": held(c["delta"], 2) * DEG, "torque_cmd [Nm]": held(c["T"], 2),
    }),
    "published on change": Style(lambda t, c: {
        "time": t, "Vx_mps": c["vx"], "Vy_mps": c["vy"], "YawRate_radps": c["r"], "Psi_rad": c["yaw"],
        "SteerCmd_rad": on_change(c["delta"], 25), "TorqueCmd_Nm": on_change(np.round(c["T"], -2), 25),
        "E_m": on_change(c["X"], 5), "N_m": on_change(c["Y"], 5),
    }, tolerances={"delta": 0.02, "T": 150.0}),
    "satellite fix, compass, right-positive": Style(lambda t, c: {
        "UTC": text_times(t, "%Y-%m-%dT%H:%M:%S.%f"), "Latitude": degrees_of(c)[0], "Longitude": degrees_of(c)[1],
        "Speed (km/h)": c["vx"] * 3.6, "Heading (deg)": bearing(c), "Yaw Rate (deg/s)": -c["r"] * DEG,
        "Lat Acc (g)": -c["ay"] / G, "Long Acc (g)": c["ax"] / G, "Steering Angle (deg)": -c["delta"] * DEG * 14.5,
    }, frozenset({"delta"}), tolerances={"X": 2.0, "Y": 2.0}),
    "RaceChrono": Style(lambda t, c: {
        "timestamp": 1.7e9 + t, "lap_number": 1.0 + 0 * t, "elapsed_time": t, "bearing": bearing(c),
        "latitude": degrees_of(c)[0], "longitude": degrees_of(c)[1], "speed": c["vx"],
        "combined_acc": np.hypot(c["ax"], c["ay"]) / G, "lateral_acc": c["ay"] / G, "longitudinal_acc": c["ax"] / G,
        "x_rate_of_rotation": 0.1 * c["r"], "z_rate_of_rotation": c["r"] * DEG,
    }, frozenset({"course"}), before="This file is created using RaceChrono\nFormat,3\nSession title,\"Track\"\n\n",
        tolerances={"X": 2.0, "Y": 2.0}),
    "CarSim": Style(lambda t, c: {
        "Time": t, "Vx": c["vx"] * 3.6, "Vy": c["vy"] * 3.6, "AVz": c["r"] * DEG, "Yaw": c["yaw"] * DEG,
        "XCG_TM": c["X"], "YCG_TM": c["Y"], "Ax": c["ax"] / G, "Ay": c["ay"] / G, "Steer_L1": c["delta"] * DEG * 1.02,
        "Steer_R1": c["delta"] * DEG * 0.98, "Steer_SW": c["delta"] * DEG * 15.0, "My_Dr_L1": 0.2 * c["T"],
        "My_Dr_R1": 0.2 * c["T"], "My_Dr_L2": 0.3 * c["T"], "My_Dr_R2": 0.3 * c["T"],
    }),
    "IPG CarMaker": Style(lambda t, c: {
        "Time": t, "Car.vx": c["vx"], "Car.vy": c["vy"], "Car.YawRate": c["r"], "Car.Yaw": c["yaw"],
        "Car.tx": c["X"], "Car.ty": c["Y"], "Car.ax": c["ax"], "Car.ay": c["ay"], "Car.SteerAngleFL": c["delta"],
        "Car.SteerAngleFR": c["delta"], "Driver.Steer.Ang": 15.0 * c["delta"], "PT.W2W.DL_FL.Trq": 0.2 * c["T"],
    }, frozenset({"wheel_torque"})),
    "dSPACE ASM": Style(lambda t, c: {
        "time[s]": t, "v_x_Vehicle_CoG[km|h]": c["vx"] * 3.6, "v_y_Vehicle_CoG[km|h]": c["vy"] * 3.6,
        "AngVel_z_Vehicle[deg|s]": c["r"] * DEG, "Angle_Yaw_Vehicle[deg]": c["yaw"] * DEG,
        "Pos_x_Vehicle_CoorSys_E[m]": c["X"], "Pos_y_Vehicle_CoorSys_E[m]": c["Y"],
        "Angle_SteeringWheel[deg]": c["delta"] * 15.0 * DEG, "Acc_x_Vehicle_CoG[m|s2]": c["ax"],
        "Acc_y_Vehicle_CoG[m|s2]": c["ay"],
    }, frozenset({"delta"})),
    "F1TENTH gym": Style(lambda t, c: {
        "time": t, "x": c["X"], "y": c["Y"], "theta": c["yaw"], "v": np.hypot(c["vx"], c["vy"]),
        "slip_angle": np.arctan2(c["vy"], c["vx"]), "yaw_rate": c["r"], "steer_angle": c["delta"],
        "cmd_speed": c["vx"] + 0.3, "torque": c["T"],
    }),
    "TUM, yaw from north": Style(lambda t, c: {
        "# s_m": np.cumsum(c["vx"]) * 0.01, "x_m": c["X"], "y_m": c["Y"], "kappa_radpm": c["r"] / c["vx"],
        "psi_rad": np.mod(c["yaw"] + 0.5 * np.pi, 2.0 * np.pi) - np.pi, "vx_mps": c["vx"], "ax_mps2": c["ax"],
        "t_s": t, "vy_mps": c["vy"], "dpsi_radps": c["r"], "delta_rad": c["delta"], "T_Nm": c["T"],
    }, separator=";"),
    "ROS 2 fields, seconds and nanoseconds": Style(lambda t, c: {
        "header.stamp.sec": np.floor(1.7e9 + t), "header.stamp.nanosec": np.round(np.mod(t, 1.0) * 1e9),
        "pose.position.x": c["X"], "pose.position.y": c["Y"], "twist.linear.x": c["vx"], "twist.linear.y": c["vy"],
        "twist.angular.z": c["r"], "steering_tire_angle": c["delta"], "longitudinal_acceleration": c["ax"],
        "wheel_torque": c["T"], **quaternion(c, tuple(f"pose.orientation.{a}" for a in "xyzw")),
    }),
    "rostopic echo -p": Style(lambda t, c: {
        "%time": np.round((1.7e9 + t) * 1e9), "field.header.seq": np.round(t * 100.0),
        "field.pose.pose.position.x": c["X"], "field.pose.pose.position.y": c["Y"],
        **quaternion(c, tuple(f"field.pose.pose.orientation.{a}" for a in "xyzw")),
        "field.twist.twist.linear.x": c["vx"], "field.twist.twist.linear.y": c["vy"],
        "field.twist.twist.angular.z": c["r"], "field.steer": c["delta"], "field.torque": c["T"],
    }),
    "PlotJuggler": Style(lambda t, c: {
        "__time": 1.7e9 + t, "/odom/pose/pose/position/x": c["X"], "/odom/pose/pose/position/y": c["Y"],
        **quaternion(c, tuple(f"/odom/pose/pose/orientation/{a}" for a in "xyzw")),
        "/odom/twist/twist/linear/x": c["vx"], "/odom/twist/twist/linear/y": c["vy"],
        "/odom/twist/twist/angular/z": c["r"], "/drive/drive/steering_angle": c["delta"],
        "/wheels/torque_cmd/data": c["T"],
    }),
    "pandas, underscores": Style(lambda t, c: {
        "": np.arange(len(t)), "elapsed_s": t, "pose_position_x": c["X"], "pose_position_y": c["Y"],
        **quaternion(c, tuple(f"orientation_{a}" for a in "xyzw")), "linear_velocity_x": c["vx"],
        "linear_velocity_y": c["vy"], "angular_velocity_z": c["r"], "linear_acceleration_x": c["ax"],
        "linear_acceleration_y": c["ay"], "steering_angle_rad": c["delta"], "wheel_torque_nm": c["T"],
    }),
    "inertial unit, right-positive, no units": Style(lambda t, c: {
        "Time": t, "INS Vel Forwards": c["vx"], "INS Vel Lateral": -c["vy"], "INS Yaw Rate": -c["r"] * DEG,
        "INS Heading": bearing(c), "INS Acc Forwards": c["ax"], "INS Acc Lateral": -c["ay"],
        "SteerAngle": c["delta"] * DEG, "INS Pos X": c["X"], "INS Pos Y": c["Y"], "Torque Demand": c["T"],
    }),
    "textbook letters, tabs": Style(lambda t, c: {
        "t": t, "U": c["vx"], "V": c["vy"], "R": c["r"], "PSI": c["yaw"], "XG": c["X"], "YG": c["Y"],
        "DF": c["delta"], "TQ": c["T"], "AX": c["ax"], "AY": c["ay"],
    }, separator="\t"),
    "north, east, down": Style(lambda t, c: {
        "Time": t, "North": c["Y"], "East": c["X"], "Psi": np.mod(0.5 * np.pi - c["yaw"], 2.0 * np.pi), "u": c["vx"],
        "v": -c["vy"], "r": -c["r"], "ax": c["ax"], "ay": -c["ay"], "delta": -c["delta"], "T": c["T"],
    }),
    "CAN signal names, wheel torques": Style(lambda t, c: {
        "Time_s": t, "VehSpd_kph": c["vx"] * 3.6, "LatVel_mps": c["vy"], "YawRt_degps": c["r"] * DEG,
        "StrWhlAng_deg": c["delta"] * 15.0 * DEG, **{f"WhlTq_{w}_Nm": 0.25 * c["T"] for w in ("FL", "FR", "RL", "RR")},
        "LatAccel_mps2": c["ay"], "LongAccel_mps2": c["ax"],
    }, frozenset({"delta"})),
    "clocks of several sensors": Style(lambda t, c: {
        "rec_time_s": t, "gps_time_ms": np.floor(t * 10.0) * 100.0, "gps_x_m": held(c["X"], 10),
        "gps_y_m": held(c["Y"], 10), "imu_time_us": t * 1e6, "imu_yaw_rate_dps": c["r"] * DEG,
        "imu_ax_g": c["ax"] / G, "imu_ay_g": c["ay"] / G, "odo_vx_kmh": c["vx"] * 3.6, "odo_vy_kmh": c["vy"] * 3.6,
        "steer_deg": c["delta"] * DEG, "torque_Nm": c["T"],
    }),
    "American units, dates with points": Style(lambda t, c: {
        "Date Time": text_times(t, "%d.%m.%Y %H:%M:%S.%f"), "Vehicle Speed [mph]": c["vx"] / 0.44704,
        "Lateral Velocity [m/s]": c["vy"], "Yaw Rate [deg/s]": c["r"] * DEG, "Yaw Angle [deg]": c["yaw"] * DEG,
        "Road Wheel Angle Left [deg]": c["delta"] * DEG, "Road Wheel Angle Right [deg]": c["delta"] * DEG,
        "Total Wheel Torque [lbf ft]": c["T"] / LBFT, "Easting [ft]": c["X"] / 0.3048 + 1e5,
        "Northing [ft]": c["Y"] / 0.3048,
    }),
    "clock of the day": Style(lambda t, c: {
        "Time of day": text_times(t - 39.0 * 60.0, "%H:%M:%S.%f"), "Speed_kmh": c["vx"] * 3.6, "BodyVy_ms": c["vy"],
        "GyroZ_dps": c["r"] * DEG, "YawAngle_deg": c["yaw"] * DEG, "LocalX_m": c["X"], "LocalY_m": c["Y"],
        "RoadWheelAngle_deg": c["delta"] * DEG, "DriveTorque_Nm": c["T"],
    }),
    "blanks between columns, as NumPy saves": Style(lambda t, c: {
        "# t": t, "X": c["X"], "Y": c["Y"], "phi": c["yaw"], "vx": c["vx"], "vy": c["vy"], "omega": c["r"],
        "delta": c["delta"], "torque": c["T"],
    }, separator="  "),
    "decimal commas in quotes between commas": Style(lambda t, c: {
        "Time": t, "vx [m/s]": c["vx"], "vy [m/s]": c["vy"], "yaw_rate [deg/s]": c["r"] * DEG,
        "delta [deg]": c["delta"] * DEG, "T [Nm]": c["T"],
    }, decimal=",", quoted=True),
    "spreadsheet in German, another code page": Style(lambda t, c: {
        "Zeit [s]": t, "v [km/h]": c["vx"] * 3.6, "v_quer [km/h]": c["vy"] * 3.6, "Gierrate [°/s]": c["r"] * DEG,
        "Lenkwinkel [°]": c["delta"] * DEG, "Querbeschl. [g]": c["ay"] / G, "Radmoment [Nm]": c["T"],
        "Fahrer": np.full(len(t), "Müller"),
    }, separator=";", decimal=",", before="sep=;\n", encoding="cp1252"),
    "UTF-16, tabs": Style(lambda t, c: {
        "Time (s)": t, "Speed (mph)": c["vx"] / 0.44704, "Lateral speed (mph)": c["vy"] / 0.44704,
        "Yaw Rate [deg/s]": c["r"] * DEG, "Lat Acc (g)": c["ay"] / G, "Road wheel angle (deg)": c["delta"] * DEG,
        "Torque (Nm)": c["T"],
    }, separator="\t", encoding="utf-16"),
    "French": Style(lambda t, c: {
        "Temps (s)": t, "Vitesse (km/h)": c["vx"] * 3.6, "Vitesse de lacet (°/s)": c["r"] * DEG,
        "Accélération latérale (m/s²)": c["ay"], "Accélération longitudinale (m/s²)": c["ax"],
        "Angle volant (°)": c["delta"] * 15.0 * DEG, "Angle de braquage (°)": c["delta"] * DEG,
        "Couple roue (Nm)": c["T"], "Vitesse latérale (m/s)": c["vy"],
    }, separator=";", decimal=","),
    "Spanish": Style(lambda t, c: {
        "Tiempo [s]": t, "Velocidad [km/h]": c["vx"] * 3.6, "Velocidad lateral [km/h]": c["vy"] * 3.6,
        "Velocidad de guiñada [°/s]": c["r"] * DEG, "Ángulo de dirección [°]": c["delta"] * DEG, "Par [Nm]": c["T"],
    }, separator=";", decimal=","),
    "week and second of the satellites, to the right": Style(lambda t, c: {
        "GPS_Week": 2400.0 + 0.0 * t, "GPS_TOW": 345600.0 + t, "Lat_deg": degrees_of(c)[0], "Lon_deg": degrees_of(c)[1],
        "Vel_fwd_mps": c["vx"], "Vel_right_mps": -c["vy"], "AngRate_z_dps": -c["r"] * DEG, "Accel_x_mps2": c["ax"],
        "Accel_y_mps2": -c["ay"], "Heading_deg": bearing(c), "steer_rad": c["delta"],
    }, tolerances={"X": 2.0, "Y": 2.0}),
    "epoch in milliseconds under a name of its own": Style(lambda t, c: {
        "capture": np.round(1.76e12 + t * 1e3), "pos_x": c["X"], "pos_y": c["Y"], "v_lon": c["vx"], "v_lat": c["vy"],
        "yaw_deg": np.mod(c["yaw"] * DEG + 180.0, 360.0) - 180.0, "yaw_rate_dps": c["r"] * DEG,
        "steering_deg": c["delta"] * DEG, "throttle_pct": np.clip(c["T"] / 3000.0, 0.0, 1.0) * 100.0,
    }, tolerances={"throttle": 1e9}),
    "sizes with signs in columns of their own": Style(lambda t, c: {
        "timestamp": t, "ESP_v_Signal": c["vx"] * 3.6, "ESP_Gierrate": np.abs(c["r"]) * DEG,
        "ESP_VZ_Gierrate": (c["r"] < 0.0) * 1.0, "LWI_Lenkradwinkel": np.abs(c["delta"]) * 15.0 * DEG,
        "LWI_VZ_Lenkradwinkel": (c["delta"] < 0.0) * 1.0, "ESP_Querbeschleunigung": c["ay"] / G,
        "ESP_Laengsbeschl": c["ax"],
    }, frozenset({"delta"})),
    "no units at all, mph, degrees and g": Style(lambda t, c: {
        "time": t, "speed": c["vx"] / 0.44704, "lat_speed": c["vy"] / 0.44704, "yawrate": c["r"] * DEG,
        "steer": c["delta"] * DEG, "torque": c["T"], "ay": c["ay"] / G, "ax": c["ax"] / G,
    }),
    "x is north, y is east": Style(lambda t, c: {
        "t [s]": t, "x_N [m]": c["Y"], "y_E [m]": c["X"], "psi [rad]": np.angle(np.exp(1j * (0.5 * np.pi - c["yaw"]))),
        "u [m/s]": c["vx"], "v [m/s]": -c["vy"], "r [rad/s]": -c["r"], "delta [rad]": -c["delta"], "torque [Nm]": c["T"],
    }),
    "a game, x to the right": Style(lambda t, c: {
        "iCurrentTime": np.round(t * 1e3), "speedKmh": c["vx"] * 3.6, "localVelocity_x": -c["vy"],
        "localVelocity_y": 0.0 * t, "localVelocity_z": c["vx"], "localAngularVelocity_y": -c["r"],
        "steerAngle": -c["delta"] * 15.0 / 7.85,
    }, frozenset({"vy", "delta"})),
    "held at 10 Hz, required ones too": Style(lambda t, c: {
        "t": t, "gps_speed [m/s]": held(c["vx"], 10), "gps_heading [deg]": held(bearing(c), 10),
        "lat": held(degrees_of(c)[0], 10), "lon": held(degrees_of(c)[1], 10), "imu_yaw_rate [rad/s]": c["r"],
        "steer_angle [rad]": c["delta"], "vy_est [m/s]": c["vy"], "torque [Nm]": c["T"],
    }, tolerances={"X": 2.0, "Y": 2.0}),
    "phone, months by name": Style(lambda t, c: {
        "Device Time": text_times(t, "%d-%b-%Y %H:%M:%S.%f"), "Longitude": degrees_of(c)[1], "Latitude": degrees_of(c)[0],
        "GPS Speed (Meters/second)": c["vx"], "Bearing": bearing(c), "G(x)": c["ay"] / G, "G(y)": c["ax"] / G,
    }, frozenset({"course"}), tolerances={"X": 2.0, "Y": 2.0}),
    "RaceCapture, unit and range in the title, x to the right": Style(lambda t, c: {
        'Interval|"ms"|0|0|1': np.round(t * 1e3), 'AccelX|"G"|-3.0|3.0|50': c["ay"] / G,
        'AccelY|"G"|-3.0|3.0|50': c["ax"] / G, 'Yaw|"Deg/Sec"|-120|120|50': c["r"] * DEG,
        'Latitude|"Degrees"|-180|180|10': degrees_of(c)[0], 'Longitude|"Degrees"|-180|180|10': degrees_of(c)[1],
        'Speed|"kph"|0|240|10': c["vx"] * 3.6, 'Steering|"Deg"|-360|360|50': c["delta"] * 15.0 * DEG,
    }, frozenset({"delta"}), tolerances={"X": 2.0, "Y": 2.0}),
    "Apollo, x to the right, world velocity": Style(lambda t, c: {
        "header.timestamp_sec": 1.7e9 + t, "pose.position.x": c["X"], "pose.position.y": c["Y"],
        "pose.heading": c["yaw"], "linear_acceleration_vrf.x": -c["ay"], "linear_acceleration_vrf.y": c["ax"],
        "angular_velocity_vrf.z": c["r"], "chassis.speed_mps": c["vx"],
        "chassis.steering_percentage": 200.0 * c["delta"],
    }, frozenset({"delta"})),
    "VI-grade, units in a row, millimetres": Style(lambda t, c: {
        "TIME": t, "chassis_displacements.longitudinal": c["X"], "chassis_displacements.lateral": c["Y"],
        "chassis_displacements.yaw": c["yaw"] * DEG, "chassis_velocities.longitudinal": c["vx"] * 1e3,
        "chassis_velocities.lateral": c["vy"] * 1e3, "chassis_velocities.yaw": c["r"] * DEG,
        "chassis_accelerations.lateral": c["ay"] / G, "driver_demands.steering": c["delta"] * 15.0 * DEG,
        "wheel_torque.L1": 0.5 * c["T"], "wheel_torque.R1": 0.5 * c["T"],
    }, frozenset({"delta"}), units=("s", "m", "m", "deg", "mm/s", "mm/s", "deg/s", "g", "deg", "Nm", "Nm")),
    "Chinese, in its code page": Style(lambda t, c: {
        "时间(s)": t, "车速(km/h)": c["vx"] * 3.6, "侧向速度(m/s)": c["vy"], "横摆角速度(deg/s)": c["r"] * DEG,
        "侧向加速度(g)": c["ay"] / G, "纵向加速度(m/s^2)": c["ax"], "方向盘转角(deg)": c["delta"] * 15.0 * DEG,
        "前轮转角(deg)": c["delta"] * DEG, "车轮总转矩(Nm)": c["T"], "航向角(deg)": c["yaw"] * DEG,
    }, encoding="gb18030"),
    "German letters of the field": Style(lambda t, c: {
        "Timestamp_ms": np.round(1.7e12 + t * 1e3), "v [km/h]": c["vx"] * 3.6, "vquer [m/s]": c["vy"],
        "psiPunkt [°/s]": c["r"] * DEG, "aQuer [m/s²]": c["ay"], "aLaengs [m/s²]": c["ax"],
        "Radlenkwinkel [°]": c["delta"] * DEG, "Radmoment gesamt [Nm]": c["T"],
    }, separator=";", decimal=","),
    "units in a row, driver's wheel": Style(lambda t, c: {
        "Time": t, "Vehicle Speed": c["vx"] * 3.6, "Lateral Velocity": c["vy"], "Yaw Rate": c["r"] * DEG,
        "Steering Wheel Angle": c["delta"] * 15.0 * DEG, "Lateral Acceleration": c["ay"] / G, "Wheel Torque": c["T"],
    }, frozenset({"delta"}), units=("s", "km/h", "m/s", "deg/s", "deg", "g", "Nm")),
}  # fmt: skip


def written(style: Style, planted: PlantedDrive, path) -> None:
    t = np.arange(0.0, 60.0, 0.01)
    channels = ("X", "Y", "yaw", "vx", "vy", "r", "ax", "ay", "delta", "T")
    columns = style.write(t, {name: planted.at(name, t) for name in channels})
    rows = np.arange(len(t)) if style.rows is None else style.rows(len(t))
    cells = [np.where(v == v, np.char.mod("%.16g" if np.nanmax(np.abs(v)) > 1e8 else "%.9g", v), "")
             if v.dtype.kind in "fi" else v for v in columns.values()]  # fmt: skip
    if style.decimal != ".":
        cells = [np.char.replace(column, ".", style.decimal) for column in cells]
    if style.quoted:
        cells = [np.char.add(np.char.add('"', column), '"') for column in cells]
    heads = [style.separator.join(row) for row in (columns, style.units) if row]
    lines = [*heads, *(style.separator.join(row) for row in np.stack(cells, 1)[rows])]
    path.write_bytes(style.mark + (style.before + "\n".join(lines) + "\n").encode(style.encoding))


@pytest.mark.parametrize("name", STYLES)
def test_a_third_party_log_becomes_the_drive_that_was_driven(name, planted, tmp_path):
    style = STYLES[name]
    written(style, planted, tmp_path / "log.csv")
    recording = open_recording(tmp_path / "log.csv")
    draft = draft_map(recording)
    opened = {s.channel for s in draft.suggestions if s.status == "open"}
    assert opened == style.opened
    assert all(s.reason for s in draft.suggestions if s.status == "open")
    (tmp_path / "map.yaml").write_text(render_draft(draft, "log.csv"))
    mapped = read_map(tmp_path / "map.yaml")
    have = {entry.channel for entry in mapped.channels}
    derive = [] if "T" in have else ["torque-from-acceleration"]
    if "vy" not in have:
        derive.append("lateral-velocity-from-sideslip" if "sideslip" in have else "velocity-from-pose")
    complete = "delta" in have and (not derive or "velocity-from-pose" not in derive or {"X", "Y", "yaw"} <= have)
    if not complete:
        # The user fills in the steering ratio, or has no v_y: compare what is mapped, required or not.
        compare_mapped(draft, recording, planted, style)
        return
    made = assemble_drive(recording, mapped, planted.vehicle, IngestSettings(derive=tuple(derive)))
    assert made.quality.consistency.findings == ()
    compare(made.drive.columns, planted, style, have & set(TOLERANCES))


def compare(columns: Columns, planted: PlantedDrive, style: Style, channels: set[str]) -> None:
    t = columns["t"]
    for channel in channels:
        truth = truth_of(channel, t, planted)
        error = columns[channel] - truth
        if channel in ("X", "Y", "yaw"):
            # Where the world begins is the recording's own; an optional channel may end a sample early.
            assert np.mean(np.isnan(error)) < 0.01
            error = error - np.nanmedian(error)
            if channel == "yaw":
                assert abs(np.angle(np.exp(1j * np.nanmedian(columns[channel] - truth)))) < 0.01
        rms = float(np.sqrt(np.nanmean(error[50:-50] ** 2)))
        assert rms < style.tolerances.get(channel, TOLERANCES[channel]), (channel, rms)


def truth_of(channel: str, t: np.ndarray, planted: PlantedDrive) -> np.ndarray:
    if channel == "steering_wheel_angle":
        return 15.0 * planted.at("delta", t)
    if channel == "sideslip":
        return np.arctan2(planted.at("vy", t), planted.at("vx", t))
    return planted.at(channel, t)


def compare_mapped(draft, recording, planted: PlantedDrive, style: Style) -> None:
    """Ingest with what the user fills in: the steering ratio as the draft says; what was never recorded, with 0."""
    content = yaml.safe_load(render_draft(draft, "log.csv"))
    have = set(content["channels"])
    nothing = {"source": draft.of("vx").sources[0], "scale": 1e-9}
    steer = draft.of("delta")
    if steer is not None and "delta" not in have:
        ratio = 14.5 if "Steering Angle" in steer.sources[0] else 15.0
        scale = (-1.0 if "minus sign" in steer.reason else 1.0) / ratio
        content["channels"]["delta"] = {"source": steer.sources[0], "unit": "deg", "scale": scale}
    content["channels"].setdefault("delta", {**nothing, "unit": "rad"})
    content["channels"].setdefault("vy", {**nothing, "unit": "m/s"})
    content["channels"].setdefault("r", {**nothing, "unit": "rad/s"})
    derive = () if "T" in have else ("torque-from-acceleration",)
    made = assemble_drive(recording, map_from_mapping(content), planted.vehicle, IngestSettings(derive=derive))
    compare(made.drive.columns, planted, style, have & set(TOLERANCES))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("WhlSpdFL", "wheel_speed_fl"),
        ("rear wheel speed left", "wheel_speed_rl"),
        ("Querbeschleunigung", "ay"),
        ("INS Vel Forwards", "vx"),
        ("AngVel_z_Vehicle", "r"),
        ("z_rate_of_rotation", "r"),
        ("Bremsdruck", "brake_pressure"),
        ("Driver.Steer.Ang", "steering_wheel_angle"),
        ("Steer_L1", "delta"),
        ("steering_tire_angle", "delta"),
        ("Gaspedalstellung", "throttle"),
        ("vel_x_world", None),
        ("YawRateStdDev", None),
        ("engine torque", "engine_torque"),
        ("steering torque", None),
        ("roll rate", None),
        ("pose.orientation.w", None),
        ("yaw rate error", None),
        ("vN", None),
        ("v_east", None),
        ("target speed", None),
        ("steering wheel speed", None),
        ("vertical velocity", None),
        ("yaw acceleration", None),
    ],
)
def test_the_words_of_a_name_decide_together(name, expected):
    read = read_concepts(tokens_of(name))
    assert (read[0] if read else None) == expected


def test_elements_of_vectors_of_three_are_read_as_axes_and_wheels_are_not():
    names = [f"/imu/acc[{k}]" for k in range(3)] + [f"/joints/velocity[{k}]" for k in range(3)]
    names += [f"wheel_speed[{k}]" for k in range(3)] + [f"v[{k}]" for k in range(4)] + ["gyro[2]"]
    types = {"/joints/velocity": "sensor_msgs/msg/JointState"}
    named = named_by_axis([RawChannelInfo(n, types.get(n.split("[")[0], "column"), 1) for n in names])
    assert {name: info.name for name, info in named.items()} == {
        f"/imu/acc[{k}]": f"/imu/acc.{axis}" for k, axis in enumerate("xyz")
    }
    assert [meanings(info)[0].channel for info in list(named.values())[:2]] == ["ax", "ay"]


def test_one_wheels_torque_is_not_taken_for_that_of_all(planted, tmp_path):
    style = STYLES["IPG CarMaker"]
    written(style, planted, tmp_path / "log.csv")
    draft = draft_map(open_recording(tmp_path / "log.csv"))
    assert draft.of("T") is None and "1 wheel" in draft.of("wheel_torque").reason


def test_a_mirrored_path_without_a_compass_says_that_nothing_decides(tmp_path):
    # Yaw between 14 and 52 degrees could be either: no range tells a bearing from an angle.
    style = STYLES["inertial unit, right-positive, no units"]
    written(style, PlantedDrive(seconds=60.0), tmp_path / "log.csv")
    draft = draft_map(open_recording(tmp_path / "log.csv"))
    assert "nothing recorded decides" in draft.of("X").reason
