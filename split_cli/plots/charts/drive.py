"""A recording beside the motion of models: over time and distance, in the plane of accelerations, on the map."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from split_cli.logs.drive import Drive
from split_cli.plots.chart import Chart, ChartLine, thinned
from split_cli.scoring.application import Correction
from split_cli.scoring.handling.motion import free_run, measured_motion
from split_cli.scoring.handling.steering_response import WINDOW
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack

#: A model runs open-loop for so long before it is set back to the recording [s].
FREE_SECONDS = 2.0
_CHANNELS = (
    ("vx", "Longitudinal velocity v_x", "v_x [m/s]"),
    ("vy", "Lateral velocity v_y", "v_y [m/s]"),
    ("r", "Yaw rate r", "r [rad/s]"),
    ("ay", "Lateral acceleration a_y", "a_y [m/s²]"),
)
#: What the driver asks for: models get it from the recording, so only recordings are drawn.
_INPUTS = (("delta", "Input: steer angle delta", "delta [rad]"), ("T", "Input: torque at the wheels T", "T [N m]"))
_MOST_DOTS = 1500


@dataclass(frozen=True)
class Subject:
    """What is drawn beside a measured drive: another recording, or a model over the recorded inputs."""

    name: str
    role: str  # of the palette
    drive: Drive  # the recording itself, or what the model runs over
    vehicle: Vehicle | None = None  # the model; None where the drive itself is the subject
    correction: Correction | None = None  # a learned residual on top of the model
    shown: bool = True

    @cached_property
    def motion(self) -> Drive | None:
        """What it does over time: the recording, or free runs of 2 s."""
        if self.vehicle is None:
            return measured_motion(self.drive)
        return free_run(SingleTrack(self.vehicle), self.drive, FREE_SECONDS, correction=self.correction)

    @cached_property
    def lateral_motion(self) -> Drive | None:
        """What it does laterally at the recorded speed, in free runs of 8 s."""
        if self.vehicle is None:
            return measured_motion(self.drive)
        model = SingleTrack(self.vehicle)
        return free_run(model, self.drive, WINDOW, correction=self.correction, recorded_speed=True)


def drive_charts(subjects: Sequence[Subject], vehicle: Vehicle | None = None) -> tuple[Chart, ...]:
    """Return motion and inputs of all subjects over time and distance, and their accelerations."""
    moving = [(one, one.motion) for one in subjects if one.motion is not None and len(one.motion) > 1]
    if not moving:
        return ()
    modelled = any(one.vehicle is not None for one in subjects)
    note = (
        f"Models run open loop on the recorded inputs and restart from the measurement every {FREE_SECONDS:g} s. Where "
        "such a line leaves the measured one, here or below, the model gets something wrong." * modelled
    )
    recorded = [(one, motion) for one, motion in moving if one.vehicle is None]
    charts = []
    for channel, title, axis in (*_CHANNELS, *_INPUTS):
        drawn = recorded if (channel, title, axis) in _INPUTS else moving
        series = tuple(_over_time(one, motion, channel) for one, motion in drawn)
        charts.append(
            Chart(
                f"strip-{channel}",
                title,
                "time [s]",
                axis,
                series,
                note * (channel == "vx"),
                other_x="distance s [m]",
                other_first=len(recorded) > 1,
                wide=True,
                group="strips",
            )
        )
    return (*charts, _accelerations(moving, vehicle))


def _over_time(one: Subject, motion: Drive, channel: str) -> ChartLine:
    """Return a channel with a NaN between segments, so that no line spans a gap.

    What was computed from other channels is not called measured.
    """
    part = thinned(len(motion))
    at = np.flatnonzero(np.diff(motion.segment[part])) + 1
    columns = [motion["t"][part], motion[channel][part], motion["s"][part] if "s" in motion else motion["t"][part]]
    t, y, s = (np.insert(column.astype(float), at, np.nan) for column in columns)
    derived = one.vehicle is None and one.role == "measured" and one.drive.metadata.is_derived(channel)
    return ChartLine("derived" if derived else one.name, t, y, one.role, along=s, shown=one.shown)


def _accelerations(moving: Sequence[tuple[Subject, Drive]], vehicle: Vehicle | None) -> Chart:
    series = []
    for one, motion in moving:
        if one.vehicle is not None and len(moving) > 2 and one.role == "nominal":
            continue
        part = thinned(len(motion), _MOST_DOTS)
        x, y = motion["ay"][part], motion["ax"][part]
        series.append(ChartLine(one.name, x, y, one.role, "points", shown=one.shown))
    note = "Each dot is a moment: braking at the bottom, left turns on the right side."
    if vehicle is not None:
        angle = np.linspace(0.0, 2.0 * np.pi, 121)
        most = vehicle.lateral_grip
        x, y = most * np.cos(angle), most * np.sin(angle)
        series.append(ChartLine("friction ellipse of the vehicle file", x, y, "other"))
        note += " The ellipse is (D_f + D_r)/m, the peak forces of both axles together: dots near it use all grip."
    return Chart("gg", "Accelerations (GG)", "a_y, left positive [m/s²]", "a_x [m/s²]", tuple(series), note, equal=True)


def track_chart(drives: Sequence[tuple[str, str, Drive]]) -> Chart | None:
    """Return the paths of drives (name, role, drive), None where none has a position."""
    series = []
    for name, role, drive in drives:
        if not {"X", "Y"} <= set(drive.columns):
            continue
        part = thinned(len(drive))
        at = np.flatnonzero(np.diff(drive.segment[part])) + 1
        x, y = (np.insert(drive[axis][part].astype(float), at, np.nan) for axis in ("X", "Y"))
        series.append(ChartLine(name, x, y, role))
    if not series:
        return None
    note = "Where lines part, the drives took different paths." if len(series) > 1 else "The path as it was recorded."
    return Chart("path", "Track map", "X [m]", "Y [m]", tuple(series), note, equal=True)
