"""Terms of the measurement that act on several channels: mounting position and angle, delays between channels.

They correct the recording and are not part of the vehicle model.
"""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from split_cli.vehicle.effects.late import Delayed
from split_cli.vehicle.effects.recording import Recording, shifted
from split_cli.vehicle.effects.search import Course, Range, Search
from split_cli.vehicle.effects.term import Mimic, Term
from split_cli.vehicle.effects.wording import Estimates, amount, late
from split_cli.vehicle.flow import Flow
from split_cli.vehicle.parameters import Vehicle

__all__ = ["SensorDelay", "SensorLeverArm", "SensorMisalignment", "SteerSignalDelay"]

_COMMANDS = ("t", "T", "delta", "s")
# Overhangs of a body before the front axle and behind the rear one, in wheelbases.
_NOSE, _TAIL = 0.35, 0.45
_FRAME = "frame"
"""Variant of a sensor whose position and yaw are wrong with it, since it makes the velocities of them."""
_INSIDE = "a velocity sensor sits within the body: overhangs of up to 0.35 and 0.45 wheelbases, judgement"
_TURNED = "judgement: a mounting that is off by more than eleven degrees is seen"
_POSITION = ("X", "Y", "yaw")
_V_Y = "position and yaw, from which v_y follows"
# [rad] half a degree, judgement: a crossfall of 2.5 %, conicity and the toe of an axle make any car move askew by
# some tenths of a degree, and so does a road that leans otherwise on another day.
_CRABS = 0.0087


class _Frame(Term):
    """A velocity sensor; in the variant `_FRAME` the tracked body frame that velocities are derived from is wrong."""

    variant_needs: ClassVar = {_FRAME: frozenset({"derived velocities"})}
    needs: ClassVar = frozenset({"lateral velocity"})
    family = "measurement"
    exported = False

    @property
    def moves_position(self) -> bool:
        """Whether position and yaw have the same fault as the velocities, so that they cannot show it."""
        return self.variant == _FRAME


class SensorLeverArm(_Frame):
    """The velocity sensor is mounted dx ahead of its stated position: recorded v_y = v_y + dx r.

    Variant ``unit``: the accelerometers sit there with it, as in an inertial unit whose place or centre of gravity
    was entered wrongly. Then a_x - dx r^2 and a_y + dx r' are recorded. Source: rigid body.
    Variant ``frame``: velocities were derived from position, and the tracked point sits there.
    Witnesses: position and yaw for v_y; a_y = v_y' + v_x r tells the variants apart.
    """

    id = "sensor_lever_arm"
    titles: ClassVar = {"": "Velocity sensor off its place"}
    variants: ClassVar = ("", "unit", _FRAME)
    variant_words: ClassVar = {"unit": "with the accelerometers", _FRAME: "of the tracked point"}
    variant_needs: ClassVar = {**_Frame.variant_needs, "unit": frozenset({"ay"})}
    units: ClassVar = {"dx": "m"}
    neutral: ClassVar = {"dx": 0.0}
    mimics: ClassVar = (
        Mimic("cg_shift+tire_stiffness", "without position and yaw", _V_Y, without=_POSITION),
        Mimic("tire_stiffness", "without position and yaw: a v_y that turns bring", _V_Y, without=_POSITION),
    )

    @classmethod
    def sizes(cls, vehicle: Vehicle) -> Mapping[str, float]:
        return {"dx": vehicle.wheelbase}

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        length = vehicle.wheelbase
        lower, upper = -vehicle.cg_to_rear_axle / length - _TAIL, vehicle.cg_to_front_axle / length + _NOSE
        return Search({"dx": Range(lower, upper, 0.002, _INSIDE)}, ({"dx": 0.02},))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        sits = {
            "": "the velocity sensor sits",
            "unit": "the velocity sensor and the accelerometers sit",
            _FRAME: "the tracked point sits",
        }[variant]
        return f"{sits} {amount(p['dx'], more='further forward', less='further back')} than stated"

    def correct(self, columns: Mapping[str, np.ndarray], recording: Recording) -> dict[str, np.ndarray]:
        """Take dx r off."""
        return self._moved(columns, recording, -self.parameters["dx"])

    def corrupt(self, columns: Mapping[str, np.ndarray], recording: Recording) -> dict[str, np.ndarray]:
        """Add dx r."""
        return self._moved(columns, recording, self.parameters["dx"])

    def _moved(self, columns: Mapping[str, np.ndarray], recording: Recording, dx: float) -> dict[str, np.ndarray]:
        r = columns["r"]
        moved = {**columns, "vy": columns["vy"] + dx * r}
        if self.variant == "unit" and "ax" in columns:
            moved["ax"] = columns["ax"] - dx * r * r
        if self.variant == "unit" and "ay" in columns:
            slope = np.zeros(len(r))
            for first, end in recording.segments:
                if end - first > 1:
                    slope[first:end] = np.gradient(r[first:end], recording.period)
            moved["ay"] = columns["ay"] + dx * slope
        return moved


class SensorMisalignment(_Frame):
    """The velocity sensor is turned counter-clockwise by `angle`: it records R(-angle) (v_x, v_y).

    Variant ``frame``: velocities were derived from position and yaw, and the tracked axis is turned by `angle`.
    """

    id = "sensor_misalignment"
    titles: ClassVar = {"": "Velocity sensor turned"}
    variants: ClassVar = ("", _FRAME)
    variant_words: ClassVar = {_FRAME: "of the tracked axis"}
    units: ClassVar = {"angle": "rad"}
    neutral: ClassVar = {"angle": 0.0}
    mimics: ClassVar = (
        Mimic("velocity_bias", "a constant angle gives the same recording", exact=True),
        Mimic("road_bank+steer_offset", "constant speed, without position", "position and yaw"),
    )

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        return Search(
            {"angle": Range(-0.2, 0.2, 0.0005, _TURNED, tolerance_without_position=_CRABS)}, ({"angle": 0.003},)
        )

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        what = "the tracked axis" if variant == _FRAME else "the velocity sensor"
        return f"{what} is turned {amount(p['angle'], more='counter-clockwise', less='clockwise')}"

    def correct(self, columns: Mapping[str, np.ndarray], recording: Recording) -> dict[str, np.ndarray]:
        """Turn the velocity back."""
        return self._turned(columns, self.parameters["angle"])

    def corrupt(self, columns: Mapping[str, np.ndarray], recording: Recording) -> dict[str, np.ndarray]:
        """Turn the velocity as the sensor does."""
        return self._turned(columns, -self.parameters["angle"])

    @staticmethod
    def _turned(columns: Mapping[str, np.ndarray], angle: float) -> dict[str, np.ndarray]:
        cosine, sine = np.cos(angle), np.sin(angle)
        vx, vy = columns["vx"], columns["vy"]
        return {**columns, "vx": cosine * vx - sine * vy, "vy": sine * vx + cosine * vy}


class _LateChannels(Delayed):
    """Recorded channels that are late by `delay` relative to the others: corrected, they move earlier."""

    family = "clock"
    on_command_clock = True
    exported = False

    @staticmethod
    def is_late(channel: str) -> bool:
        """Return whether the term moves a recorded channel."""
        raise NotImplementedError

    def correct(self, columns: Mapping[str, np.ndarray], recording: Recording) -> dict[str, np.ndarray]:
        """Move the late channels earlier."""
        return self._moved(columns, -self.parameters["delay"], recording)

    def corrupt(self, columns: Mapping[str, np.ndarray], recording: Recording) -> dict[str, np.ndarray]:
        """Move the late channels later."""
        return self._moved(columns, self.parameters["delay"], recording)

    def _moved(self, columns: Mapping[str, np.ndarray], delay: float, recording: Recording) -> dict[str, np.ndarray]:
        return {
            name: shifted(values, delay, recording) if self.is_late(name) else values
            for name, values in columns.items()
        }


class SensorDelay(_LateChannels):
    """Every measured channel is late by `delay` relative to the commands.

    There are two ways to account for it, and only one is used at a time. Either the recording is corrected
    (`correct` moves the measured channels earlier). Or the model is evaluated on the measured channels' clock
    (`actuate` takes earlier commands). The second way needs no interpolation of noisy channels.
    """

    id = "sensor_delay"
    titles: ClassVar = {"": "Sensors late"}
    late_inputs = ("T", "delta")
    needs: ClassVar = frozenset({"torque"})
    mimics: ClassVar = (
        Mimic("steer_delay+drive_delay", "two equal delays give the same recording", exact=True),
        Mimic("steer_delay", "torque that hardly changes", "a torque step"),
    )

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        return f"against the commands every measured channel is {late(p['delay'])}"

    @staticmethod
    def is_late(channel: str) -> bool:
        """Return whether a channel is measured."""
        return channel not in _COMMANDS


class SteerSignalDelay(_LateChannels):
    """The recorded steering is late relative to all other channels by `delay`.

    This is a `steer_delay` to the other side. There the wheels follow what is logged; here the log follows the
    wheels, as where the angle comes by a slower bus. The model takes delta(t + delay) and no channel is corrected.
    Source: a transport delay.
    """

    id = "steer_signal_delay"
    titles: ClassVar = {"": "Steering logged late"}
    late_inputs = ("delta",)
    mimics: ClassVar = (
        Mimic("yaw_inertia", "gentle transients: a body that turns more easily", "steer steps at two speeds"),
    )

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        return f"against all other channels the recorded steering is {late(p['delay'])}"

    @property
    def input_delays(self) -> Mapping[str, float]:
        """Delay [s] by channel, negative: what is logged later acts now."""
        return {"delta": -self.parameters["delay"]}

    def actuate(self, flow: Flow) -> None:
        """Take the steering of later."""
        flow.delta = self.delayed(flow, flow.delta, -self.parameters["delay"])

    @staticmethod
    def is_late(channel: str) -> bool:
        """Return whether a channel is the steering."""
        return channel == "delta"
