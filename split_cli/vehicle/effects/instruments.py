"""Terms of single instruments: direction and scale of the recorded velocity, biases, delay of one channel.

They show in redundant channels: position and yaw against velocities, accelerations against velocities.
"""

from collections.abc import Callable, Mapping
from typing import ClassVar

import numpy as np

from split_cli.vehicle.effects.recording import Recording, phase_shifted, shifted
from split_cli.vehicle.effects.search import DELAYS, LONGEST_DELAY, Course, Range, Search
from split_cli.vehicle.effects.term import Mimic, Term
from split_cli.vehicle.effects.wording import Estimates, amount, late, number, scaled
from split_cli.vehicle.parameters import Vehicle

__all__ = ["AccelerationBias", "ChannelDelay", "SpeedScale", "VelocityBias", "YawRateBias", "YawRateScale"]

_TURNED = "judgement: a mounting that is off by more than nine degrees is seen"
_WANDER = "judgement: what turns by half a degree in a second is no sensor of a direction"
_BESIDE = "judgement: on straights, v_y of 1 m/s is seen at any speed"
_TILTED = "judgement: an accelerometer tilted by eleven degrees measures a fifth of gravity"
CROSSFALL = 0.025 * 9.81  # [m/s^2] gravity across a road that sheds water (AASHTO, 1.5 to 2.5 %): any road does
# [1] judgement: a body that leans by some 4.6 degrees at 1 g, more than most cars do; g sin(roll) is felt across.
_ROLLS = 0.08
# A body that leans follows its acceleration late, as an oscillator of 1.6 Hz at half the critical damping by 2 zeta/w,
# 0.1 s. What is felt of that makes the whole acceleration late by the share of it [s].
_LEANS_LATE = 0.1 * _ROLLS
_GYRO = "judgement: three degrees a second, beyond any gyroscope that was switched on at rest"
# Yaw rate that a gyroscope may read at rest [rad/s]: judgement, a degree a second, where nobody set it to zero.
_COLD = 0.0175
_WORN = "judgement: wheels wear and gyroscopes age by a few per cent, 15 % is another unit"
# Delay of a channel in a sound recording [s]: many loggers write the time in whole milliseconds.
_STAMPED = 0.001
_UNALIGNED = "judgement: filters, buses and clocks that nobody aligned make a channel late by up to a second"
_WORDS = {
    "r": "the yaw rate",
    "vx": "the longitudinal velocity",
    "vy": "the lateral velocity",
    "velocity": "the velocity",
    "imu": "the inertial unit (yaw rate and accelerations)",
    "ax": "the longitudinal acceleration",
    "ay": "the lateral acceleration",
}


_POSITION = "position recorded beside the velocities"
_PLACE = ("X", "Y", "yaw")


class _Instrument(Term):
    """A fault of a recording that acts on some channels, each by itself."""

    exported = False
    family = "measurement"

    def correct(self, columns: Mapping[str, np.ndarray], recording: Recording) -> dict[str, np.ndarray]:
        """Return the channels without the fault."""
        return self._changed(columns, recording, -1.0)

    def corrupt(self, columns: Mapping[str, np.ndarray], recording: Recording) -> dict[str, np.ndarray]:
        """Return the channels with the fault."""
        return self._changed(columns, recording, 1.0)

    def _changed(self, columns: Mapping[str, np.ndarray], recording: Recording, sign: float) -> dict[str, np.ndarray]:
        raise NotImplementedError


class VelocityBias(_Instrument):
    """The recorded velocity deviates from the true direction by an angle that changes in time.

    Recorded v_y is v_y + angle(t) v_x to first order, counter-clockwise positive: the velocity is turned by
    R(angle). By default the angle drifts as angle + drift (t - t_middle), so that `angle` is its mean over the
    drive. Variant ``step``: the angle is `angle` before the time `at` and `angle` + `step` after it, as if an
    observer were reset. Variant ``offset``: recorded v_y is v_y + offset, an angle that falls with speed, as of an
    optical sensor beside its zero.

    A constant angle is `sensor_misalignment` with the opposite sign. Slip angle estimates that integrate
    inertial sensors drift in this way (Bevly, Ryu and Gerdes, 2006). Redundant channels (witnesses): position
    and yaw.
    """

    id = "velocity_bias"
    titles: ClassVar = {"": "Lateral velocity biased"}
    units: ClassVar = {"angle": "rad", "drift": "rad/s"}
    variants: ClassVar = ("", "step", "offset")
    variant_words: ClassVar = {"step": "an angle that jumps once", "offset": "a constant added to v_y"}
    variant_units: ClassVar = {"step": {"angle": "rad", "step": "rad", "at": "s"}, "offset": {"offset": "m/s"}}
    neutral: ClassVar = {"angle": 0.0, "drift": 0.0, "step": 0.0, "offset": 0.0}
    needs: ClassVar = frozenset({"measured position", "lateral velocity"})
    mimics: ClassVar = (
        Mimic("sensor_misalignment", "a drift small against the mean", "a longer drive with position"),
        Mimic("road_bank+steer_offset", "constant speed, without position", "position and yaw"),
    )

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        angle = Range(-0.15, 0.15, 0.0005, _TURNED)
        if variant == "offset":
            return Search({"offset": Range(-1.0, 1.0, 0.003, _BESIDE)}, ({"offset": 0.01},))
        if variant == "step":
            at = Range(0.0, course.duration, 0.005 * course.duration)
            starts = tuple(
                {"angle": 0.001, "step": 0.005, "at": share * course.duration}
                for share in (0.15, 0.3, 0.45, 0.6, 0.75, 0.9)
            )
            return Search({"angle": angle, "step": angle, "at": at}, starts, complexity=5.0)
        drift = Range(-0.01, 0.01, 1e-5, _WANDER)
        return Search({"angle": angle, "drift": drift}, ({"angle": 0.002, "drift": 1e-4},))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        if variant == "offset":
            return f"the recorded lateral velocity is {amount(p['offset'])} beside its zero"
        angle = amount(p["angle"])
        if variant == "step":
            return (
                f"the recorded velocity points {angle} off the true one, {amount(p['step'])} more from "
                f"{number(p['at'].value)} s on"
            )
        drift = amount(p["drift"])
        return f"the recorded velocity points {angle} off the true one on average and drifts by {drift}"

    def angle(self, t: np.ndarray) -> np.ndarray:
        """Return the angle at times [rad]."""
        p = self.parameters
        if self.variant == "step":
            return p["angle"] + p["step"] * (t >= p["at"])
        angle: np.ndarray = p["angle"] + p["drift"] * (t - 0.5 * (t[0] + t[-1]))
        return angle

    def _changed(self, columns: Mapping[str, np.ndarray], recording: Recording, sign: float) -> dict[str, np.ndarray]:
        if self.variant == "offset":
            return {**columns, "vy": columns["vy"] + sign * self.parameters["offset"]}
        t = columns["t"]
        # Several channels of one recording are turned in a row, and this is most of the work.
        cosine, sine = self.cached(t, lambda: self._direction(t))
        vx, vy, sine = columns["vx"], columns["vy"], sign * sine
        return {**columns, "vx": cosine * vx - sine * vy, "vy": sine * vx + cosine * vy}

    def _direction(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        angle = self.angle(t)
        return np.cos(angle), np.sin(angle)


class AccelerationBias(_Instrument):
    """The accelerometers have a zero offset: recorded a_x + ax, a_y + ay.

    A sensor that is tilted by an angle measures g times that angle. An inclined road causes the same reading,
    but it also moves the car. Variants ``ax`` and ``ay`` have one offset only, also if only one channel was
    recorded. Source: definition of specific force. Witness: the recorded velocities, since a_x = v_x' - v_y r
    and a_y = v_y' + v_x r.
    """

    id = "acceleration_bias"
    titles: ClassVar = {"": "Acceleration biased"}
    units: ClassVar = {"ax": "m/s^2", "ay": "m/s^2"}
    variants: ClassVar = ("", "ax", "ay")
    variant_words: ClassVar = {"ax": "of a_x alone", "ay": "of a_y alone"}
    variant_units: ClassVar = {name: {name: "m/s^2"} for name in ("ax", "ay")}
    neutral: ClassVar = {"ax": 0.0, "ay": 0.0}
    variant_needs: ClassVar = {"": frozenset({"ax", "ay"}), "ax": frozenset({"ax"}), "ay": frozenset({"ay"})}
    mimics: ClassVar = (
        Mimic("road_grade", "the road climbs all along", "the opposite direction"),
        Mimic(
            "road_bank", "the road leans all along", "the opposite direction: a road moves the car, a sensor does not"
        ),
    )

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        limits = Range(-2.0, 2.0, 0.01, _TILTED, tolerance=CROSSFALL)
        names = cls.parameter_units(variant)
        return Search(dict.fromkeys(names, limits), (dict.fromkeys(names, 0.05),))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        words = {"ax": "ahead", "ay": "to the left"}
        sizes = {name: amount(p[name], more="too much", less="too little") for name in words if name in p}
        read = [f"{size} {words[name]}" for name, size in sizes.items()]
        return f"the accelerometers read {' and '.join(read)}"

    def _changed(self, columns: Mapping[str, np.ndarray], recording: Recording, sign: float) -> dict[str, np.ndarray]:
        biased = {name: columns[name] + sign * bias for name, bias in self.parameters.items() if name in columns}
        return {**columns, **biased}


class YawRateBias(_Instrument):
    """The gyroscope has a zero offset: recorded yaw rate r + r_0, with r_0 the parameter `r`.

    Source: the usual model of a rate gyroscope. Witness: the rate of the recorded yaw angle, or a_y, which follows
    v_x r. A bank of the road moves a_y as well, at all speeds alike.
    """

    id = "yaw_rate_bias"
    titles: ClassVar = {"": "Yaw rate biased"}
    units: ClassVar = {"r": "rad/s"}
    neutral: ClassVar = {"r": 0.0}
    needs: ClassVar = frozenset({"witness"})
    mimics: ClassVar = (
        Mimic("steer_offset", "one speed, without yaw", "yaw, or turns to both sides at two speeds"),
        Mimic("road_bank", "one speed, without yaw", "yaw, or the same road at two speeds"),
    )

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        return Search({"r": Range(-0.05, 0.05, 1e-4, _GYRO, tolerance_by_acceleration=_COLD)}, ({"r": 0.001},))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        return f"the yaw rate reads {amount(p['r'], more='too far to the left', less='too far to the right')}"

    def _changed(self, columns: Mapping[str, np.ndarray], recording: Recording, sign: float) -> dict[str, np.ndarray]:
        return {**columns, "r": columns["r"] + sign * self.parameters["r"]}


class _Scale(_Instrument):
    """Channels recorded as `scale` times what is true.

    Without position, a_y tells v_x r of the simulation from that of reality. A body that rolls on its springs
    tilts the accelerometer, so that a_y reads up to 8 % too much there, and a smaller scale is no fault.
    """

    units: ClassVar = {"scale": "1"}
    neutral: ClassVar = {"scale": 1.0}
    needs: ClassVar = frozenset({"scale witness"})
    channels: ClassVar[tuple[str, ...]]
    subject: ClassVar[str]

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        return Search({"scale": Range(0.85, 1.15, 0.001, _WORN, tolerance_by_acceleration=_ROLLS)}, ({"scale": 0.99},))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        subject = _WORDS[variant] if variant else cls.subject
        return f"{subject} reads {scaled(p['scale'], 'too much', 'too little')}"

    def _changed(self, columns: Mapping[str, np.ndarray], recording: Recording, sign: float) -> dict[str, np.ndarray]:
        factor = self.parameters["scale"] ** sign
        channels = (self.variant,) if self.variant else self.channels
        return {**columns, **{name: factor * columns[name] for name in channels}}


class SpeedScale(_Scale):
    """The recorded speed has a scale error: v_x and v_y are `scale` times the true ones.

    By default one sensor measures both.

    Variant ``vx``: v_x alone is scaled, as with a worn wheel and another source of v_y. Source: v = omega r_e
    with a wrong radius. Witness: the distance between positions, or a_y, which follows v_x r.
    """

    id = "speed_scale"
    factors: ClassVar = {"scale": ("Speed sensor", "high", "low")}
    variants: ClassVar = ("", "vx")
    variant_words: ClassVar = {"vx": "of v_x alone"}
    channels = ("vx", "vy")
    subject = "the velocity"
    mimics: ClassVar = (
        Mimic("drive_gain+aero_drag", "straight driving, without position", _POSITION),
        Mimic("yaw_rate_scale", "without position and yaw: only v_x r is seen", "position and yaw", without=_PLACE),
    )


class YawRateScale(_Scale):
    """The recorded yaw rate has a scale error: it is `scale` times the true one.

    Source: the usual model of a rate gyroscope. Witness: the rate of the recorded yaw angle, or a_y, which
    follows v_x r.
    """

    id = "yaw_rate_scale"
    factors: ClassVar = {"scale": ("Yaw rate sensor", "high", "low")}
    channels = ("r",)
    subject = "the yaw rate"
    mimics: ClassVar = (Mimic("steer_gain", "gentle driving, without yaw", "yaw recorded beside the yaw rate"),)


class ChannelDelay(_Instrument):
    """One channel is late relative to the others by the parameter that has its name; the variant selects it.

    In the variant ``velocity`` v_x and v_y are late, as from a satellite receiver. In the variant ``imu`` the yaw
    rate and both accelerations are late alike, by `r`: one inertial unit has one clock. Only the signal is delayed;
    the noise stays where it is. Source: a transport delay. Witnesses: yaw for r, position for the velocities, and
    accelerations for both. For every car a_x = v_x' - v_y r and a_y = v_y' + v_x r hold. Velocities that were
    derived from position cannot be late relative to it. A delay of all channels together is `sensor_delay`.
    """

    id = "channel_delay"
    titles: ClassVar = {
        "r": "Yaw rate late",
        "vx": "Longitudinal velocity late",
        "vy": "Lateral velocity late",
        "velocity": "Velocities late",
        "imu": "Inertial unit late",
        "ax": "Longitudinal acceleration late",
        "ay": "Lateral acceleration late",
    }
    variants: ClassVar = ("r", "vx", "vy", "velocity", "ax", "ay", "imu")
    variant_words: ClassVar = {
        "r": "of the yaw rate r",
        "vx": "of v_x",
        "vy": "of v_y",
        "velocity": "of both velocities",
        "ax": "of a_x",
        "ay": "of a_y",
        "imu": "of yaw rate and accelerations",
    }
    units: ClassVar = {"r": "s"}
    variant_units: ClassVar = {
        **{name: {name: "s"} for name in ("r", "vx", "vy", "ax", "ay")},
        "velocity": {"vx": "s", "vy": "s"},
        "imu": {"r": "s"},
    }
    neutral: ClassVar = {"r": 0.0, "vx": 0.0, "vy": 0.0, "ax": 0.0, "ay": 0.0}
    variant_needs: ClassVar = {
        **{name: frozenset({"witness", "measured velocities"}) for name in ("r", "vx")},
        **{name: frozenset({"witness", "measured velocities", "lateral velocity"}) for name in ("vy", "velocity")},
        **{name: frozenset({name}) for name in ("ax", "ay")},
        "imu": frozenset({"witness", "measured velocities", "lateral velocity", "ax", "ay"}),
    }
    moves_samples = True
    mimics: ClassVar = (
        Mimic("yaw_inertia", "gentle transients, without yaw", "yaw against yaw rate", variants=("r", "imu")),
        *(
            Mimic(term, f"without position: {what} that answers late", _POSITION, variants=variants, without=_PLACE)
            for what, terms, variants in (
                ("speed", ("drive_lag", "drive_delay"), ("vx", "velocity")),
                ("a turn", ("steer_lag", "steer_delay"), ("r", "vy", "velocity", "imu")),
            )
            for term in terms
        ),
        Mimic("sensor_lever_arm", "one speed, yaw rate that changes slowly", "turns at several speeds"),
    )

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        """Return ranges and starts [s]: clocks do not run faster in smaller cars."""
        names = cls.parameter_units(variant)
        tolerance = _LEANS_LATE if variant in ("ax", "ay") else _STAMPED
        limits = Range(0.0, LONGEST_DELAY, 0.001, _UNALIGNED, tolerance=tolerance)
        starts = tuple(dict.fromkeys(names, value) for value in DELAYS)
        return Search(dict.fromkeys(names, limits), starts)

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        if variant == "velocity":
            each = f"the longitudinal velocity is {late(p['vx'])} and the lateral velocity {late(p['vy'])}"
            return f"{each} against the other channels"
        return f"{_WORDS[variant]} is {late(p['r' if variant == 'imu' else variant])} against the other channels"

    def _changed(self, columns: Mapping[str, np.ndarray], recording: Recording, sign: float) -> dict[str, np.ndarray]:
        return self._moved(columns, recording, sign, shifted)

    def correct_noise(self, columns: Mapping[str, np.ndarray], recording: Recording) -> dict[str, np.ndarray]:
        """Return what smoothing left, moved along: fast signal is a part of it."""
        return self._moved(columns, recording, -1.0, phase_shifted)

    def _moved(
        self,
        columns: Mapping[str, np.ndarray],
        recording: Recording,
        sign: float,
        move: Callable[[np.ndarray, float, Recording], np.ndarray],
    ) -> dict[str, np.ndarray]:
        delays = dict.fromkeys(("r", "ax", "ay"), self.parameters["r"]) if self.variant == "imu" else self.parameters
        moved = {
            name: move(columns[name], sign * delay, recording) for name, delay in delays.items() if name in columns
        }
        return {**columns, **moved}
