"""Whitened evidence of a recording: what it says against a model, one row of unit noise after another."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from split_cli.diagnosis.baseline.discrepancy import SharedDiscrepancy
from split_cli.diagnosis.cache import RecentResults
from split_cli.diagnosis.innovations.whitening import Whitener, build_whitener, cost_by_disturbance
from split_cli.diagnosis.policy import STANDARD, Believing
from split_cli.diagnosis.recording.series import REMEMBERED, Series, extended_model, predicted_by_model
from split_cli.vehicle.effects import Term
from split_cli.vehicle.parameters import Vehicle

ROW_SECONDS = 0.04
_TUNING_ROWS = 9000
_KEPT_BYTES = 2**27
"""Columns of the shared discrepancy that are kept between filters [bytes]; larger ones are made anew for each.
Judgement: 30,000 samples, well under the 1 GB of a diagnosis. It decides time and memory, and no result."""


@dataclass(frozen=True)
class Evidence:
    """One recording's rows."""

    vehicle: Vehicle
    series: Series
    jacobian: np.ndarray  # (N, 3, 3): nominal velocity Jacobian at the predicted states
    whitener: Whitener
    nominal_rows: np.ndarray  # (G, 3): whitened rows against the nominal model with the shared terms
    discrepancy: np.ndarray  # (G, 3, C): whitened columns of the shared discrepancy
    at: np.ndarray  # int64 (G,): sample in the middle of each row
    disturbance: np.ndarray  # (3,)
    # (G,): root of the robust weight of a row, 0 where it is not compared: where wheels spin or lock.
    weight: np.ndarray
    rolls: np.ndarray  # bool (N,): where the wheels roll, see `rolling`
    # What the simulation has, too, beyond the vehicle file: a part of the model, see `shared_terms_of`.
    shared_terms: tuple[Term, ...] = ()
    # Made anew for a copy with other arrays.
    _moved_cache: RecentResults[tuple[np.ndarray, ...]] = field(
        default_factory=lambda: RecentResults(REMEMBERED), init=False, repr=False, compare=False
    )

    def rows(self, terms: Sequence[Term], discrepancy_rates: np.ndarray | None = None) -> np.ndarray:
        """Return whitened rows, shape (G, 3), of what `defects` returns."""
        return self.whitener(self.defects(terms, discrepancy_rates))

    def rows_of_each(
        self, several: Sequence[Sequence[Term]], discrepancy_rates: Sequence[np.ndarray | None]
    ) -> np.ndarray:
        """Return `rows` of lists of terms with rates, filtered together, shape (G, 3, number of lists)."""
        defects = np.empty((len(self.series) - 1, 3, len(several)))
        for k, (terms, rates) in enumerate(zip(several, discrepancy_rates, strict=True)):
            defects[:, :, k] = self.defects(terms, rates)
        return self.whitener(defects)

    def defects(self, terms: Sequence[Term], discrepancy_rates: np.ndarray | None = None) -> np.ndarray:
        """Return the defects that a model of `terms` and the shared terms leaves, shape (N - 1, 3); 0 over gaps.

        Parameters
        ----------
        discrepancy_rates : ndarray, shape (N, 3), optional
            What the shared discrepancy adds beside the shared terms to the model's rates [m/s^2], [m/s^2], [rad/s^2].
        """
        measured, predicted = self.series.evaluated(terms)
        rates = self.series.rates(extended_model(self.vehicle, (*terms, *self.shared_terms)), predicted)
        if discrepancy_rates is not None:
            rates = rates + discrepancy_rates
        return self._moved(measured, predicted) - integrated(self.series, rates)

    def _moved(self, measured: np.ndarray, predicted: np.ndarray) -> np.ndarray:
        # Velocities are kept with their motion, so that no others can come to have their ids.
        made = self._moved_cache(
            (id(measured), id(predicted)),
            lambda: (motion(self.series, self.jacobian, measured, predicted), measured, predicted),
        )
        return made[0]


def motion(series: Series, jacobian: np.ndarray, measured: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Return what rates of a model at the predicted states have to explain, shape (N - 1, 3); 0 over gaps.

    Notes
    -----
    The model is evaluated at predicted states and carried to the measured ones by its Jacobian, so that sensor
    noise enters to first order only, where the whitener knows of it.
    """
    carried = np.einsum("nij,nj->ni", jacobian, measured - predicted)
    out = np.diff(measured, axis=0) - 0.5 * series.period * (carried[1:] + carried[:-1])
    out[~series.inside()] = 0.0
    return out


def integrated(series: Series, columns: np.ndarray) -> np.ndarray:
    """Return what rates (N, ...) in the middle of samples add over each, shape (N - 1, ...); 0 over gaps."""
    out = series.period * columns[:-1]
    out[~series.inside()] = 0.0
    return out


def _integrated_blocks(series: Series, discrepancy: SharedDiscrepancy) -> Iterator[np.ndarray]:
    """Yield what the discrepancy's columns come to over every sample, a few at a time, (N - 1, 3, c)."""
    return (integrated(series, block) for block in discrepancy.blocks(series))


def _whitened_blocks(whitener: Whitener, blocks: Iterable[np.ndarray]) -> np.ndarray:
    """Return whitened rows of columns that come a few at a time, (N - 1, 3, c) each, shape (G, 3, C)."""
    return np.concatenate([whitener(block) for block in blocks], axis=2)


def gather_evidence(
    vehicle: Vehicle,
    series: Series,
    discrepancy: SharedDiscrepancy,
    least_disturbance: np.ndarray | None = None,
    rules: Believing = STANDARD.believing,
) -> Evidence:
    """Whiten a recording, with the strength of unnamed disturbances found by maximum likelihood.

    Parameters
    ----------
    least_disturbance : ndarray, shape (3,), optional
        Found on another recording of the same kind; never less is assumed.
    """
    series = predicted_by_model(series, vehicle)
    rows = series.predicted.T
    jacobian = extended_model(vehicle).velocity_jacobian(
        *rows, series.torque, series.steer_angle, yaw=series.yaw, t=series.t, s=series.s
    )
    rates = series.rates(extended_model(vehicle, discrepancy.shared_terms))
    plain = motion(series, jacobian, series.measured, series.predicted) - integrated(series, rates)
    group, at = _row_groups(series)
    rolls = rolling(series, vehicle, rules)
    begins = _begins_anew(series, rolls)
    kept = np.ones(len(at), dtype=bool)
    kept[group[(group >= 0) & ~rolls[:-1]]] = False
    disturbance = np.full(3, 1e-2) * np.array([1.0, 1.0, vehicle.mass / vehicle.yaw_inertia])
    held = discrepancy.size(series) <= _KEPT_BYTES
    held_blocks = list(_integrated_blocks(series, discrepancy)) if held else []
    for _ in range(2):
        whitener = build_whitener(jacobian, series.period, series.stated_noise, disturbance, begins, group)
        columns = _whitened_blocks(whitener, held_blocks or _integrated_blocks(series, discrepancy))
        w = _discrepancy_weights(whitener(plain), columns, kept)
        left = plain - integrated(series, discrepancy.rates(series, w))
        disturbance = _likely_disturbance(series, jacobian, left, begins, rolls, disturbance)
        if least_disturbance is not None:
            disturbance = np.maximum(disturbance, least_disturbance)
    whitener = build_whitener(jacobian, series.period, series.stated_noise, disturbance, begins, group)
    u, phi = whitener(plain), _whitened_blocks(whitener, held_blocks or _integrated_blocks(series, discrepancy))
    left = u - phi @ _discrepancy_weights(u, phi, kept)
    weight = _robust_weight(left, rules.huber) * kept
    return Evidence(
        vehicle, series, jacobian, whitener, u, phi, at, disturbance, weight, rolls, discrepancy.shared_terms
    )


def rewhitened_with_noise(
    one: Evidence, noise: np.ndarray, disturbance: np.ndarray, discrepancy: SharedDiscrepancy
) -> Evidence:
    """Whiten a recording as if it had at least this noise and disturbance, shape (3,) each.

    A simulation without noise would otherwise be believed to the last digit, and weighed by other frequencies than
    the reality it is compared with.
    """
    series = one.series
    whitener = build_whitener(
        one.jacobian,
        series.period,
        np.maximum(series.stated_noise, noise),
        np.maximum(one.disturbance, disturbance),
        one.whitener.begins,
        one.whitener.group,
    )
    columns = _whitened_blocks(whitener, _integrated_blocks(series, discrepancy))
    return replace(one, whitener=whitener, nominal_rows=whitener(one.defects(())), discrepancy=columns)


def rolling(series: Series, vehicle: Vehicle, rules: Believing = STANDARD.believing) -> np.ndarray:
    """Return where the wheels roll, shape (N,): a single track knows neither spinning nor locked ones.

    They do not where an axle is asked for most of its peak force, at the load it stands with, and for a while the
    car gets less than it was asked for: load that moves to an axle, and downforce, give it more. Nor where what is
    asked for goes up to there and back within moments, as a slip control makes it: wheels answer by spinning.
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
    # A car that asks for more most of the time has other tyres than its file says.
    return rolls if rolls.mean() > rules.least_rolling else np.ones_like(rolls)


def _cycling(asked: Sequence[np.ndarray], used: np.ndarray, period: float, rules: Believing) -> np.ndarray:
    """Return where an axle's force along the car [of its peak] swings as far up as down around the limit, (N,)."""
    window = max(3, int(round(rules.cycling_seconds / period)))

    def travel(steps: np.ndarray) -> np.ndarray:
        return window * uniform_filter1d(np.maximum(steps, 0.0), window)

    steps = [np.diff(one, prepend=one[0]) for one in asked]
    swing = np.maximum(*(np.minimum(travel(one), travel(-one)) for one in steps))
    return (swing > rules.cycling_share) & (maximum_filter1d(used, window) > rules.rolling_share)


def _begins_anew(series: Series, rolls: np.ndarray) -> np.ndarray:
    """Return where the filter starts anew, shape (N - 1,): after gaps, and once wheels roll again."""
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
    """Return weights of standard normal priors from whitened rows (R, C) and (R,)."""
    precision = columns.T @ columns + np.eye(columns.shape[1])
    return np.linalg.solve(precision, columns.T @ target)


def _row_groups(series: Series) -> tuple[np.ndarray, np.ndarray]:
    """Number the rows transitions are summed into; a remainder at a segment's end is left out."""
    size = max(1, int(round(ROW_SECONDS / series.period)))
    group = np.full(len(series) - 1, -1, dtype=np.int64)
    at, number = [], 0
    for begin, end in series.recording.segments:
        rows = (end - 1 - begin) // size
        group[begin : begin + rows * size] = number + np.repeat(np.arange(rows), size)
        at.append(begin + size // 2 + size * np.arange(rows))
        number += rows
    return group, np.concatenate(at).astype(np.int64)


def _robust_weight(rows: np.ndarray, most: float) -> np.ndarray:
    """Return roots of Huber weights of rows (G, 3), of `most` spreads, each channel scaled by its own."""
    spread = 1.4826 * np.median(np.abs(rows), axis=0) + 1e-12
    worst = np.max(np.abs(rows) / spread, axis=1)
    return np.sqrt(np.minimum(1.0, most / np.maximum(worst, 1e-12)))


def _likely_disturbance(series, jacobian, defect, begins, rolls, start) -> np.ndarray:
    """Maximise the likelihood over the disturbance's variance, channel by channel, on part of a long recording."""
    used = np.flatnonzero(rolls[1:])[:_TUNING_ROWS]
    begins = begins[used] | (np.diff(used, prepend=used[0]) > 1)
    jacobian = jacobian[np.append(used, used[-1] + 1)]
    clipped = defect[used]
    spread = 6.0 * 1.4826 * np.median(np.abs(clipped), axis=0) + 1e-12
    clipped = np.clip(clipped, -spread, spread)
    found = np.log10(np.asarray(start, dtype=float))
    cost = cost_by_disturbance(clipped, jacobian, series.period, series.stated_noise, begins)
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
