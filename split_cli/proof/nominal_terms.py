"""Catalogue terms that are put into a nominal car: the direction of each, and whether its sign is drawn."""

NOMINAL_TERMS: dict[str, tuple[dict[str, float], bool]] = {
    "combined_slip": ({"strength": 0.5}, False),
    "friction_scale": ({"scale": 0.1}, True),
    "tire_relaxation": ({"length": 0.3}, False),
    "load_transfer": ({"cg_height": 0.4}, False),
    "tire_stiffness": ({"front_scale": 0.1, "rear_scale": -0.06}, True),
    "aero_downforce": ({"front": 1.0, "rear": 1.6}, False),
    "aero_drag": ({"drag": 0.4}, False),
    "road_bank": ({"angle": 0.02}, True),
    "drive_gain": ({"drive_gain": 0.1, "brake_gain": 0.05}, True),
    "drive_lag": ({"tau": 0.06}, False),
    "drive_delay": ({"delay": 0.04}, False),
    "rolling_resistance": ({"force": 250.0}, False),
    "yaw_moment_differential": ({"yaw_damping": 2000.0}, False),
    "steer_offset": ({"offset": 0.005}, True),
    "steer_gain": ({"gain": 0.05}, True),
    "steer_delay": ({"delay": 0.03}, False),
    "steer_lag": ({"tau": 0.03}, False),
    "steer_backlash": ({"width": 0.008}, False),
    "mass": ({"scale": 0.1}, True),
    "yaw_inertia": ({"scale": 0.15}, True),
    "cg_shift": ({"dx": 0.08}, True),
    "sensor_lever_arm": ({"dx": 0.3}, True),
    "sensor_misalignment": ({"angle": 0.01}, True),
    "sensor_delay": ({"delay": 0.03}, False),
}
"""By id: a step from neutral in each parameter [its unit], scaled until it has the wanted effect-to-noise ratio, and
whether its sign is drawn. Terms of place and time are left out: a scripted drive has no laps."""
