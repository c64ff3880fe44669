"""Terms of the measurement: they correct a recording and are no part of the car."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from split_cli.vehicle.effects.recording import Recording, shifted
from split_cli.vehicle.effects.term import Mimic, Term
from split_cli.vehicle.flow import Flow

__all__ = ["SensorDelay", "SensorLeverArm", "SensorMisalignment"]

_COMMANDS = ("t", "T", "delta", "s")


class SensorLeverArm(Term):
    """A velocity sensor dx ahead of where it is said to be: recorded v_y = v_y + dx r."""

    id = "sensor_lever_arm"
    units: ClassVar = {"dx": "m"}
    neutral: ClassVar = {"dx": 0.0}
    exported = False
    mimics: ClassVar = (
        Mimic("cg_shift+tire_stiffness", "without position and yaw", "position and yaw, which know the true v_y"),
    )

    def correct(self, columns: Mapping[str, np.ndarray], recording: Recording) -> dict[str, np.ndarray]:
        """Take dx r off."""
        return {**columns, "vy": columns["vy"] - self.parameters["dx"] * columns["r"]}

    def corrupt(self, columns: Mapping[str, np.ndarray], recording: Recording) -> dict[str, np.ndarray]:
        """Add dx r."""
        return {**columns, "vy": columns["vy"] + self.parameters["dx"] * columns["r"]}


class SensorMisalignment(Term):
    """A velocity sensor turned counter-clockwise by `angle`: it records R(-angle) (v_x, v_y)."""

    id = "sensor_misalignment"
    units: ClassVar = {"angle": "rad"}
    neutral: ClassVar = {"angle": 0.0}
    exported = False
    mimics: ClassVar = (Mimic("road_bank+steer_offset", "constant speed, without position", "position and yaw"),)

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


class SensorDelay(Term):
    """Every measured channel late against the commands by `delay`.

    Either the recording is corrected (`correct` moves the measured channels earlier), or the model is evaluated
    on the measured channels' clock (`actuate` takes commands as they were): never both. The second needs no
    interpolation of noisy channels.
    """

    id = "sensor_delay"
    units: ClassVar = {"delay": "s"}
    neutral: ClassVar = {"delay": 0.0}
    order = 0
    exported = False
    mimics: ClassVar = (
        Mimic("steer_delay+drive_delay", "both delays equal: the same recording", exact=True),
        Mimic("steer_delay", "torque that hardly changes", "a torque step"),
    )

    @property
    def input_delays(self) -> Mapping[str, float]:
        """Delay [s] by channel."""
        return {"T": self.parameters["delay"], "delta": self.parameters["delay"]}

    def actuate(self, flow: Flow) -> None:
        """Take the commands that the measured channels answer to."""
        flow.T = self.delayed(flow, flow.T, self.parameters["delay"])
        flow.delta = self.delayed(flow, flow.delta, self.parameters["delay"])

    def correct(self, columns: Mapping[str, np.ndarray], recording: Recording) -> dict[str, np.ndarray]:
        """Move measured channels earlier."""
        return self._moved(columns, -self.parameters["delay"], recording)

    def corrupt(self, columns: Mapping[str, np.ndarray], recording: Recording) -> dict[str, np.ndarray]:
        """Move measured channels later."""
        return self._moved(columns, self.parameters["delay"], recording)

    @staticmethod
    def _moved(columns: Mapping[str, np.ndarray], delay: float, recording: Recording) -> dict[str, np.ndarray]:
        return {
            name: values if name in _COMMANDS else shifted(values, delay, recording)
            for name, values in columns.items()
        }
