"""`Evidence`: whitened residuals of one recording against a model, in rows of unit variance.

The difference between measured motion and a model's rates (the defects) is filtered by a `Whitener`. Noise is taken
from the recording, and the disturbance is estimated by maximum likelihood. Rows at which wheels spin or lock, and the
first of each segment, have weight 0.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from split_cli.diagnosis.baseline.discrepancy import SharedDiscrepancy
from split_cli.diagnosis.cache import RecentResults
from split_cli.diagnosis.innovations.linearisation import Linearisation, linearise, slopes
from split_cli.diagnosis.innovations.noise_memory import noise_model
from split_cli.diagnosis.innovations.whitening import Whitener, build_whitener, cost_by_disturbance
from split_cli.diagnosis.policy import STANDARD, Believing
from split_cli.diagnosis.recording.series import REMEMBERED, Series, extended_model, predicted_by_model
from split_cli.vehicle.effects import Term
from split_cli.vehicle.parameters import Vehicle

ROW_SECONDS = 0.04
"""Length of a row: transitions are summed over it [s]. Judgement: four samples at 100 Hz."""
_TUNING_ROWS = 9000
"""Samples from which the disturbance is estimated, at most [1]: 90 s at 100 Hz. Judgement: computing time."""
_KEPT_BYTES = 2**27
"""Largest size of the discrepancy's columns that are kept between filters [bytes]; larger ones are computed for each.
Judgement: 30,000 samples, well under the 1 GB of a diagnosis. It affects time and memory, and no result."""


@dataclass(frozen=True)
class Evidence:
    """Whitened rows of one recording, and what is needed to compute those of another model."""

    vehicle: Vehicle
    series: Series
    linear: Linearisation  # of the nominal model, or of one with the terms found so far, at the predicted states
    whitener: Whitener
    nominal_rows: np.ndarray  # (G, 3): whitened rows against the nominal model with the shared terms
    discrepancy: np.ndarray  # (G, 3, C): whitened columns of the shared discrepancy
    at: np.ndarray  # int64 (G,): sample in the middle of each row
    disturbance: np.ndarray  # (3,): variance per second of unmodelled disturbances, see `build_whitener`
    # (G,): root of the robust weight of a row; 0 where wheels spin or lock or a segment begins: it is not compared.
    weight: np.ndarray
    rolls: np.ndarray  # bool (N,): where the wheels roll, see `rolling`
    # Lags and similar effects that the simulation has too, part of every model here; see `shared_terms_of`.
    shared_terms: tuple[Term, ...] = ()
    # A cache; a copy with other arrays begins with an empty one.
    _moved_cache: RecentResults[tuple[np.ndarray, ...]] = field(
        default_factory=lambda: RecentResults(REMEMBERED), init=False, repr=False, compare=False
    )

    def rows(self, terms: Sequence[Term], discrepancy_rates: np.ndarray | None = None) -> np.ndarray:
        """Return the whitened rows, shape (G, 3), of `defects`."""
        return self.whitener(self.defects(terms, discrepancy_rates))

    def rows_of_each(
        self, several: Sequence[Sequence[Term]], discrepancy_rates: Sequence[np.ndarray | None]
    ) -> np.ndarray:
        """Return `rows` of several lists of terms, filtered together, shape (G, 3, number of lists)."""
        defects = np.empty((len(self.series) - 1, 3, len(several)))
        for k, (terms, rates) in enumerate(zip(several, discrepancy_rates, strict=True)):
            defects[:, :, k] = self.defects(terms, rates)
        return self.whitener(defects)

    def defects(self, terms: Sequence[Term], discrepancy_rates: np.ndarray | None = None) -> np.ndarray:
        """Return the defects that a model of `terms` and the shared terms leaves, shape (N - 1, 3); 0 over gaps.

        Parameters
        ----------
        discrepancy_rates : ndarray, shape (N, 3), optional
            What the shared discrepancy adds to the rates of the model [m/s^2], [m/s^2], [rad/s^2].

        Notes
        -----
        z_k = y_{k+1} - y_k - P (h f + (h/2) (a_k + a_{k+1})), with y the measured velocities, f the model's rates at
        the predicted ones and h the sample period. a is the answer of the linearised model to the deviation d, measured
        less predicted: A d, or what has built up of it (`Linearisation.of_deviation`). P leads from rates in the middle
        of the sample to those over all of it (`Linearisation.to_motion`). A steer angle that changes within a sample
        adds `Linearisation.of_first_moment`.
        """
        measured, predicted = self.series.evaluated(terms)
        every = (*terms, *self.shared_terms)
        by_model = _by_model(self.vehicle, self.series, self.linear, every, predicted, discrepancy_rates)
        return self._moved(measured, predicted) - by_model

    def rates_left(self, terms: Sequence[Term], discrepancy_rates: np.ndarray | None = None) -> np.ndarray:
        """Return `defects` as rates in the middle of the samples, (N - 1, 3) [m/s^2], [m/s^2], [rad/s^2]."""
        left, P = self.defects(terms, discrepancy_rates) / self.series.period, self.linear.to_motion
        return left if P is None else np.linalg.solve(P, left[:, :, None])[:, :, 0]

    def _moved(self, measured: np.ndarray, predicted: np.ndarray) -> np.ndarray:
        # The velocities are kept in the cache, so that their ids stay unique.
        made = self._moved_cache(
            (id(measured), id(predicted)),
            lambda: (motion(self.series, self.linear, measured, predicted), measured, predicted),
        )
        return made[0]


def motion(series: Series, linear: Linearisation, measured: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Return the measured motion that a model's rates at the predicted states should equal, (N - 1, 3); 0 over gaps.

    Parameters
    ----------
    linear : Linearisation
        Of a model at the predicted states.
    measured, predicted : ndarray, shape (N, 3)

    Notes
    -----
    The model is evaluated at predicted states, and its linearisation leads from there to the measured ones. So sensor
    noise enters linearly, as the whitener assumes.
    """
    carried = linear.of_deviation(measured - predicted)
    halfway = 0.5 * series.period * (carried[1:] + carried[:-1])
    out = np.diff(measured, axis=0) - _to_motion(linear, halfway)
    out[~series.inside()] = 0.0
    return out


def integrated(series: Series, columns: np.ndarray, linear: Linearisation) -> np.ndarray:
    """Return the motion by rates (N, 3, ...) in the middle of samples, shape (N - 1, 3, ...); 0 over gaps."""
    out = series.period * columns[:-1]
    out[~series.inside()] = 0.0
    return _to_motion(linear, out)


def _to_motion(linear: Linearisation, halfway: np.ndarray) -> np.ndarray:
    """Return P times rates in the middle of samples times the period, shape (N - 1, 3, ...)."""
    if linear.to_motion is None:
        return halfway
    if halfway.ndim == 2:
        return np.einsum("nij,nj->ni", linear.to_motion, halfway)
    return linear.to_motion @ halfway


def _by_model(
    vehicle: Vehicle,
    series: Series,
    linear: Linearisation,
    terms: Sequence[Term],
    predicted: np.ndarray,
    further_rates: np.ndarray | None = None,
) -> np.ndarray:
    """Return the motion, (N - 1, 3), that a model of terms expects, with further rates (N, 3) beside its own.

    Steering that changes within samples adds `Linearisation.of_first_moment`.
    """
    rates = series.rates(extended_model(vehicle, terms), predicted)
    out = integrated(series, rates if further_rates is None else rates + further_rates, linear)
    return out if linear.by_steer is None else out + linear.of_first_moment(series.steer_first_moment(vehicle, terms))


def _integrated_blocks(series: Series, discrepancy: SharedDiscrepancy, linear: Linearisation) -> Iterator[np.ndarray]:
    """Yield the discrepancy's columns integrated over each transition, a few at a time, (N - 1, 3, c)."""
    return (integrated(series, block, linear) for block in discrepancy.blocks(series))


def _whitened_blocks(whitener: Whitener, blocks: Iterable[np.ndarray]) -> np.ndarray:
    """Return the whitened rows, shape (G, 3, C), of blocks of columns, shape (N - 1, 3, c) each."""
    return np.concatenate([whitener(block) for block in blocks], axis=2)


def gather_evidence(
    vehicle: Vehicle,
    series: Series,
    discrepancy: SharedDiscrepancy,
    least_disturbance: np.ndarray | None = None,
    rules: Believing = STANDARD.believing,
    predicting: Sequence[Term] | None = None,
    settling: Sequence[Term] | None = None,
    explaining: Sequence[Term] = (),
    weights: np.ndarray | None = None,
) -> Evidence:
    """Whiten a recording; the variance of the disturbances is estimated by maximum likelihood.

    Parameters
    ----------
    least_disturbance : ndarray, shape (3,), optional
        Lower bound, for example of the simulated recordings.
    predicting : sequence of Term, optional
        Terms of the model that predicts states from earlier samples, and of its linearisation; by default the shared
        terms of the discrepancy.
    settling : sequence of Term, optional
        Terms whose lags decide how long a segment's begin is left out; by default `predicting`.
    explaining : sequence of Term, optional
        An explanation beside the shared terms. What it leaves gives the disturbance and the robust weights; what
        it explains would count as disturbance, where it is no function of the operating point, as a lag.
    weights : ndarray, shape (C,), optional
        Weights of the discrepancy, which then predicts states and is linearised with the model.
    """
    predicting = discrepancy.shared_terms if predicting is None else predicting
    # At velocities that are corrected for faults of sensors, where the tyres really are.
    added = None if weights is None else partial(discrepancy.rates, weights=weights, terms=explaining)
    series = predicted_by_model(series, vehicle, _samples_of_a_row(series), predicting, added)
    linear = linearise(vehicle, series, predicting, 0.0 if added is None else slopes(added, series))
    model = noise_model(linear)
    shared = discrepancy.shared_terms

    def left_by(terms: Sequence[Term]) -> np.ndarray:
        measured, predicted = series.evaluated(terms)
        return motion(series, linear, measured, predicted) - _by_model(
            vehicle, series, linear, (*terms, *shared), predicted
        )

    plain = left_by(())
    unexplained = left_by(explaining) if explaining else plain
    group, at = _row_groups(series)
    rolls = rolling(series, vehicle, rules)
    begins = _begins_anew(series, rolls)
    kept = np.ones(len(at), dtype=bool)
    settled = _has_settled(series, predicting if settling is None else settling, rules)
    kept[group[(group >= 0) & ~(rolls & settled)[:-1]]] = False
    disturbance = np.full(3, 1e-2) * np.array([1.0, 1.0, vehicle.mass / vehicle.yaw_inertia])
    held = discrepancy.size(series) <= _KEPT_BYTES
    held_blocks = list(_integrated_blocks(series, discrepancy, linear)) if held else []
    for _ in range(2):
        whitener = build_whitener(model, series.stated_noise, disturbance, series.period, begins, group)
        columns = _whitened_blocks(whitener, held_blocks or _integrated_blocks(series, discrepancy, linear))
        w = _discrepancy_weights(whitener(unexplained), columns, kept)
        left = unexplained - integrated(series, discrepancy.rates(series, w), linear)
        disturbance = _likely_disturbance(series, model, left, begins, rolls, disturbance)
        if least_disturbance is not None:
            disturbance = np.maximum(disturbance, least_disturbance)
    whitener = build_whitener(model, series.stated_noise, disturbance, series.period, begins, group)
    u, phi = whitener(plain), _whitened_blocks(whitener, held_blocks or _integrated_blocks(series, discrepancy, linear))
    left = u if unexplained is plain else whitener(unexplained)
    left = left - phi @ _discrepancy_weights(left, phi, kept)
    weight = _robust_weight(left, rules.huber) * kept
    return Evidence(vehicle, series, linear, whitener, u, phi, at, disturbance, weight, rolls, shared)


def rewhitened_with_noise(
    one: Evidence, noise: np.ndarray, disturbance: np.ndarray, discrepancy: SharedDiscrepancy
) -> Evidence:
    """Whiten a recording as if it had at least this noise and disturbance, shape (3,) each.

    A simulation without noise would otherwise be taken as exact, and its whitening filter would weight other
    frequencies than that of the real recordings.
    """
    series = one.series
    whitener = build_whitener(
        noise_model(one.linear),
        np.maximum(series.stated_noise, noise),
        np.maximum(one.disturbance, disturbance),
        series.period,
        one.whitener.begins,
        one.whitener.group,
    )
    columns = _whitened_blocks(whitener, _integrated_blocks(series, discrepancy, one.linear))
    return replace(one, whitener=whitener, nominal_rows=whitener(one.defects(())), discrepancy=columns)


def rolling(series: Series, vehicle: Vehicle, rules: Believing = STANDARD.believing) -> np.ndarray:
    """Return where the wheels roll, bool (N,); a single track models neither spinning nor locked wheels.

    They do not roll where most of an axle's peak force is demanded and the car accelerates by less than demanded. Load
    transfer and downforce would give more. They do not roll either where the demand rises to the limit and falls again
    within moments, as under a slip control.
    """
    model = extended_model(vehicle)
    flow = series.flow(model)
    axles = (flow.front, flow.rear)
    used = np.maximum(*(np.abs(axle.longitudinal_force) / axle.D for axle in axles))
    asked = sum(axle.longitudinal_force for axle in axles) + 0.0 * series.t
    got = vehicle.mass * (np.gradient(series.smooth[:, 0], series.period) - model.balance(flow)[0])
    reach = max(1, int(round(rules.rolling_seconds / series.period)))
    lost, wanted = (uniform_filter1d(one, reach + 1) for one in (-np.sign(asked) * got, np.abs(asked)))
    slipping = (used > rules.rolling_share) & (lost > rules.lost_share * wanted)
    slipping |= _cycling([np.asarray(axle.longitudinal_force) / axle.D for axle in axles], used, series.period, rules)
    rolls = ~maximum_filter1d(slipping, 2 * reach + 1)
    # If the demand exceeds the limit most of the time, the tyres of the vehicle file are wrong.
    return rolls if rolls.mean() > rules.least_rolling else np.ones_like(rolls)


def _cycling(asked: Sequence[np.ndarray], used: np.ndarray, period: float, rules: Believing) -> np.ndarray:
    """Return where an axle's demanded longitudinal force, over its peak, rises and falls near the limit, bool (N,)."""
    window = max(3, int(round(rules.cycling_seconds / period)))

    def travel(steps: np.ndarray) -> np.ndarray:
        return window * uniform_filter1d(np.maximum(steps, 0.0), window)

    steps = [np.diff(one, prepend=one[0]) for one in asked]
    swing = np.maximum(*(np.minimum(travel(one), travel(-one)) for one in steps))
    return (swing > rules.cycling_share) & (maximum_filter1d(used, window) > rules.rolling_share)


def _has_settled(series: Series, terms: Sequence[Term], rules: Believing) -> np.ndarray:
    """Return which samples lie late enough in their segment that its beginning no longer matters, bool (N,).

    A model begins a segment in steady state. The real angle of the wheels, the torque that had arrived and the tyres'
    forces answer to commands that were not recorded. What is unknown of them decays with the lags of `terms`: those of
    the torque along the car, and those of steering and tyres, which follow each other, across it.
    """
    out = np.ones(len(series), dtype=bool)
    along = [one for one in terms if one.family == "along"]
    across = [one for one in terms if one not in along]
    for begin, end in series.recording.segments:
        speed = abs(float(series.smooth[begin, 0]))
        slowest = max(_time_constant(along, speed), _time_constant(across, speed))
        out[begin : min(begin + round(rules.settling * slowest / series.period), end)] = False
    return out


def _time_constant(terms: Sequence[Term], speed: float) -> float:
    """Return the sum of the time constants of terms that act one after another, at a speed [m/s], in s."""
    rates = [one.fastest_rate(speed) for one in terms]
    return sum(1.0 / rate for rate in rates if rate > 0.0)


def _begins_anew(series: Series, rolls: np.ndarray) -> np.ndarray:
    """Return transitions at which the filter restarts, bool (N - 1,): after gaps, and when wheels roll again."""
    again = np.diff(rolls.astype(np.int8), prepend=1)[:-1] > 0
    return series.transitions_begin() | again


def _discrepancy_weights(rows: np.ndarray, columns: np.ndarray, kept: np.ndarray) -> np.ndarray:
    return ridge(columns[kept].reshape(-1, columns.shape[2]), rows[kept].reshape(-1))


def weighted_rows(several: Sequence[Evidence], rows: Sequence[np.ndarray]) -> np.ndarray:
    """Return rows (G, 3, ...) of several recordings times the roots of their robust weights, shape (R, ...)."""
    flat = [part.reshape(-1, *part.shape[2:]) for part in rows]
    roots = [
        np.repeat(one.weight, 3).reshape(-1, *(1,) * (part.ndim - 1)) for one, part in zip(several, flat, strict=True)
    ]
    return np.concatenate([part * root for part, root in zip(flat, roots, strict=True)])


def ridge(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the posterior mean of weights, shape (C,), with standard normal priors, from whitened columns and rows."""
    precision = columns.T @ columns + np.eye(columns.shape[1])
    return np.linalg.solve(precision, columns.T @ target)


def _samples_of_a_row(series: Series) -> int:
    return max(1, int(round(ROW_SECONDS / series.period)))


def _row_groups(series: Series) -> tuple[np.ndarray, np.ndarray]:
    """Return the row number of each transition, (N - 1,), and the middle sample of each row, (G,).

    The transitions of a rest at the end of a segment have the number -1.
    """
    size = _samples_of_a_row(series)
    group = np.full(len(series) - 1, -1, dtype=np.int64)
    at, number = [], 0
    for begin, end in series.recording.segments:
        rows = (end - 1 - begin) // size
        group[begin : begin + rows * size] = number + np.repeat(np.arange(rows), size)
        at.append(begin + size // 2 + size * np.arange(rows))
        number += rows
    return group, np.concatenate(at).astype(np.int64)


def _robust_weight(rows: np.ndarray, most: float) -> np.ndarray:
    """Return roots of Huber weights of rows (G, 3), shape (G,), with the limit of `most` robust deviations."""
    spread = 1.4826 * np.median(np.abs(rows), axis=0) + 1e-12
    worst = np.max(np.abs(rows) / spread, axis=1)
    return np.sqrt(np.minimum(1.0, most / np.maximum(worst, 1e-12)))


def _likely_disturbance(series, model, defect, begins, rolls, start) -> np.ndarray:
    """Return the disturbance's variance per second, (3,), of largest likelihood on at most `_TUNING_ROWS` samples.

    A search in powers of ten, channel by channel, on defects that are clipped at six robust deviations.
    """
    used = np.flatnonzero(rolls[1:])[:_TUNING_ROWS]
    begins = begins[used] | (np.diff(used, prepend=used[0]) > 1)
    clipped = defect[used]
    spread = 6.0 * 1.4826 * np.median(np.abs(clipped), axis=0) + 1e-12
    clipped = np.clip(clipped, -spread, spread)
    found = np.log10(np.asarray(start, dtype=float))
    cost = cost_by_disturbance(clipped, model.at(used), series.stated_noise, series.period, begins)
    least = cost(10.0**found)
    for width in (2.0, 1.0, 0.5, 0.25):
        for channel in range(3):
            trials = [(least, found)]
            for shift in (-width, width):
                logs = found.copy()
                logs[channel] += shift
                trials.append((cost(10.0**logs), logs))
            least, found = min(trials, key=lambda trial: trial[0])
    return 10.0 ** np.clip(found, -9.0, 4.0)
