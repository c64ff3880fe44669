"""Names that loggers, buses, simulators and model cars give their channels, and the one channel each may mean."""

import pytest

from split_cli.logs.drafting.naming import meanings, named_without_source
from split_cli.logs.drafting.wheel_torques import note_on_part
from split_cli.logs.raw import RawChannelInfo
from split_cli.signals import split_name_and_unit

NAMES = {
    "ax": ("Longitudinal Acceleration (m/s^2)", "LINEALG", "car.longitudinal_acc"),
    "ay": ("state.acceleration.lateral",),
    "brake": ("carState.brakePressed",),
    # A steering that is desired is the command that is looked for.
    "delta": ("m_frontWheelsAngle", "Angle_Wheel_Front_L", "aSteer", "/eps/angle", "DesSteer", "delta_cmd"),
    "latitude": ("VBOX_Lat_Min", "Breite", "/gps/position.lat"),
    "longitude": ("VBOX_Long_Minutes", "Länge", "fix.longitude"),
    "motor_current": ("vesc_current",),
    "r": ("Rotation Z",),
    "steering_wheel_angle": ("StWhlAng\\ETKC:1",),
    "throttle": ("THRTL", "APPS1", "aps", "Accel_Pedal_Pos", "MO_Fahrpedalwert", "Motor_20::MO_Fahrpedalrohwert_01"),
    "X": ("data.Car_tx.data", "vehicle_x"),
    "axle_torque": ("AxleTrqFrntAct", "AxleTrqRrAct", "AxleTrqFr"),
    "vx": ("LongitudinalVelocity", "/ego/state/velocity.longitudinal", "speed_vesc"),
    "vy": ("/ego/state/velocity.lateral", "ESP_vq"),
    "wheel_speed_fl": (
        "ESP_19::ESP_VL_Radgeschw_02",
        "WheelAngularVelocity_FL",
        "wheels.fl.angular_velocity",
        "AVy_L1",
        "Vhcl_FL_rotv",
    ),
    "wheel_torque": ("/act/wheel_torque_nm.fl", "wheelTorque.front_left"),
    "wheel_speed_rr": ("/wheels/speed_mps.rr", "Wheel Angular Velocity Rear Right"),
    "yaw": ("rotation_yaw", "pf_theta", "Yaw", "northHeading"),
    # Desired values are not measured, a wheel spins about its lateral axis alone, and a motor's speed is no car's,
    # nor is an opponent's.
    "": (
        "tire_temp.fl",
        "vx_opp",
        "speed_opponent",
        "DesYaw",
        "desired_yaw",
        "delta_v_cmd",
        "delta_t",
        "V_cmd",
        "motor_speed",
        "AVx_L1",
        "AVz_L1",
        "accelerator_pedal_gradient_sign",
        "/gps/fix_velocity/header.seq",
        "/gps/fix_velocity/header.stamp.sec",
        "/gps/fix_velocity/header.stamp.nanosec",
    ),
}


@pytest.mark.parametrize(("name", "channel"), [(name, channel) for channel, some in NAMES.items() for name in some])
def test_a_name_means_one_channel_or_none(name, channel):
    bare, unit = split_name_and_unit(name)
    kind = "geometry_msgs/TwistStamped" if "header." in name else "column"
    assert [one.channel for one in meanings(RawChannelInfo(bare, kind, None, unit))] == ([channel] if channel else [])


def test_a_last_word_is_no_source_where_it_says_another_car_or_another_time():
    """The opponent's channels fit each other as well as the car's own do: no check tells them apart."""
    stems, words = ("x", "y", "yaw", "vx"), ("opti", "imu", "opponent", "prev", "mean", "offset")
    infos = [RawChannelInfo(f"{stem}_{word}", "column", None) for word in words for stem in stems]
    found = {info: bare.name for info, bare in named_without_source(infos).items()}
    assert found == {f"{stem}_{word}": stem for word in ("opti", "imu") for stem in stems}


def test_one_element_of_a_list_is_not_the_torque_of_the_car():
    """A message's list may hold the four wheels, and its type names only the first element."""
    assert note_on_part(("/act/torques[0]",)).startswith("the first of a list")
    assert note_on_part(("/act/torque",)) == ""
