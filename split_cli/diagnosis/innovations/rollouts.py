"""Open-loop rollouts of several models (stages) on held-out time, and their errors after up to 2 s."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from split_cli.diagnosis.baseline.discrepancy import SharedDiscrepancy
from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.innovations.objective import DiscrepancyPosterior
from split_cli.diagnosis.recording.series import Series, extended_model
from split_cli.learning.features import Z2, FeatureSet
from split_cli.learning.region import Grid
from split_cli.logs.drive import INPUT_CHANNELS, Drive, DriveMetadata
from split_cli.prediction import Predictor
from split_cli.scoring.application import Correction
from split_cli.scoring.noise import covariance_of_ends, white_noise
from split_cli.scoring.rollouts import hold_velocity, roll_out, rollout_starts
from split_cli.vehicle.effects import Term
from split_cli.vehicle.integration import acts_at_once, phi_matrix

HORIZONS = (0.5, 1.0, 2.0)  # [s]
_STEP_SECONDS = 0.05
_MOST_STARTS = 120
_FEWEST_STARTS = 5
# Shares of the discrepancy's derivative that are tried; the largest with which errors do not diverge is kept.
_SHARES = (1.0, 0.75, 0.5, 0.25, 0.125)
# The features of SPLIT, then the state of the rollout and the sample of the recording that it has reached.
_FEATURES = FeatureSet((*Z2.names, "vx", "vy", "r", "row"))


@dataclass(frozen=True)
class SharedRates:
    """Rates of the shared discrepancy along a recording, linearised in the velocities."""

    # (N, 3): rates at the recorded states, means over the sample that a row begins [m/s^2], [m/s^2], [rad/s^2].
    base: np.ndarray
    slope: np.ndarray  # (N, 3, 3): their derivative with respect to (v_x, v_y, r)
    around: np.ndarray  # (N, 3): states about which they are linearised

    def ahead(self, window: int) -> SharedRates:
        """Return the same with rates averaged over so many samples from each sample on."""
        total = np.cumsum(np.concatenate([np.zeros((1, 3)), self.base]), axis=0)
        last = np.minimum(np.arange(len(self.base)) + window, len(self.base))
        first = np.arange(len(self.base))
        return replace(self, base=(total[last] - total[first]) / (last - first)[:, None])

    def at(self, rows: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return rates, shape (M, 3), at velocities (M, 3) of a rollout and samples `rows` (M,) of the recording.

        The change by the derivative is bounded by the largest rate along the recording.
        """
        most = np.max(np.abs(self.base), axis=0)
        moved = np.einsum("nij,nj->ni", self.slope[rows], velocity - self.around[rows])
        return self.base[rows] + np.clip(moved, -most, most)

    def only(self, outputs: np.ndarray, sloped: np.ndarray) -> SharedRates:
        """Return the rates of some outputs, and derivatives of some of these, by masks of shape (3,)."""
        return replace(self, base=self.base * outputs, slope=self.slope * (outputs & sloped)[:, None])


def shared_rates(
    series: Series, discrepancy: SharedDiscrepancy, posterior: DiscrepancyPosterior | None, terms: Sequence[Term] = ()
) -> SharedRates | None:
    """Return the shared discrepancy along a recording, linearised in the velocities; None without a simulation.

    Parameters
    ----------
    terms : sequence of Term
        Terms that change inputs and sensors.

    Notes
    -----
    The simulation shows the rates at states that a driver visits; elsewhere they are extrapolated by the derivative.
    It is reduced so that the rollout stays as stable as the nominal model, see `_stable_slope`.
    """
    if posterior is None:
        return None
    base = discrepancy.rates_with_shared_terms(series, posterior.weights, terms)
    slope = np.empty((*base.shape, 3))
    for k in range(3):
        step = 1e-3 * max(float(np.std(series.predicted[:, k])), 1e-6)
        moved = replace(series, predicted=series.predicted + step * np.eye(3)[k])
        slope[:, :, k] = (discrepancy.rates_with_shared_terms(moved, posterior.weights, terms) - base) / step
    around = series.evaluated(terms)[1]
    jacobian = extended_model(discrepancy.vehicle).velocity_jacobian(
        *around.T, series.torque, series.steer_angle, yaw=series.yaw, t=series.t, s=series.s
    )
    return SharedRates(base, _stable_slope(slope, jacobian), around)


def _stable_slope(slope: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """Return the largest share of the derivatives (N, 3, 3) with which errors grow no faster, sample by sample.

    Notes
    -----
    The real parts of the eigenvalues of A + S are growth rates of errors, with the nominal Jacobian A and the
    derivative S. None may exceed the largest of A, or one e-folding over the longest horizon if that is larger.
    """
    grows = np.linalg.eigvals(jacobian).real.max(axis=1)
    bound = np.maximum(grows, 1.0 / HORIZONS[-1])
    out = np.zeros_like(slope)
    open_rows = np.arange(len(slope))
    for share in _SHARES:
        trial = share * slope[open_rows]
        good = np.linalg.eigvals(jacobian[open_rows] + trial).real.max(axis=1) <= bound[open_rows]
        out[open_rows[good]] = trial[good]
        open_rows = open_rows[~good]
    return out


@dataclass(frozen=True)
class RolloutErrors:
    """Errors of rollouts of several stages on one recording."""

    horizons: tuple[float, ...]  # [s]
    t: np.ndarray  # (S,): when each begins [s]
    squared: Mapping[str, np.ndarray]  # (S, H, 3): by stage; of v_x, v_y [m^2/s^2] and r [rad^2/s^2]
    # (S, H, 3): variance that sensor noise alone makes: at the start, carried along, and at the end.
    floor: np.ndarray
    # (S, H, 3): the errors themselves, model less recording [m/s], [m/s], [rad/s].
    signed: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class LearnedCorrection:
    """A correction by SPLIT, with the trust in it."""

    predictor: Predictor
    grid: Grid  # outside it nothing is predicted
    trust: np.ndarray  # (3,): share of the prediction that is applied, an output [1]

    def at(self, z: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return the correction at features z (M, 3), shape (M, 3) [m/s^2], [m/s^2], [rad/s^2].

        `rows`, the samples of the recording, is not used.
        """
        out = np.zeros((len(z), 3))
        inside = self.grid.index(z)[1]
        if inside.any() and np.any(self.trust):
            out[inside] = self.trust * self.predictor.mean(z[inside])
        return out


@dataclass(frozen=True)
class Stage:
    """One of the models that are compared: the nominal one with terms, shared discrepancy and correction."""

    terms: tuple[Term, ...]
    shared: SharedRates | None
    correction: LearnedCorrection | None = None


def roll_out_stages(
    evidence: Evidence,
    stages: Mapping[str, Stage],
    held: np.ndarray,
    *,
    horizons: tuple[float, ...] = HORIZONS,
    most_starts: int = _MOST_STARTS,
) -> RolloutErrors | None:
    """Roll out every stage from starts on held-out time; persistence is added for comparison.

    Parameters
    ----------
    held : ndarray of bool, shape (N,)
        Samples of held-out time.
    horizons : tuple of float
        Shortest first, in steps of 0.05 s [s].

    Returns
    -------
    RolloutErrors or None
        None where not even the shortest horizon fits into the held-out time.

    Notes
    -----
    The error of a diverging rollout is limited to that of driving the other way at the largest recorded velocity. So no
    start is left out in favour of a diverging model. Lags that are much shorter than a sample are left out of the
    model.
    """
    series = evidence.series
    window = max(1, round(_STEP_SECONDS / series.period))
    steps = [max(1, round(horizon / (window * series.period))) for horizon in horizons]
    plain = _drive(series, ())
    starts = np.empty(0, dtype=np.int64)
    while steps and len(starts) < _FEWEST_STARTS:
        length = steps[-1] * window
        starts = rollout_starts(plain, held, length, evidence.vehicle.minimum_speed, most_starts)
        if len(starts) < _FEWEST_STARTS:
            steps.pop()
    if not steps:
        return None
    at = np.array(steps) - 1
    z = _FEATURES.compute(extended_model(evidence.vehicle), plain)
    found = {}
    for names in _of_the_same_terms(stages):
        terms = stages[names[0]].terms
        drive = _drive(series, terms)
        added = _added([stages[name] for name in names], z, drive, window)
        followed = [one for one in terms if not acts_at_once(one, series.period)]
        model = extended_model(evidence.vehicle, followed)
        path = roll_out(model, drive, np.tile(starts, len(names)), steps[-1], window, added)
        for name, own in zip(names, np.split(path, len(names)), strict=True):
            found[name] = _errors(own[:, at], drive, starts, window, at)
    signed = {name: found[name] for name in stages}
    held_still = hold_velocity(plain, starts, steps[-1], window)
    signed["persistence"] = _errors(held_still[:, at], plain, starts, window, at)
    floor = _noise_alone(evidence, starts, window, at)
    most = 2.0 * np.max(np.abs(series.measured), axis=0)
    signed = {name: np.fmax(np.fmin(one, most), -most) for name, one in signed.items()}
    squared = {name: np.square(one) for name, one in signed.items()}
    return RolloutErrors(tuple(horizons[: len(steps)]), series.t[starts], squared, floor, signed)


def _drive(series: Series, terms: Sequence[Term]) -> Drive:
    """Return a recording for rollouts, corrected for the sensor faults among `terms`."""
    measured, _ = series.corrected(terms)
    columns = dict(zip(("vx", "vy", "r"), measured.T, strict=True))
    columns |= {"t": series.t, "s": series.s, "yaw": series.yaw}
    columns |= {name: series.drive[name] for name in INPUT_CHANNELS}
    columns["row"] = np.arange(len(series), dtype=float)
    between = DriveMetadata(between=series.drive.metadata.between)
    return Drive(series.name, columns, series.drive.segment, series.period, between)


def _of_the_same_terms(stages: Mapping[str, Stage]) -> list[list[str]]:
    """Return the names of stages with the same terms, which are rolled out together to save time."""
    groups: dict[tuple[int, ...], list[str]] = {}
    for name, stage in stages.items():
        groups.setdefault(tuple(map(id, stage.terms)), []).append(name)
    return list(groups.values())


def _added(stages: Sequence[Stage], z: np.ndarray, drive: Drive, window: int) -> Correction | None:
    """Return a correction that adds, to each stage's part of the starts, its discrepancy and its SPLIT."""
    if all(stage.shared is None and stage.correction is None for stage in stages):
        return None
    shared = [None if stage.shared is None else stage.shared.ahead(window) for stage in stages]
    count = len(Z2.names)
    recorded = z.copy()
    recorded[:, count : count + 3] = np.stack([drive[name] for name in ("vx", "vy", "r")], axis=1)

    def residual(at: np.ndarray) -> np.ndarray:
        out = []
        for stage, known, own in zip(stages, shared, np.split(at, len(stages)), strict=True):
            rows = np.rint(own[:, -1]).astype(np.int64)
            one = np.zeros((len(own), 3))
            if stage.correction is not None:
                one = stage.correction.at(own[:, :count], rows)
            if known is not None:
                one = one + known.at(rows, own[:, count : count + 3])
            out.append(one)
        return np.concatenate(out)

    return Correction(_FEATURES, recorded, residual)


def _errors(path: np.ndarray, drive: Drive, starts: np.ndarray, window: int, at: np.ndarray) -> np.ndarray:
    rows = starts[:, None] + window * (at + 1)
    truth = np.stack([drive[name][rows] for name in ("vx", "vy", "r")], axis=2)
    with np.errstate(over="ignore", invalid="ignore"):
        return path - truth


def _noise_alone(evidence: Evidence, starts: np.ndarray, window: int, at: np.ndarray) -> np.ndarray:
    """Return the variance of rollout errors that noise of the first and the last sample causes, shape (S, H, 3).

    Notes
    -----
    Noise of the first sample is propagated by the product of exp(A h) = I + h A Phi along the recorded states.
    """
    horizon = window * evidence.series.period
    carried = np.tile(np.eye(3), (len(starts), 1, 1))
    noise = white_noise(evidence.series.noise)
    out = []
    for step in range(int(at[-1]) + 1):
        A = evidence.linear.jacobian[starts + step * window]
        carried = carried + horizon * A @ phi_matrix(A, horizon) @ carried
        if step in at:
            ends = covariance_of_ends(carried, noise, (step + 1) * window)
            out.append(np.diagonal(ends, axis1=1, axis2=2))
    return np.stack(out, axis=1)
