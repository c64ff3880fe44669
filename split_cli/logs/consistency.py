"""Whether the channels of a drive fit together physically, and if not, what is wrong with which, in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from split_cli.logs.drive import Drive
from split_cli.logs.explanations import Finding, Relation, explain
from split_cli.logs.kinematics import Kinematics, block_interval, fit_slope
from split_cli.signals import REQUIRED_CHANNELS
from split_cli.vehicle.parameters import Vehicle

__all__ = ["Consistency", "Finding", "Unjudged", "check_consistency"]

LEAST_CORRELATION = 0.8
"""Below it two signals that should be equal say nothing about a factor."""

_STRAIGHT_LATERAL = 0.3  # [m/s^2] of v_x r
_STRAIGHT_SECONDS = 3.0


@dataclass(frozen=True)
class Unjudged:
    """A check that this drive cannot answer, and why."""

    check: str
    reason: str


@dataclass(frozen=True)
class Consistency:
    """What the checks found.

    Attributes
    ----------
    findings : tuple of Finding
        What does not fit together; empty for a sound drive.
    relations : tuple of Relation
        Every relation measured, also those that hold.
    unjudged : tuple of Unjudged
    """

    findings: tuple[Finding, ...] = ()
    relations: tuple[Relation, ...] = ()
    unjudged: tuple[Unjudged, ...] = ()


def check_consistency(drive: Drive, vehicle: Vehicle | None, kinds: Mapping[str, str]) -> Consistency:
    """Check a drive's channels against each other.

    Parameters
    ----------
    drive : Drive
    vehicle : Vehicle, optional
        Gives the wheelbase for the steer angle, the CG for v_y, mass and wheel radius for T.
    kinds : mapping of str to str
        Derived channels are not checked against what they were derived from.

    Notes
    -----
    Scales and signs are judged together: each relation measures a product of factors of two or three channels,
    and the fewest known mistakes (a unit, a hand, a swap) that account for all of them are named.
    """
    checks = _Checks(drive, vehicle, kinds)
    constant = checks.constant_channels()
    if checks.swapped():
        return Consistency(tuple([*constant, checks.swap_finding()]), (), tuple(checks.unjudged))
    checks.measure_relations()
    findings = [*constant, *explain(checks.relations, vehicle)]
    wrong = {finding.channel for finding in findings}
    if not {"vx", "r", "vy"} & wrong:
        findings += [*checks.straight_line(), *checks.sideslip_place()]
    if not {"X", "Y", "yaw"} & wrong:
        findings += checks.direction_of_travel()
    return Consistency(tuple(findings), tuple(checks.relations), tuple(checks.unjudged))


class _Checks:
    """The measurements; each either adds relations or findings, or says why it could not."""

    def __init__(self, drive: Drive, vehicle: Vehicle | None, kinds: Mapping[str, str]) -> None:
        self.vehicle = vehicle
        self.k = Kinematics(drive.columns, drive.period, drive.segments())
        self.derived = {channel for channel, kind in kinds.items() if kind.startswith("derived")}
        self.relations: list[Relation] = []
        self.unjudged: list[Unjudged] = []

    def usable(self, *channels: str) -> bool:
        return all(channel in self.k and channel not in self.derived for channel in channels)

    def constant_channels(self) -> list[Finding]:
        found = []
        for channel in (*REQUIRED_CHANNELS, "ax", "ay", "yaw"):
            if channel in self.k and channel not in self.derived:
                values = self.k.columns[channel]
                if np.nanmax(values) == np.nanmin(values):
                    found.append(
                        Finding(
                            "constant",
                            channel,
                            f"{channel} never changes ({values[0]:g}): it is probably not measured. "
                            "Map a signal that is, or derive it.",
                            None,
                        )
                    )
        return found

    def swapped(self) -> bool:
        """Tell whether v_y carries the motion: larger than v_x, and the ground speed where that is known."""
        if not self.usable("vx", "vy"):
            return False
        vx, vy = self.k.columns["vx"], self.k.columns["vy"]
        if not np.nanmean(vy**2) > 4.0 * np.nanmean(vx**2):
            return False
        return not self.usable("X", "Y") or _agreement(np.abs(vy), self.k.ground_speed()) > 0.8

    def swap_finding(self) -> Finding:
        vx, vy = self.k.columns["vx"], self.k.columns["vy"]
        ratio = float(np.sqrt(np.nanmean(vy**2) / max(np.nanmean(vx**2), 1e-12)))
        return Finding(
            "swapped",
            "vx",
            f"v_y is {ratio:.3g} times as large as v_x: the two look swapped. Exchange their sources in the map. "
            "Nothing else was judged.",
            ratio,
        )

    def relate(self, name: str, y: np.ndarray, x: np.ndarray, powers: dict[str, int], base: float) -> None:
        """Measure y over x, whose ratio is the product of the channels' factors to the `powers`."""
        slope = fit_slope(y, x, self.k.moving)
        if slope is None:
            self.unjudged.append(Unjudged(name, "too few samples in motion, or nothing changes"))
            return
        if abs(slope.correlation) < LEAST_CORRELATION:
            hint = (
                "; a delay between them does that, try --estimate-delays" if abs(slope.correlation) > 0.3 else ""
            )
            self.unjudged.append(Unjudged(name, f"the two correlate by {slope.correlation:.2f} only{hint}"))
            return
        # Noise can move the ratio by 1/correlation.
        tolerance = base - float(np.log(abs(slope.correlation))) + 3.0 * slope.error / abs(slope.slope)
        if tolerance > 1.0:
            self.unjudged.append(Unjudged(name, f"the slope {slope.slope:.3g} is uncertain by {slope.error:.2g}"))
            return
        self.relations.append(Relation(name, powers, slope, tolerance))

    def measure_relations(self) -> None:
        k = self.k
        if self.usable("r", "yaw"):
            self.relate("r against dyaw/dt", k.signal("r"), k.rate("yaw"), {"r": 1, "yaw": -1}, 0.05)
        if self.usable("X", "Y", "r"):
            self.relate("r against the turning of X, Y", k.signal("r"), k.course_rate(), {"r": 1, "hand": 1}, 0.15)
        if self.usable("X", "Y", "vx"):
            self.relate(
                "v_x against the speed of X, Y", k.signal("vx"), k.ground_speed(), {"vx": 1, "X": -1}, 0.03
            )
        if self.usable("vx", "vy", "r"):
            self._accelerations()
            self._wheel_speeds()
            self._steer_angle()
            self._torque()
        if self.usable("r") and not any("r" in relation.powers for relation in self.relations):
            self.unjudged.append(Unjudged("yaw rate", "no yaw, position or a_y that turns with it"))

    def _accelerations(self) -> None:
        k = self.k
        if self.usable("ax"):
            inertial = k.rate("vx") - k.of("vy r", lambda: k.columns["vy"] * k.columns["r"])
            self.relate("a_x against dv_x/dt - v_y r", k.signal("ax"), inertial, {"ax": 1, "vx": -1}, 0.12)
        if self.usable("ay"):
            turning = k.of("vx r", lambda: k.columns["vx"] * k.columns["r"])
            self.relate("a_y against v_x r", k.signal("ay"), turning, {"ay": 1, "vx": -1, "r": -1}, 0.15)

    def _wheel_speeds(self) -> None:
        for channel in self.k.columns:
            if channel.startswith("wheel_speed"):
                self.relate(
                    f"{channel} against v_x",
                    self.k.signal(channel),
                    self.k.signal("vx"),
                    {channel: 1, "vx": -1},
                    0.05,
                )

    def _steer_angle(self) -> None:
        """Fit delta = k L r/v_x + K v_x r + offset: understeer must not pass for a wrong scale."""
        if not self.usable("delta") or self.vehicle is None:
            return
        k, wheelbase = self.k, self.vehicle.wheelbase
        vx = np.where(k.moving, k.columns["vx"], np.nan)
        turn = k.of("L r/vx", lambda: wheelbase * k.columns["r"] / np.where(np.abs(vx) > 0, vx, 1.0))
        pull = k.of("vx r", lambda: k.columns["vx"] * k.columns["r"])
        use = k.moving & np.isfinite(turn) & np.isfinite(pull) & np.isfinite(k.signal("delta"))
        # The linear understeer holds for gentle driving only.
        gentle = np.abs(pull) < max(3.0, float(np.quantile(np.abs(pull[use]), 0.5)) if use.any() else 3.0)
        use &= gentle
        name = "delta against L r/v_x"
        if np.count_nonzero(use) < 200 or np.std(turn[use]) < 1e-4:
            self.unjudged.append(Unjudged(name, "the car hardly turns"))
            return
        design = np.stack([turn[use], pull[use], np.ones(np.count_nonzero(use))], axis=1)
        delta = k.signal("delta")[use]
        coefficients, errors = block_interval(
            lambda rows: np.linalg.lstsq(design[rows], delta[rows], rcond=None)[0], len(delta)
        )
        explained = np.corrcoef(design @ coefficients, delta)[0, 1] if np.std(delta) > 0 else 0.0
        if not explained > LEAST_CORRELATION or errors[0] > 0.3 * abs(coefficients[0]):
            self.unjudged.append(Unjudged(name, f"they correlate by {explained:.2f}, slope {coefficients[0]:.3g}"))
            return
        from split_cli.logs.kinematics import Slope

        slope = Slope(
            float(coefficients[0]),
            float(errors[0]),
            float(coefficients[2]),
            float(errors[2]),
            float(explained),
            len(delta),
        )
        self.relations.append(Relation(name, {"delta": 1, "r": -1, "vx": 1}, slope, 0.45))

    def _torque(self) -> None:
        if not self.usable("T") or self.vehicle is None:
            return
        k, car = self.k, self.vehicle
        force = car.mass * (k.rate("vx") - k.of("vy r", lambda: k.columns["vy"] * k.columns["r"]))
        force = force + car.drag_coefficient * k.signal("vx") ** 2
        self.relate(
            "T against the torque that dv_x/dt takes",
            k.signal("T"),
            car.wheel_radius * force,
            {"T": 1, "vx": -1},
            0.5,
        )

    def straight_line(self) -> list[Finding]:
        """Look for v_y and a_y that are not zero where the car goes straight."""
        k = self.k
        if not self.usable("vx", "r"):
            return []
        vx, r = k.signal("vx"), k.signal("r")
        straight = k.moving & (np.abs(vx * r) < _STRAIGHT_LATERAL) & (np.abs(k.rate("r")) < 0.1)
        straight &= np.abs(r) < max(0.02, 0.05 * float(np.nanquantile(np.abs(r), 0.95)))
        if np.count_nonzero(straight) * k.period < _STRAIGHT_SECONDS:
            self.unjudged.append(Unjudged("v_y and a_y on straights", "hardly any straight driving"))
            return []
        found = []
        if self.usable("vy"):
            found += self._vy_on_straights(straight, float(np.nanmedian(vx[straight])))
        if self.usable("ay"):
            plain = float(np.nanmedian(k.signal("ay")[straight]))
            rest = k.signal("ay") - k.of("vx r", lambda: k.columns["vx"] * k.columns["r"])
            bias, error = _median_of(rest[straight])
            tilt = np.degrees(np.arcsin(np.clip(bias / 9.80665, -1.0, 1.0)))
            if abs(bias) > 0.25 and abs(bias) > 4.0 * error:
                found.append(
                    Finding(
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

    def _vy_on_straights(self, straight: np.ndarray, speed: float) -> list[Finding]:
        # A hundredth of a radian of sideslip from rest of turning: v_y of a place at most 2 m from the CG.
        rest = self.k.signal("vy")[straight]
        bias, error = _median_of(rest)
        if abs(bias) <= max(0.03, 0.004 * abs(speed)) or abs(bias) <= 4.0 * error:
            return []
        angle = np.degrees(bias / speed)
        return [
            Finding(
                "bias on straights",
                "vy",
                f"v_y reads {bias:+.3f} +- {error:.3f} m/s on straights at a median {speed:.1f} m/s: an offset, "
                f"or a sensor turned by {-angle:+.2f} deg. Subtract it with `offset: {-bias:.3f}` for vy.",
                bias,
                error,
            )
        ]

    def sideslip_place(self) -> list[Finding]:
        """Tell from v_y = p r - q v_x^2 r + b at which distance p ahead of the rear axle v_y is measured.

        The rear tyres need the slip m l_f v_x r/(L C_r), so q > 0; at the CG p is l_r.
        """
        name = "place and sign of v_y"
        if self.vehicle is None or not self.usable("vx", "vy", "r"):
            return []
        k, car = self.k, self.vehicle
        vx, vy, r = k.signal("vx"), k.signal("vy"), k.signal("r")
        use = k.moving & np.isfinite(vx * vy * r) & (np.abs(vx * r) < 4.0)
        if np.count_nonzero(use) < 300:
            self.unjudged.append(Unjudged(name, "too little driving in the linear range"))
            return []
        design = np.stack([r[use], -(vx[use] ** 2) * r[use], np.ones(np.count_nonzero(use))], axis=1)
        target = vy[use]
        (p, q, _), (p_error, q_error, _) = block_interval(
            lambda rows: np.linalg.lstsq(design[rows], target[rows], rcond=None)[0], len(target)
        )
        if 3.0 * p_error > 0.5 * car.cg_to_rear_axle:
            self.unjudged.append(Unjudged(name, f"{p:.2f} +- {p_error:.2f} m ahead of the rear axle is too vague"))
            return []
        where = f"v_y follows a place {p:.2f} +- {p_error:.2f} m ahead of the rear axle"
        l_r = car.cg_to_rear_axle
        if q + 4.0 * q_error < 0.0 and p + 4.0 * p_error < 0.0:
            text = f"v_y turns its sign ({where}, its slip term {q:+.2g}): it is right-positive. Use `scale: -1`."
            return [Finding("sign", "vy", text, float(p / l_r), float(p_error / l_r))]
        if q > 0.0 and abs(p) < 0.3 * l_r and p + 4.0 * p_error < 0.6 * l_r:
            text = (
                f"{where}, the CG is at {l_r:.2f} m: it is measured at the rear axle. Set `position: rear_axle`."
            )
            return [Finding("place", "vy", text, float(p), float(p_error))]
        if q > 0.0 and p - 4.0 * p_error > 1.5 * l_r and abs(p - car.wheelbase) < 0.3 * car.wheelbase:
            text = f"{where}, the CG is at {l_r:.2f} m: it is near the front axle: `position: front_axle`."
            return [Finding("place", "vy", text, float(p), float(p_error))]
        return []

    def direction_of_travel(self) -> list[Finding]:
        """Compare yaw with the direction in which X, Y moves."""
        if not self.usable("X", "Y", "yaw", "vx", "vy"):
            return []
        k = self.k
        course = np.arctan2(k.rate("Y"), k.rate("X"))
        expected = k.signal("yaw") + np.arctan2(k.signal("vy"), k.signal("vx"))
        off = np.angle(np.exp(1j * (course - expected)))[k.moving]
        off = off[np.isfinite(off)]
        if len(off) < 50:
            return []
        centre = float(np.angle(np.mean(np.exp(1j * off))))
        spread = 1.4826 * float(np.median(np.abs(np.angle(np.exp(1j * (off - centre))))))
        if abs(centre) < 0.05 or abs(centre) < 2.0 * spread:
            if spread > 0.3:
                self.unjudged.append(
                    Unjudged("yaw against the travel of X, Y", f"they differ by {spread:.2f} rad at random")
                )
            return []
        text = (
            f"X, Y travels {np.degrees(centre):+.1f} deg off yaw (spread {np.degrees(spread):.1f} deg): yaw has "
            f"another zero than the map's X axis. Use `offset: {centre:.4f}` rad for yaw, or set `world:`."
        )
        return [Finding("direction", "yaw", text, centre, spread)]


def _median_of(values: np.ndarray) -> tuple[float, float]:
    values = values[np.isfinite(values)]
    median, error = block_interval(lambda rows: np.array([np.median(values[rows])]), len(values))
    return float(median[0]), float(error[0])


def _agreement(a: np.ndarray, b: np.ndarray) -> float:
    use = np.isfinite(a) & np.isfinite(b)
    if np.count_nonzero(use) < 50 or np.std(a[use]) == 0 or np.std(b[use]) == 0:
        return 0.0
    return float(np.corrcoef(a[use], b[use])[0, 1])
