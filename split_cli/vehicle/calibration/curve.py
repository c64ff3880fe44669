"""One axle's lateral force curve from samples: the fit, what the samples cover, and what they leave open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.errors import VehicleError
from split_cli.vehicle.calibration.least_squares import LeastSquaresFit, block_weights, solve
from split_cli.vehicle.tire import MagicFormula, lateral_force, lateral_force_slope

_C_BOUNDS = (1.0, 1.95)
_FOLDS = 5
_PROFILE_POINTS = 25
# A 95 % interval of the likelihood ratio with one parameter: half the chi-squared quantile.
_HALF_CHI2 = 1.9207
#: Of the largest force, from which on a curve that stays below it is not the axle's [1]. Judgement.
_SHORT_OF = 0.95
_MINIMUM_SAMPLES = 60
_MINIMUM_BLOCKS = 6


@dataclass(frozen=True)
class HeldOutError:
    """Errors on blocks of time that the fit did not see, pooled over five folds."""

    calibrated: float  # root mean square of measured minus calibrated [N]
    start: float  # the same for the vehicle one started from [N]
    signal: float  # root mean square of what was measured [N]: the error of predicting 0


@dataclass(frozen=True)
class ForceCurve:
    """What drives say about one axle's lateral force."""

    axle: str  # ``front`` or ``rear``
    tire: MagicFormula  # the calibrated coefficients, or the start's where not even the slope is settled
    # Which of B, C, D the data settle; the others were given. Empty when the start's tyre is kept.
    determined: tuple[str, ...]
    slip_offset: float  # added to the measured slip angle [rad]; 0 unless offsets were fitted
    covered: float  # the data reach |slip angle| up to here [rad]: the 99 % quantile
    # Slope that the data fit best, lower and upper end of its 95 % interval, at the given D [N/rad].
    cornering_stiffness: tuple[float, float, float]
    # Lower and upper end of the 95 % interval of D [N]; the upper is infinite where the data set no limit.
    peak: tuple[float, float]
    # slip_angle, force, lower, upper: (G,): the curve over 0 to alpha_max [rad], [N], and its 95 % confidence band
    # from resampled blocks [N].
    slip_angle: np.ndarray
    force: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    # alike_lower, alike_upper: (G,): envelope of all curves that fit equally well (within the 95 % likelihood
    # interval of D) [N].
    alike_lower: np.ndarray
    alike_upper: np.ndarray
    # deviation_covered, deviation_everywhere: largest distance between two equally good curves, inside the covered
    # slip angles and up to alpha_max [N].
    deviation_covered: float
    deviation_everywhere: float
    held_out: HeldOutError
    samples: int
    blocks: int
    remarks: tuple[str, ...]  # what the reader must know of the coefficients, in sentences
    slip_remarks: tuple[str, ...]  # the same of the slip angles, whatever coefficients are taken

    @property
    def slope_is_known(self) -> bool:
        """Whether the interval of the cornering stiffness ends within ten times its value."""
        middle, _, high = self.cornering_stiffness
        return high < 10.0 * middle


@dataclass(frozen=True)
class _Problem:
    """Samples of one axle and the parameters (log K, log D, C, offset), K = B C D the cornering stiffness.

    `noise_ratio` is the noise of a slip angle over that of a force [rad/N], 0 where slip angles are exact.
    """

    slip: np.ndarray
    force: np.ndarray
    block: np.ndarray
    noise_ratio: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    free: np.ndarray

    def residual(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the distance of each sample from the curve [N] and its Jacobian.

        Noise in the slip angle flattens the slope of an ordinary fit. The distance is model minus measured over
        sqrt(1 + (ratio F')^2), Deming's for a straight line; in the small correction itself F' is taken to grow
        with K alone.
        """
        K, D, C, offset = np.exp(p[0]), np.exp(p[1]), p[2], p[3]
        B = K / (C * D)
        alpha = self.slip + offset
        u = np.arctan(B * alpha)
        sine, cosine = np.sin(C * u), np.cos(C * u)
        by_B = D * cosine * C * alpha / (1.0 + (B * alpha) ** 2)
        jacobian = np.empty((len(alpha), 4))
        jacobian[:, 0] = by_B * B
        jacobian[:, 1] = D * sine - by_B * B
        jacobian[:, 2] = D * cosine * u - by_B * B / C
        slope = lateral_force_slope(B, C, D, alpha)
        jacobian[:, 3] = slope
        error = D * sine - self.force
        stretch = 1.0 + (self.noise_ratio * slope) ** 2
        jacobian[:, 0] -= error * (stretch - 1.0) / stretch
        root = np.sqrt(stretch)
        return error / root, jacobian / root[:, None]

    def fit(
        self,
        start: np.ndarray,
        free: Sequence[int] | np.ndarray | None = None,
        weight: np.ndarray | None = None,
        scale: float | None = None,
    ) -> LeastSquaresFit:
        free = self.free if free is None else np.asarray(free)
        return solve(self.residual, start, self.lower, self.upper, free=free, weight=weight, scale=scale)

    def part(self, keep: np.ndarray) -> _Problem:
        rows = {name: getattr(self, name)[keep] for name in ("slip", "force", "block", "noise_ratio")}
        return replace(self, **rows)

    def error(self, p: np.ndarray) -> np.ndarray:
        """Return model minus measured [N]."""
        residuals: np.ndarray = _curve(p, self.slip + p[3]) - self.force
        return residuals


def _tire(p: np.ndarray) -> MagicFormula:
    K, D, C = float(np.exp(p[0])), float(np.exp(p[1])), float(p[2])
    return MagicFormula(B=K / (C * D), C=C, D=D)


def fit_force_curve(
    axle: str,
    slip_angle: np.ndarray,
    force: np.ndarray,
    block: np.ndarray,
    start: MagicFormula,
    *,
    given_peak: float,
    static_load: float,
    largest_force: float = 0.0,
    slip_noise: np.ndarray | float = 0.0,
    alpha_max: float = 0.18,
    fit_offset: bool = False,
    draws: int = 200,
    seed: int = 0,
) -> ForceCurve:
    """Fit B, C, D to an axle's lateral force, as far as the samples settle them.

    Parameters
    ----------
    axle : str
        Name for reports.
    slip_angle, force : ndarray, shape (M,)
        Slip angle [rad] and lateral force [N], a positive angle with a positive force.
    block : ndarray of int, shape (M,)
        Block of time of each sample.
    start : MagicFormula
        Where to begin, and what C to take when the data do not settle it.
    given_peak : float
        D to take when the data do not settle it [N], usually friction times static load.
    static_load : float
        Of the axle [N]; D is sought up to four times of it.
    largest_force : float
        That the axle gave anywhere in the drives [N], also where samples are left out: D is not sought below.
    slip_noise : ndarray, shape (M,), or float
        Standard deviation of the noise in `slip_angle` [rad].
    alpha_max : float
        Up to where curves are compared [rad].
    fit_offset : bool
        Whether a constant is added to the slip angle (a steer or lateral-velocity offset of the sensors).
    draws, seed : int
        How often blocks are resampled for the confidence band, and the seed.

    Raises
    ------
    VehicleError
        If there are too few samples or blocks.

    Notes
    -----
    F_y = D sin(C atan(B alpha)). D is settled when its profile-likelihood interval, widened for correlation
    within blocks, lies within 15 % of the estimate, and the forces reach 85 % of it: a peak far above all forces
    would be the formula's word, not the tyre's. If not, D is given; C is settled when its standard error at
    that D is below 0.1, otherwise given too where that fits; the slope B C D is always fitted.

    No upper end of D is taken from a curve that bends below forces that the axle itself gave: forces that come later
    than their slip angles make loops, whose middle is flatter than the tyre.
    """
    problem = _problem_of(axle, slip_angle, force, block, static_load, largest_force, fit_offset)
    best = _best_fit(problem, start, given_peak)
    problem = replace(problem, noise_ratio=_noise_ratio(problem, best, problem.noise_ratio + slip_noise))
    best = problem.fit(best.parameters)
    profile = _profile(problem, best)
    if _bends_too_early(problem, best):
        profile = replace(profile, interval=(profile.interval[0], float("inf")))
    chosen, determined, remarks = _settle(problem, best, profile, start, given_peak, axle)
    offset = float(chosen.parameters[3])
    grid = np.linspace(0.0, alpha_max, 181)
    covered = float(np.quantile(np.abs(slip_angle + offset), 0.99))
    low, high = _resampled_band(problem, best, grid, draws, seed)
    slope_error = 1.96 * float(np.sqrt(chosen.covariance(problem.block)[0, 0]))
    alike = np.array([_curve(p, grid) for p in profile.alike])
    width = alike.max(axis=0) - alike.min(axis=0)
    tire = _tire(chosen.parameters)
    if "D" not in determined and profile.holds(given_peak):
        # What is given stays as it was, to the last digit.
        tire = MagicFormula(tire.cornering_stiffness / (tire.C * given_peak), tire.C, given_peak)
    stiffness = tire.cornering_stiffness * np.exp([0.0, -slope_error, slope_error])
    return ForceCurve(
        axle=axle,
        tire=tire,
        determined=determined,
        slip_offset=offset,
        covered=covered,
        cornering_stiffness=tuple(stiffness.tolist()),
        peak=profile.interval,
        slip_angle=grid,
        force=_curve(chosen.parameters, grid),
        lower=low,
        upper=high,
        alike_lower=alike.min(axis=0),
        alike_upper=alike.max(axis=0),
        deviation_covered=float(width[grid <= covered].max()),
        deviation_everywhere=float(width.max()),
        held_out=_held_out(problem, chosen, start),
        samples=len(slip_angle),
        blocks=len(np.unique(block)),
        remarks=tuple(remarks),
        slip_remarks=tuple(_offset_remark(problem, chosen, axle, fit_offset)),
    )


def _problem_of(
    axle: str,
    slip_angle: np.ndarray,
    force: np.ndarray,
    block: np.ndarray,
    static_load: float,
    largest_force: float,
    fit_offset: bool,
) -> _Problem:
    """Return the fit's samples and bounds, without noise in the slip angle."""
    blocks = len(np.unique(block))
    if len(slip_angle) < _MINIMUM_SAMPLES or blocks < _MINIMUM_BLOCKS:
        what = f"{len(slip_angle)} usable samples in {blocks} blocks of time are too few for the {axle} tyres"
        advice = f"At least {_MINIMUM_SAMPLES} samples in {_MINIMUM_BLOCKS} blocks are needed: give several drives, "
        advice += "or train with the tyres of the vehicle file."
        raise VehicleError(what, advice=advice)
    largest = max(largest_force, 0.9 * float(np.quantile(np.abs(force), 0.995)), 1e-9)
    lower = np.array([np.log(0.02 * static_load), np.log(largest), _C_BOUNDS[0], -0.1])
    upper = np.array([np.log(400.0 * static_load), np.log(4.0 * static_load + largest), _C_BOUNDS[1], 0.1])
    free = np.array([0, 1, 2, 3] if fit_offset else [0, 1, 2])
    return _Problem(slip_angle, force, block, np.zeros_like(slip_angle), lower, upper, free)


def _curve(p: np.ndarray, grid: np.ndarray) -> np.ndarray:
    tire = _tire(p)
    force: np.ndarray = lateral_force(tire.B, tire.C, tire.D, grid)
    return force


def _best_fit(problem: _Problem, start: MagicFormula, given_peak: float) -> LeastSquaresFit:
    """Fit from several peaks, since a flat valley can hold an iteration where it started.

    One start is what the samples show by themselves: the slope of a line through the lesser half of the forces,
    and the largest force as the peak.
    """
    begin = np.array([np.log(start.cornering_stiffness), np.log(start.D), np.clip(start.C, *_C_BOUNDS), 0.0])
    begins = [begin, *(np.array([begin[0], np.log(given_peak * f), 1.4, 0.0]) for f in (0.6, 1.0, 1.6))]
    size = np.abs(problem.force)
    gentle = size <= np.median(size)
    slope = float(problem.slip[gentle] @ problem.force[gentle] / max(float(np.sum(problem.slip[gentle] ** 2)), 1e-12))
    shown = np.log(np.maximum([slope, float(np.quantile(size, 0.995))], 1e-9))
    begins.append(np.clip([*shown, 1.4, 0.0], problem.lower, problem.upper))
    scale = problem.fit(begin).scale
    return min((problem.fit(p, scale=scale) for p in begins), key=lambda fit: fit.cost)


def _noise_ratio(problem: _Problem, fit: LeastSquaresFit, slip_noise: np.ndarray) -> np.ndarray:
    """Return slip noise over force noise, the latter what the scatter holds beside the former."""
    tire = _tire(fit.parameters)
    slope = lateral_force_slope(tire.B, tire.C, tire.D, problem.slip + fit.parameters[3])
    from_slip = float(np.mean((slope * slip_noise) ** 2))
    # At least a quarter of the scatter stays with the force: noise estimates are no better than that.
    force_noise = np.sqrt(max(fit.scale**2 - from_slip, 0.25 * fit.scale**2))
    ratio: np.ndarray = slip_noise / force_noise
    return ratio


@dataclass(frozen=True)
class _Profile:
    """Curves of given D: which of them fit equally well."""

    interval: tuple[float, float]
    alike: tuple[np.ndarray, ...]
    threshold: float

    def holds(self, peak: float) -> bool:
        """Whether a peak [N] lies where curves fit equally well."""
        return self.interval[0] <= peak <= self.interval[1]

    def nearest(self, peak: float) -> float:
        """Return the peak nearest to one that is given [N] that the data do not contradict."""
        return min(max(peak, self.interval[0]), self.interval[1])


def _profile(problem: _Problem, best: LeastSquaresFit) -> _Profile:
    others = problem.free[problem.free != 1]
    threshold = best.cost + _HALF_CHI2 * best.scale**2 * best.design_effect(problem.block)
    alike = [best.parameters]
    grid = np.linspace(problem.lower[1], problem.upper[1], _PROFILE_POINTS)
    ends = [float(best.parameters[1])] * 2
    open_ended = False
    for direction, values in ((0, grid[grid < best.parameters[1]][::-1]), (1, grid[grid > best.parameters[1]])):
        at, previous = best.parameters.copy(), best
        for value in values:
            at = at.copy()
            at[1] = value
            fit = problem.fit(at, free=others, scale=best.scale)
            if fit.cost > threshold:
                # Between the last inside and the first outside the cost is taken as linear.
                share = (threshold - previous.cost) / max(fit.cost - previous.cost, 1e-300)
                ends[direction] = float(previous.parameters[1] + share * (value - previous.parameters[1]))
                edge = problem.fit(_with_peak(fit.parameters, ends[direction]), free=others, scale=best.scale)
                alike.append(edge.parameters)
                break
            ends[direction] = float(value)
            alike.append(fit.parameters)
            at, previous = fit.parameters, fit
        else:
            open_ended = open_ended or direction == 1
    interval = (float(np.exp(ends[0])), float("inf") if open_ended else float(np.exp(ends[1])))
    return _Profile(interval, tuple(alike), threshold)


def _bends_too_early(problem: _Problem, best: LeastSquaresFit) -> bool:
    """Return whether the best curve gives less at the largest slip angles than the axle itself gave.

    Its D is then held up by the largest force alone. Forces that come later than their slip angles make loops, whose
    middle is flatter than the tyre, so the bend of the curve is no sign of the peak.
    """
    if best.parameters[1] > problem.lower[1] + 1e-3:
        return False
    covered = float(np.quantile(np.abs(problem.slip + best.parameters[3]), 0.99))
    return float(_curve(best.parameters, np.array([covered]))[0]) < _SHORT_OF * float(np.exp(problem.lower[1]))


def _with_peak(p: np.ndarray, log_peak: float) -> np.ndarray:
    moved = p.copy()
    moved[1] = log_peak
    return moved


def rounded(force: float) -> str:
    """Return a force with three digits, without a power of ten."""
    return f"{float(f'{force:.3g}'):g}"


def _settle(
    problem: _Problem, best: LeastSquaresFit, profile: _Profile, start: MagicFormula, given_peak: float, axle: str
) -> tuple[LeastSquaresFit, tuple[str, ...], list[str]]:
    """Choose how many coefficients the data may set."""
    low, high = profile.interval
    estimate = float(np.exp(best.parameters[1]))
    reached = float(np.quantile(np.abs(problem.force), 0.995))
    narrow = high <= 1.15 * estimate and low >= 0.85 * estimate and best.parameters[2] not in _C_BOUNDS
    if narrow and reached >= 0.85 * estimate:
        return best, ("B", "C", "D"), []
    limit = f"at least {rounded(low)} N" if np.isinf(high) else f"between {rounded(low)} and {rounded(high)} N"
    peak = profile.nearest(given_peak)
    of_the_file = given_peak == start.D
    given = f"{'D of the file' if of_the_file else 'Friction times static load'}, {rounded(given_peak)} N,"
    kept = f"{given} is {'kept' if of_the_file else 'taken as D'}, the slope B C D is fitted"
    if peak != given_peak:
        kept = f"{given} contradicts that: D = {rounded(peak)} N is taken"
    remarks = [f"{axle}: the peak is not identified: forces reach {rounded(reached)} N, D is {limit}. {kept}"]
    others = problem.free[problem.free != 1]
    held = problem.fit(_with_peak(best.parameters, np.log(peak)), free=others, scale=best.scale)
    error = np.sqrt(np.diag(held.covariance(problem.block))[list(held.free).index(2)])
    settled = error < 0.1 and held.parameters[2] not in _C_BOUNDS
    if settled and held.cost <= profile.threshold:
        return held, ("B", "C"), remarks
    fixed = _with_peak(best.parameters, np.log(peak))
    fixed[2] = np.clip(start.C, *_C_BOUNDS)
    slope_only = problem.fit(fixed, free=others[others != 2], scale=best.scale)
    chosen, determined = (held, ("B", "C")) if settled else (slope_only, ("B",))
    if not settled:
        remarks.append(f"{axle}: the curvature is not identified either, C = {fixed[2]:.3g} is given")
    if chosen.cost > profile.threshold:
        # A free fit would be closer where the drives went, and absurd where they did not.
        away = np.sqrt(2.0 * (chosen.cost - best.cost) / len(problem.slip))
        remarks.append(
            f"{axle}: with these kept, the curve is {away:.3g} N (rms) further from the data than the best fit"
        )
    return chosen, determined, remarks


def _resampled_band(
    problem: _Problem, best: LeastSquaresFit, grid: np.ndarray, draws: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pointwise 95 % band of the curves that resampled blocks give [N]."""
    curves = [_curve(best.parameters, grid)]
    for weight in block_weights(problem.block, draws, seed):
        fit = problem.fit(best.parameters, weight=weight, scale=best.scale)
        curves.append(_curve(fit.parameters, grid))
    low, high = np.quantile(curves, [0.025, 0.975], axis=0)
    # Resampling B blocks sees B/(B - P) too little variance, as a plain variance of residuals does.
    blocks = len(np.unique(problem.block))
    widen = np.sqrt(blocks / max(blocks - len(best.free), 1))
    return curves[0] + widen * (low - curves[0]), curves[0] + widen * (high - curves[0])


def _held_out(problem: _Problem, chosen: LeastSquaresFit, start: MagicFormula) -> HeldOutError:
    """Refit without each fifth of the blocks and predict it."""
    _, index = np.unique(problem.block, return_inverse=True)
    squares = np.zeros(len(problem.slip))
    for fold in range(_FOLDS):
        out = index % _FOLDS == fold
        fit = problem.part(~out).fit(chosen.parameters, free=chosen.free)
        squares[out] = problem.part(out).error(fit.parameters) ** 2
    before = lateral_force(start.B, start.C, start.D, problem.slip) - problem.force
    return HeldOutError(
        calibrated=float(np.sqrt(squares.mean())),
        start=float(np.sqrt(np.mean(before**2))),
        signal=float(np.sqrt(np.mean(problem.force**2))),
    )


def _offset_remark(problem: _Problem, chosen: LeastSquaresFit, axle: str, fitted: bool) -> list[str]:
    """Return by how much slip angles are off, if that is beyond chance and large enough to bend the curve."""
    found = chosen if fitted else problem.fit(chosen.parameters, free=np.append(chosen.free, 3), scale=chosen.scale)
    offset = float(found.parameters[3])
    error = float(np.sqrt(found.covariance(problem.block)[-1, -1]))
    if abs(offset) <= 3.0 * error or abs(offset) <= 0.002:
        return []
    return [
        f"{axle}: slip angles seem off by {-offset:+.4f} +- {2 * error:.4f} rad (lateral velocity or steer offset). "
        "The curve was fitted with such an offset beside it; correct it in the signal map"
    ]
