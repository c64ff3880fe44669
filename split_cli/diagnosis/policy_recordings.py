"""Constants of the policy for recordings: screening, slipping wheels and noise, lines of the spectrum."""

from dataclasses import dataclass

from split_cli.diagnosis.policy_numbers import CHOSEN, JUDGEMENT, THEORY, number


@dataclass(frozen=True)
class Screening:
    """What a drive must be before it is judged; what is left out of it."""

    least_seconds: float = number(8.0, "s", "longest run without a gap below which a drive is refused", CHOSEN)
    longest_period: float = number(
        0.1, "s", "sample period above which a drive is refused", JUDGEMENT + "a yaw mode of 1 to 2 Hz needs ten"
    )
    least_fast: float = number(0.2, "1", "share of the time at a valid speed below which a drive is refused", CHOSEN)
    valid_speed: float = number(
        0.6, "1", "speed over the vehicle's minimum speed from which on rows are compared", CHOSEN
    )
    crawl: float = number(
        0.5, "1", "the same below which rows are left out before anything is computed", JUDGEMENT + "below the one"
    )
    shortest_run: float = number(
        0.5, "s", "length below which a run between crawling is left out", THEORY + "longer than a smoothing window"
    )
    stuck_seconds: float = number(1.0, "s", "time after which a velocity that repeats itself stands still", CHOSEN)
    turn_spread: float = number(
        0.3,
        "1",
        "spread of yaw rate that speed does not explain, over its mean, below which steering is held on purpose",
        JUDGEMENT + "a steered car's varies by all of its mean, real circles leave 0.05 to 0.15",
    )
    held_seconds: float = number(3.0, "s", "the same for a steer angle, which drivers hold", CHOSEN)
    answer_seconds: float = number(
        2.0,
        "s",
        "time in which a car answers a step of an input: what torque does more slowly, resistance balances",
        JUDGEMENT + "a driver's torque steps last less, a change of speed that alters resistance takes longer",
    )
    position_gap_seconds: float = number(0.5, "s", "gap of position and yaw that is filled by straight lines", CHOSEN)
    least_torque: float = number(0.05, "1", "range of torque over the car's largest below which it is constant", CHOSEN)
    least_acceleration: float = number(
        0.5,
        "m/s^2",
        "lateral acceleration, or gain and loss of speed, without which nothing was excited",
        JUDGEMENT + "drag and rolling resistance change the speed of a coasting car by less",
    )
    still_share: float = number(
        0.1, "1", "motion of a channel over its usual size below which it counts as none", CHOSEN
    )
    gentle_from: float = number(
        0.02, "1", "lateral acceleration over grip from which on steering is compared with the file", CHOSEN
    )
    gentle_to: float = number(
        0.4, "1", "the same up to which it is compared", JUDGEMENT + "a tyre is nearly linear up to there"
    )
    fewest_rows: int = number(
        100, "samples", "rows below which steering and torque are not compared with the file", CHOSEN
    )
    another_steering: float = number(
        5.0 / 3.0,
        "1",
        "steering over what the file makes of it, or the reverse, from which on it is another car",
        CHOSEN,
    )
    another_torque: float = number(
        2.0, "1", "factor between acceleration by torque and what the file makes of it, likewise", CHOSEN
    )
    least_correlation: float = number(
        0.7, "1", "correlation below which such a factor is not judged", JUDGEMENT + "half the variance explained"
    )
    least_scale_error: float = number(
        0.01, "1", "error of a sensor's scale that is reported", JUDGEMENT + "wheels wear and gyroscopes drift by less"
    )
    late_samples: float = number(
        2.0,
        "samples",
        "delay against position from which on a velocity that was derived from it has been shifted since",
        JUDGEMENT + "differences and filters leave less than one",
    )
    sure_scale_error: float = number(6.0, "standard errors", "size of that error from which on it is reported", CHOSEN)

    @property
    def least_surge(self) -> float:
        """Range of a car's acceleration from losing to gaining speed, `least_acceleration` each [m/s^2]."""
        return 2.0 * self.least_acceleration


@dataclass(frozen=True)
class Believing:
    """How far rows are believed: wheels that slip, noise of a simulation, and where motion alone compares."""

    rolling_share: float = number(
        0.9, "1", "share of an axle's peak force asked for, from which on wheels may spin or lock", CHOSEN
    )
    lost_share: float = number(0.1, "1", "share of the force asked for that is lost while they do", CHOSEN)
    rolling_seconds: float = number(0.2, "s", "time that wheels take to roll again", CHOSEN)
    least_rolling: float = number(
        0.5,
        "1",
        "share of the time below which the vehicle file is wrong about the tyres instead",
        JUDGEMENT + "no driver slips half the time",
    )
    cycling_seconds: float = number(0.3, "s", "time in which a slip control goes back and forth", CHOSEN)
    cycling_share: float = number(
        0.8, "1", "share of the peak force by which a slip control goes back and forth", CHOSEN
    )
    settling: float = number(
        3.0,
        "time constants",
        "begin of a stretch that is not compared, since nothing recorded shows where its actuators and tyres began",
        JUDGEMENT + "5 % of what is unknown is left",
    )
    least_noise: float = number(
        1e-3,
        "1",
        "least variance that a whitened residual of a simulation is believed to have",
        JUDGEMENT + "no dictionary holds the physics of a real car",
    )
    most_noise: float = number(5.0, "1", "largest variance of the same, beyond which nothing is known", CHOSEN)
    motion_share: float = number(
        0.7, "1", "share of the tyres' peak up to which rows that moved the same are compared", CHOSEN
    )
    huber: float = number(
        4.0,
        "spreads",
        "whitened residual from which on a row loses weight; how far an accelerometer's samples jump in a window, "
        "over what is usual, from which on it is no witness",
        JUDGEMENT + "far outside the normal",
    )


@dataclass(frozen=True)
class Unnamed:
    """Lines of the spectrum and residual autocorrelation: what is no smooth function of the operating point."""

    slowest: float = number(
        3.0, "Hz", "least frequency of a line in time, for a full-size car", JUDGEMENT + "drivers steer slower"
    )
    longest: float = number(4.0, "wheelbases", "longest wave over distance", JUDGEMENT + "longer waves are the track's")
    fewest: int = number(2048, "samples", "length of a recording below which no line is sought", CHOSEN)
