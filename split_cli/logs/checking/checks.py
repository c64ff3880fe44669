"""Measurements on a drive that tell whether its channels fit together: ratios, magnitudes, biases, places."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from split_cli.logs.checking.kinematics import (
    Kinematics,
    Slope,
    beside_path,
    fit_linear,
    fit_slope,
    median_of,
    scaled_parts,
    still_runs,
)
from split_cli.logs.checking.plausible import NO_CAR_EXCEEDS, reach_of
from split_cli.logs.checking.relations import OVER_TIME, ConsistencyFinding, Plausible, Relation
from split_cli.logs.checking.steering_zero import steering_zero
from split_cli.logs.checking.straights import course_of, straight_rows, straight_stretches
from split_cli.logs.checking.wheel_speeds import AXLES, outer_wheels, without_turning
from split_cli.logs.drive import Drive
from split_cli.logs.drive_metadata import MEASURED_SIDESLIP, OF_POSE, is_derived, yaw_rate_is_of_acceleration
from split_cli.logs.scratch import set_aside
from split_cli.signals import STANDARD_GRAVITY
from split_cli.vehicle.parameters import Vehicle

LEAST_CORRELATION = 0.8
"""Below it two signals that should be equal say nothing about a factor."""
_STRAIGHT_SECONDS = 3.0
_STEER_TOLERANCE = 0.7
"""Of the logarithm of steer angle over the steady one: a factor of two, see `Checks._steer_angle`."""
TORQUE_TOLERANCE = 0.5
"""Of the logarithm of T over the torque that the motion takes [1]: a factor of 1.6, for losses and slopes."""
ACROSS = "v_y/v_x against the path across yaw"
_GRIP_MARGIN = 1.1
"""Over the sum of both D: banking of 5 degrees or a cresting road gives as much [1]."""
_GRIP_SECONDS = 1.0
"""Over which a lateral acceleration is reached, all together, to be believed [s]."""
_FAR_BETTER = 0.25
"""Variance that a place of v_y leaves, of what a factor leaves, from which on it is a place [1]."""
_BY_SLIP_SPEED = 0.5
"""Variance of v_y that forces by slip speed leave, of what a tyre curve leaves, below which they are by slip
speed [1]: a car of MuJoCo leaves 0.26 to 0.43 of a straight curve's, tyres 0.9 to 1.6."""
_LEAST_ARM = 0.15
"""Of the wheelbase, below which a place is not distinguished from the CG [1]."""
_SIGN_ONLY = 5.0
"""Tolerance of a relation whose size says nothing."""
_MOST_SIDEWAYS = 3.0
"""99 % quantile of |v_y/v_x| in motion that no car reaches [1]: 72 degrees of sideslip."""
NOT_RECORDED = "derived: nothing"
"""Kind of a required channel that a draft has to fill in and nothing recorded."""


@dataclass(frozen=True)
class Unjudged:
    """A check that this drive cannot answer, and why."""

    check: str
    reason: str


class Checks:
    """The measurements; each either adds relations or findings, or says why it could not."""

    def __init__(
        self,
        columns: Mapping[str, np.ndarray],
        drive: Drive,
        vehicle: Vehicle | None,
        kinds: Mapping[str, str],
        certain: Collection[str] = (),
        slowest: float = 0.0,
    ) -> None:
        self.vehicle = vehicle
        self.certain = certain
        self.k = Kinematics(columns, drive.period, drive.segments(), max(slowest, Kinematics.WIDTH))
        # A side-slip angle is measured, and may be so at another place or with another sign than v_y is taken for.
        derived = {channel for channel, kind in kinds.items() if is_derived(kind)}
        self.of_sideslip = "vy" in derived and MEASURED_SIDESLIP in kinds["vy"]
        self.of_pose = "vy" in derived and OF_POSE in kinds["vy"]
        self.of_acceleration = yaw_rate_is_of_acceleration(kinds)
        self.derived = derived - ({"vy"} if self.of_sideslip else set())
        self.absent = {channel for channel in self.derived if kinds[channel] == NOT_RECORDED}
        self.pose_fits = True
        self.arm = self.possible_arm = 0.0
        self.beside_accelerometer = False  # whether v_y is of the place where a_y is measured
        self.relations: list[Relation] = []
        #: What was compared, by the relation's name: both signals (N,), tolerance, whether both are 0 together.
        self.pairs: dict[str, tuple[np.ndarray, np.ndarray, float, bool]] = {}
        self.powers: dict[str, dict[str, int]] = {}
        #: What was compared where a channel stands still for a while: both signals (N,), channels, whether 0 together.
        self.beside: dict[str, tuple[np.ndarray, np.ndarray, tuple[str, ...], bool]] = {}
        self._still: dict[str, list[slice]] = {}
        self.unjudged: list[Unjudged] = []
        self._sideslip: tuple[np.ndarray, np.ndarray] | None = None

    def usable(self, *channels: str) -> bool:
        """Whether all channels were recorded, so that each may carry a mistake."""
        return all(channel in self.k and channel not in self.derived for channel in channels)

    def known(self, *channels: str) -> bool:
        """Whether all channels were recorded, or derived from a pose that fits: others may be judged by them."""
        unknown = self.absent if self.pose_fits else self.derived
        return all(channel in self.k and channel not in unknown for channel in channels)

    def still(self, channel: str) -> list[slice]:
        """Return the stretches over which a channel keeps one value."""
        if channel not in self._still:
            known = channel in self.k
            runs = still_runs(self.k.columns[channel], self.k.segments, self.k.period) if known else []
            self._still[channel] = runs
        return self._still[channel]

    def magnitudes(self) -> list[Plausible]:
        """Return what the 99 % quantiles of channels reach, with what no car reaches."""
        k, found = self.k, []

        def add(name: str, values: np.ndarray, raw: np.ndarray, powers: dict[str, int], high: float, unit: str) -> None:
            values = np.abs(values[np.isfinite(values)])
            if len(values) > 50:
                found.append(Plausible(name, powers, reach_of(values, raw), high, unit))

        for channel, (high, unit) in NO_CAR_EXCEEDS.items():
            if self.usable(channel):
                add(channel, k.signal(channel), k.columns[channel], {channel: 1}, high, unit)
        if self.usable("vx", "r"):
            raw, high = k.columns["vx"] * k.columns["r"], NO_CAR_EXCEEDS["ay"][0]
            add("v_x r", k.turning(), raw, {"vx": 1, "r": 1}, high, "m/s^2")
        if self.usable("vx", "vy"):
            sideways = k.signal("vy")[k.moving] / k.signal("vx")[k.moving]
            add("v_y/v_x", sideways, sideways, {"vy": 1, "vx": -1}, _MOST_SIDEWAYS, "")
        if self.usable("X", "Y", "vx"):
            # Steady speeds do not correlate, and a signal that is no speed does not either: their sizes tell.
            over_ground = k.ground_speed()[k.moving] / np.abs(k.signal("vx")[k.moving])
            if np.count_nonzero(np.isfinite(over_ground)) > 50:
                median, high = float(np.nanmedian(over_ground)), float(np.hypot(1.0, _MOST_SIDEWAYS))
                found.append(Plausible("speed of X, Y over v_x", {"vx": -1, "X": 1}, median, high, ""))
        return found

    def relate(
        self,
        name: str,
        y: np.ndarray,
        x: np.ndarray,
        powers: dict[str, int],
        base: float,
        corrected: Callable[[float, float], float] | None = None,
        *,
        zeroed: bool = False,
    ) -> None:
        """Measure y over x, whose ratio is the product of the channels' factors to the `powers`.

        A derived channel carries no mistake of its own and drops out of `powers`.
        """
        powers = {channel: power for channel, power in powers.items() if channel not in self.derived}
        if name in OVER_TIME:
            self.pairs[name], self.powers[name] = (set_aside(y), set_aside(x), base, zeroed), powers
        if standing := tuple(channel for channel in powers if self.still(channel)):
            self.beside[name] = set_aside(y), set_aside(x), standing, zeroed
        slope = fit_slope(y, x, self.k.moving, zeroed=zeroed)
        if slope is None:
            self.unjudged.append(Unjudged(name, "too few samples in motion, or nothing changes"))
            return
        if abs(slope.correlation) < LEAST_CORRELATION:
            hint = "; a delay between them does that, try --estimate-delays" if abs(slope.correlation) > 0.3 else ""
            self.unjudged.append(Unjudged(name, f"the two correlate by {slope.correlation:.2f} only{hint}"))
            return
        # Noise can move the ratio by 1/correlation.
        tolerance = base - float(np.log(abs(slope.correlation))) + 3.0 * slope.error / abs(slope.slope)
        if tolerance > 1.0:
            self.unjudged.append(
                Unjudged(name, f"the slope {slope.slope:.3g} has a standard error of {slope.error:.2g}")
            )
            return
        relation = Relation(name, powers, slope, tolerance, corrected)
        self.relations.append(replace(relation, certain=relation.leaf in self.certain))

    def measure_relations(self) -> None:
        k = self.k
        if self.usable("r", "yaw"):
            self.relate("r against dyaw/dt", k.signal("r"), k.rate("yaw"), {"r": 1, "yaw": -1}, 0.05)
        if self.usable("X", "Y", "r"):
            self.relate("r against the turning of X, Y", *beside_path(k, "r", 0), {"r": 1, "hand": 1}, 0.15)
        if self.usable("X", "Y", "vx"):
            self.relate(
                "v_x against the speed of X, Y",
                k.signal("vx"),
                k.ground_speed(),
                {"vx": 1, "X": -1},
                0.03 + self._more_than_forward(),
                zeroed=True,
            )
        if self.usable("X", "Y", "yaw") and not self.usable("r"):
            self.relate("dyaw/dt against the turning of X, Y", *beside_path(k, "yaw", 1), {"yaw": 1}, 0.15)
            self.pose_fits = all(relation.holds for relation in self.relations if "yaw" in relation.powers)
        if self.known("vx"):
            self._accelerations()
            self._wheel_speeds()
            self._torque()
        if self.known("vx", "r"):
            self._steer_angle()
        across = self.usable("vy") and self.known("vx", "r") and self._sideslip_of_path()
        if self.usable("vx", "vy", "r") and not across:
            self._sideslip_sign()
        if self.usable("r") and not any("r" in relation.powers for relation in self.relations):
            self.unjudged.append(Unjudged("yaw rate", "neither yaw, position nor a_y follows its turning"))

    def _more_than_forward(self) -> float:
        """Return how much larger than v_x sideslip makes the speed of X, Y, as a share of v_x [1]."""
        if not self.usable("vy"):
            return 0.0
        vx, vy = (self.k.signal(channel)[self.k.moving] for channel in ("vx", "vy"))
        ratio = np.hypot(vx, vy) / np.maximum(np.abs(vx), 1e-9)
        return float(np.nanmean(ratio) - 1.0) if np.isfinite(ratio).any() else 0.0

    def _accelerations(self) -> None:
        k = self.k
        if self.usable("ax"):
            inertial = k.rate("vx") - self.carried()
            self.relate("a_x against dv_x/dt - v_y r", k.signal("ax"), inertial, {"ax": 1, "vx": -1}, 0.12)
        if self.usable("ay") and self.known("r") and not self.of_acceleration:
            turning = k.turning()
            name, lateral = "a_y against v_x r", k.signal("ay")
            if self.usable("vy"):
                # In a quick slalom dv_y/dt is a third of it: v_x r alone read km/h as mph. A v_y that is wrong or
                # mostly noise goes worse with a_y than none.
                with_slide = turning + k.rate("vy")
                alone, both = (fit_slope(lateral, x, k.moving) for x in (turning, with_slide))
                if alone is not None and both is not None and both.correlation > abs(alone.correlation):
                    name, turning = "a_y against v_x r + dv_y/dt", with_slide
            self.relate(name, lateral, turning, {"ay": 1, "vx": -1, "r": -1}, 0.15)

    def carried(self) -> np.ndarray | float:
        """Return v_y r, what turning takes from dv_x/dt [m/s^2]; 0 where v_y or r is not known."""
        if not self.known("vy", "r"):
            return 0.0
        return self.k.of("vy r", lambda: self.k.columns["vy"] * self.k.columns["r"])

    def _wheel_speeds(self) -> None:
        for channel in self.k.columns:
            if channel.startswith("wheel_speed"):
                powers = {channel: 1, "vx": -1}
                speed = without_turning(self.k, channel, self.usable)
                self.relate(f"{channel} against v_x", speed, self.k.signal("vx"), powers, 0.05)

    def _steer_angle(self) -> None:
        """Compare delta with the steady single track, L r/v_x + K v_x r with the vehicle file's understeer K.

        A car may understeer more than its file, and an actuator may deliver less than commanded: the tolerance of
        a factor of two leaves both alone and still tells degrees, the steering wheel and a turned sign.
        """
        if not self.usable("delta") or self.vehicle is None:
            return
        k, car, name = self.k, self.vehicle, "delta against the steady steer angle"
        vx = np.where(k.moving, k.columns["vx"], np.nan)
        parts = (
            k.of("L r/vx", lambda: car.wheelbase * k.columns["r"] / np.where(np.abs(vx) > 0, vx, 1.0)),
            car.understeer_gradient * k.turning(),
        )
        if not k.moving.any() or np.nanstd(parts[0][k.moving]) < 1e-4:
            self.unjudged.append(Unjudged(name, "the car hardly turns"))
            return
        delta = k.signal("delta")
        corrected = scaled_parts(delta, parts, lambda vx, r: (vx / r, 1.0 / (vx * r)), k.moving)
        self.relate(name, delta, sum(parts), {"delta": 1, "r": -1, "vx": 1}, _STEER_TOLERANCE, corrected)

    def _torque(self) -> None:
        parts = self.torque_parts()
        if parts is None:
            return
        torque = self.k.signal("T")
        corrected = scaled_parts(torque, parts, lambda vx, r: (1.0 / vx, 1.0 / vx**2), self.k.moving)
        name = "T against the torque that dv_x/dt takes"
        self.relate(name, torque, sum(parts), {"T": 1, "vx": -1}, TORQUE_TOLERANCE, corrected)

    def torque_parts(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Return what dv_x/dt and the file's drag take [N m], each (N,); None without T or a vehicle file."""
        if not self.usable("T") or not self.known("vx") or self.vehicle is None:
            return None
        k, car = self.k, self.vehicle
        inertial = k.rate("vx") - self.carried()
        drag = car.drag_coefficient * k.signal("vx") ** 2
        return car.wheel_radius * car.mass * inertial, car.wheel_radius * drag

    def straight_line(self) -> list[ConsistencyFinding]:
        """Look for v_y and a_y that are not zero where the car goes straight."""
        k = self.k
        if not self.usable("vx") or not (self.usable("r") or self.of_acceleration):
            return []
        vx = k.signal("vx")
        straight = straight_rows(k)
        steered = self.usable("delta") and self.vehicle is not None
        if np.count_nonzero(straight) * k.period < _STRAIGHT_SECONDS:
            self.unjudged.append(Unjudged("v_y and a_y on straights", "hardly any straight driving"))
            return steering_zero(k, self.vehicle, None) if steered else []
        found = []
        if self.usable("vy"):
            found += self._vy_on_straights(straight, float(np.nanmedian(vx[straight])))
        if steered:
            found += steering_zero(k, self.vehicle, straight)
        if self.usable("ay") and not self.of_acceleration:
            plain = float(np.nanmedian(k.signal("ay")[straight]))
            rest = k.signal("ay") - k.turning()
            bias, error = median_of(rest[straight])
            tilt = np.degrees(np.arcsin(np.clip(bias / STANDARD_GRAVITY, -1.0, 1.0)))
            if abs(bias) > 0.25 and abs(bias) > 4.0 * error:
                found.append(
                    ConsistencyFinding(
                        "bias on straights",
                        "ay",
                        f"a_y reads {bias:+.3f} +- {error:.3f} m/s^2 beyond v_x r on straights "
                        f"(a_y itself {plain:+.3f}): "
                        f"a tilted sensor or a banked road ({tilt:+.1f} deg). "
                        f"Subtract it with `offset: {-bias:.3f}` if the road is flat.",
                        bias,
                        error,
                    )
                )
        return found

    def _vy_on_straights(self, straight: np.ndarray, speed: float) -> list[ConsistencyFinding]:
        # A hundredth of a radian of sideslip from rest of turning: v_y of a place at most 2 m from the CG.
        rest = self.k.signal("vy")[straight]
        bias, error = median_of(rest)
        k = self.k
        course = course_of(
            straight_stretches(k.times(), k.signal("vx"), k.signal("vy"), straight, k.period, k.segments)
        )
        is_biased = abs(bias) > max(0.03, 0.004 * abs(speed)) and abs(bias) > 4.0 * error
        moves = course is not None and course.kind != "constant" and float(np.ptp(course.angle)) > 0.004
        if not is_biased and not moves:
            return []
        as_direction = f" As a direction: {course.words()}." if course is not None else ""
        angle = np.degrees(bias / speed)
        what = "its direction is not steady"
        if is_biased:
            what = f"an offset, or a sensor turned by {-angle:+.2f} deg"
        how = "`--derive lateral-velocity-from-straights` takes it off" + (
            "." if moves else f", or `offset: {-bias:.3f}` for vy."
        )
        return [
            ConsistencyFinding(
                "bias on straights",
                "vy",
                f"v_y reads {bias:+.3f} +- {error:.3f} m/s on straights at a median {speed:.1f} m/s: {what}."
                f"{as_direction} {how}",
                bias,
                error,
            )
        ]

    def grip(self) -> list[ConsistencyFinding]:
        """Compare the horizontal acceleration that is reached with what the vehicle file's tyres can carry."""
        k, car = self.k, self.vehicle
        if car is None or not self.usable("vx", "vy", "r"):
            return []
        # Of the path, whatever a_y's sensor adds; a car that slides turns faster than its path.
        lateral = np.abs(k.turning() + k.rate("vy"))
        carried = car.lateral_grip
        rows = k.moving & (lateral > _GRIP_MARGIN * carried)
        seconds = float(np.count_nonzero(rows)) * k.period
        if seconds < _GRIP_SECONDS:
            return []
        # What is reached for a second does not depend on the file: the next file changes nothing.
        reached = float(np.sort(lateral[rows])[-round(_GRIP_SECONDS / k.period)])
        text = (
            f"the tyres of the vehicle file carry {carried:.2f} m/s^2, and the car corners at more for "
            f"{seconds:.1f} s, at {reached:.2f} for {_GRIP_SECONDS:.0f} s (v_x r + dv_y/dt): the recording "
            f"shows a friction of at least {reached / STANDARD_GRAVITY:.2f}, the file has "
            f"{carried / STANDARD_GRAVITY:.2f}. Scale D of both tyres by {reached / carried:.2f} or more, or "
            "check the mass."
        )
        return [ConsistencyFinding("grip", "r", text, reached, None)]

    def sideslip_fit(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Return p, q of v_y = p r - q v_x a + c v_x dr/dt + b and their errors; None with the reason told.

        The rear axle's slip is its force over its stiffness, and the force is (m l_f a - I_z dr/dt)/L, where
        a = v_x r + dv_y/dt. Without dr/dt, right logs of brisk driving had p 0.6 m too small. Where v_y follows
        p r - q a + c dr/dt + b far better, forces grow with slip speed in place of the slip angle, and p is its.
        """
        name = "place and sign of v_y"
        if self.vehicle is None or not self.usable("vx", "vy", "r"):
            return None
        if self._sideslip is None:
            k = self.k
            vx, vy, r = k.signal("vx"), k.signal("vy"), k.signal("r")
            path = k.turning() + k.rate("vy")
            turning = k.rate("r")
            use = k.moving & np.isfinite(vy * path * turning) & (np.abs(vx * r) < 4.0)
            if np.count_nonzero(use) < 300:
                self.unjudged.append(Unjudged(name, "too little driving in the linear range"))
                return None
            target, one = vy[use], np.ones_like(r)
            # A tyre's force follows the slip angle, that of a physics engine's contact the slip speed.
            laws = [np.stack([part[use] for part in (r, -by * path, by * turning, one)], axis=1) for by in (vx, one)]
            # Near a steady speed a tyre whose curve bends looks like a contact, unless it may bend here too.
            bent = np.column_stack([laws[0], (vx * path**3)[use]])
            left = [np.var(target - law @ np.linalg.lstsq(law, target, rcond=None)[0]) for law in (*laws, bent)]
            design = laws[int(left[1] < _BY_SLIP_SPEED * min(left[0], left[2]))]
            self._sideslip = fit_linear(design, target)
            p, p_error = self._sideslip[0][0], self._sideslip[1][0]
            if 3.0 * p_error > 0.5 * self.vehicle.cg_to_rear_axle:
                side = "ahead of" if p > 0.0 else "behind"
                reason = f"measured {abs(p):.2f} +- {p_error:.2f} m {side} the rear axle, too uncertain to tell"
                self.unjudged.append(Unjudged(name, reason))
        values, errors = self._sideslip
        return None if 3.0 * errors[0] > 0.5 * self.vehicle.cg_to_rear_axle else (values, errors)

    def _sideslip_of_path(self) -> bool:
        """Relate v_y/v_x to the angle between the path of X, Y and yaw; False where that says nothing."""
        if not self.usable("X", "Y", "yaw"):
            return False
        count = len(self.relations)
        sideslip, path = self.k.sideslip(), self.k.path_across()
        self.arm = self._arm_of_path(path)
        if self.arm:
            vx = self.k.columns["vx"]
            carried = self.k.of("r/vx", lambda: self.k.columns["r"] / np.where(np.abs(vx) > 0.0, vx, np.nan))
            sideslip = sideslip + self.arm * carried
        before = len(self.unjudged)
        self.relate(ACROSS, sideslip, path, {"vy": 1, "vx": -1}, 0.3)
        del self.unjudged[before:]
        self.relations[count:] = [replace(relation, of_the_world=True) for relation in self.relations[count:]]
        return len(self.relations) > count

    def _arm_of_path(self, path: np.ndarray) -> float:
        """Return how far behind the CG v_y is measured [m], by the path across yaw; 0 where that tells no place.

        Taken only where a place explains v_y far better than a factor does, and lies within the car's reach.
        """
        if self.vehicle is None or not self.usable("r"):
            return 0.0
        k = self.k
        vy, r, across = k.signal("vy"), k.signal("r"), k.signal("vx") * np.tan(path)
        use = k.moving & np.isfinite(vy * r * across) & (np.abs(path) < 0.5)
        if np.count_nonzero(use) < 300:
            return 0.0
        vy, r, across = (v[use] - np.median(v[use]) for v in (vy, r, across))
        if not (np.ptp(r) > 0.0 and np.ptp(across) > 0.0):
            return 0.0
        arm = float((across - vy) @ r / (r @ r))
        factor = float(vy @ across / (across @ across))
        by_place, by_factor = float(np.var(vy + arm * r - across)), float(np.var(vy - factor * across))
        other = min(by_factor, float(np.var(vy - across)))
        reach = self.vehicle.wheelbase
        if by_place >= other or not _LEAST_ARM * reach < abs(arm) < reach:
            return 0.0
        self.possible_arm = arm
        return arm if by_place < _FAR_BETTER * other else 0.0

    def wheel_sides(self) -> list[ConsistencyFinding]:
        """Compare right less left wheel speed with r: in a left turn the right wheels are faster."""
        found = []
        for left, slope in outer_wheels(self.k, self.usable).items():
            if slope.correlation > -LEAST_CORRELATION:
                continue
            right = dict(AXLES)[left]
            text = (
                f"{right} less {left} against r: slope {slope.slope:.3g} m, correlation {slope.correlation:.3f}, "
                "while the wheels outside a turn are faster: left and right wheels are exchanged, or r and all "
                "that has a side is right-positive. Exchange their sources, or set `frame: frd`."
            )
            found.append(ConsistencyFinding("swapped", left, text, slope.slope, slope.error))
        return found

    def _sideslip_sign(self) -> None:
        """Relate the sign of v_y to that of r: p and q of the steady sideslip are both positive."""
        fit = self.sideslip_fit()
        if fit is None:
            return
        (p, q), (p_error, q_error) = fit[0][:2], fit[1][:2]
        for sign in (1.0, -1.0):
            if sign * p > 4.0 * p_error and sign * q > 4.0 * q_error:
                length = self.vehicle.cg_to_rear_axle
                slope = Slope(float(p / length), float(p_error / length), sign, 0)
                self.relations.append(
                    Relation("v_y against the sideslip of the rear axle", {"vy": 1, "r": -1}, slope, _SIGN_ONLY)
                )
