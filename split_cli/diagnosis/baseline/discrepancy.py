"""The shared model discrepancy (Kennedy and O'Hagan, 2001): what simulation and reality share beyond the nominal model.

It is a linear combination of basis functions: derivatives of the model with respect to parameters of catalogue terms
(tangents), and smooth, mirror-symmetric functions of slip angles, torque and speed. The weights are learned on the
simulation. Reality is compared with the sum, and the weights keep their posterior uncertainty.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from types import MappingProxyType
from typing import Any

import numpy as np

from split_cli.diagnosis.baseline._functions_numba import weighted_functions
from split_cli.diagnosis.baseline.body import at_another_body, moved_axles, moves_axles
from split_cli.diagnosis.baseline.tires import (
    AxleBalance,
    Ratio,
    Ratios,
    Similarity,
    acts_on_force,
    alters_tires,
    at_other_tires,
    similarity,
    tire_ratios,
    with_terms_on_forces,
)
from split_cli.diagnosis.cache import RecentResults
from split_cli.diagnosis.recording.series import REMEMBERED, Series, extended_model, key_of_terms
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.effects.recording import ResultCache, first_order_response
from split_cli.vehicle.effects.tires_slope import TireStiffness
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack

# Powers of alpha_f, alpha_r, T and v_x in the smooth functions, even and odd in the slip angles.
_POWERS = [
    (i, j, k, m)
    for i, j in product(range(5), range(5))
    for k, m in product(range(5 - min(i + j, 4)), range(5))
    if i + j + k + m <= 4
]
_EVEN, _ODD = ([powers for powers in _POWERS if (powers[0] + powers[1]) % 2 == odd] for odd in (0, 1))
_SMOOTH_DEVIATION = 0.03  # prior deviation of a smooth function's weight, as a share of an axle's peak

#: Effects of the simulation beyond its vehicle file that are fitted as terms of one parameter, see `shared_terms_of`.
SHARED_TERMS = ("drive_lag", "steer_lag", "tire_relaxation", "combined_slip")

_COLUMNS_AT_A_TIME = 16  # columns whose rates at all samples are in memory at a time
_MEMORY_SECONDS = (0.03, 0.1, 0.35)  # time constants for a full-size car; they scale with the root of length


@dataclass(frozen=True)
class SharedDiscrepancy:
    """The basis functions, scaled so that every weight has a standard normal prior."""

    vehicle: Vehicle
    # center, width: (4,): of alpha_f, alpha_r [rad], T/T_max [1] and v_x [m/s], for the smooth functions.
    center: np.ndarray
    width: np.ndarray
    # `SHARED_TERMS` with the simulation's values, part of the model that the basis functions are added to. Tangents are
    # taken about that model, and smooth functions are evaluated at slip angles and torque after the actuators.
    shared_terms: tuple[Term, ...] = ()
    # A cache; a copy with another vehicle begins with an empty one.
    _ratios_cache: RecentResults[tuple[Ratios, Series]] = field(
        default_factory=lambda: RecentResults(REMEMBERED), init=False, repr=False, compare=False
    )

    @property
    def _peak(self) -> float:
        return 0.5 * (self.vehicle.front_tire.D + self.vehicle.rear_tire.D)

    def columns(self, series: Series) -> np.ndarray:
        """Return the rates of all basis functions in the middle of samples, (N, 3, C) [m/s^2], [m/s^2], [rad/s^2]."""
        return np.concatenate(list(self.blocks(series)), axis=2)

    def blocks(self, series: Series) -> Iterator[np.ndarray]:
        """Yield the columns a few at a time, shape (N, 3, c), since all of them may exceed the memory."""
        beside = series.rates(self._beside)
        for some in _few_of(self._altered):
            yield np.stack([series.rates(model) - beside for model in some], axis=2)
        yield from spread(self._functions(series), self._directions())

    def size(self, series: Series) -> int:
        """Return the memory that all columns of a recording take [bytes]."""
        return 24 * len(series) * len(self.unlike_shared_terms())

    def unlike_shared_terms(self) -> np.ndarray:
        """Return which columns cannot represent `SHARED_TERMS`, bool (C,): no tangents of them, no lags."""
        others = [kind.id not in SHARED_TERMS for kind, *_ in tangents()]
        smooth, slow = len(_EVEN) + 1 + 2 * (len(_ODD) + 4), 5 * len(_MEMORY_SECONDS)
        return np.array([*others, *[True] * smooth, *[False] * slow])

    def rates(self, series: Series, weights: np.ndarray, terms: Sequence[Term] = ()) -> np.ndarray:
        """Return the rates of the weighted sum in the middle of samples, (N, 3) [m/s^2], [m/s^2], [rad/s^2].

        Parameters
        ----------
        weights : ndarray, shape (C,)
        terms : sequence of Term
            Terms that change inputs, sensors, tyres or body. The sum is evaluated at the torque and steer angle behind
            the actuators and at corrected velocities. Its forces change as those of the tyres do (`Similarity`,
            `with_terms_on_forces`), at the slip angles of the changed axle positions, and accelerate the changed body.
        """
        similar = self.similarity(series, terms)
        own, actual = self.rates_of_own_car(series, weights, terms, similar.slip)
        return self.at_another_car(own, actual, terms, similar.peak)

    def rates_of_own_car(
        self, series: Series, weights: np.ndarray, terms: Sequence[Term] = (), slips: Ratios = MappingProxyType({})
    ) -> tuple[np.ndarray, Series]:
        """Return the rates (N, 3) at the inputs and slip angles that terms lead to, and the series with these inputs.

        Tyres and body are those of the vehicle; see `at_another_car`.

        Parameters
        ----------
        slips : mapping of int to float or ndarray of shape (N,)
            Factors by which the slip angles of the axles 1 (front) and 2 (rear) are scaled before [1].
        """
        there = moved_axles(self.vehicle, terms)
        if there is not self.vehicle:
            rest = [term for term in terms if not moves_axles(self.vehicle, term)]
            return replace(self, vehicle=there).rates_of_own_car(series, weights, rest, slips)
        _, predicted = series.evaluated(terms)
        # The effects of the vehicle file act in the rates below, and must not act twice.
        torque, steer_angle = series.inputs(SingleTrack(self.vehicle, tuple(terms)), predicted)
        cache = ResultCache()
        recording = replace(series.recording, cache=cache)
        actual = replace(series, predicted=predicted, torque=torque, steer_angle=steer_angle, recording=recording)
        of_tangents, others = np.split(np.asarray(weights, dtype=float), [len(self._altered)])
        front, rear = (slips.get(k, 1.0) for k in (1, 2))
        scaled = (TireStiffness({"front_scale": front, "rear_scale": rear}),) if slips else ()
        altered = (SingleTrack(self.vehicle, (*one.terms, *scaled)) for one in self._altered)
        beside = SingleTrack(self.vehicle, (*self._beside.terms, *scaled))
        flows = zip(of_tangents.tolist(), map(actual.flow, altered), strict=True)
        out = SingleTrack.weighted_changes(actual.flow(beside), flows)
        rates = np.stack(out, axis=1) + (self._directions() @ self._weighted(actual, others, (front, rear))).T
        cache.clear()
        return rates, actual

    def rates_with_shared_terms(self, series: Series, weights: np.ndarray, terms: Sequence[Term] = ()) -> np.ndarray:
        """Return the rates, shape (N, 3), of the weighted sum and of the shared terms added to a model with terms."""
        added = self.rates(series, weights, terms)
        if not self.shared_terms:
            return added
        predicted = series.evaluated(terms)[1]
        both = extended_model(self.vehicle, (*terms, *self.shared_terms))
        return added + series.rates(both, predicted) - series.rates(extended_model(self.vehicle, terms), predicted)

    def at_another_car(
        self, rates: np.ndarray, series: Series, terms: Sequence[Term], ratios: Ratios | None = None
    ) -> np.ndarray:
        """Return rates (N, 3) of the discrepancy scaled to the tyres and the body that terms give the vehicle.

        If terms move axles, `rates` must have been evaluated at the slip angles of the moved axles, see `rates`.

        Parameters
        ----------
        ratios : mapping of int to float or ndarray of shape (N,), optional
            Factors of the lateral forces of the axles. By default `tire_ratios`, for small differences of rates.
        """
        there = moved_axles(self.vehicle, terms)
        axles = AxleBalance(there, series.steer_angle)
        rates = at_other_tires(rates, axles, self._tire_ratios(series, terms) if ratios is None else ratios)
        acting = [term for term in terms if acts_on_force(term)]
        if acting:
            flow = series.flow(extended_model(self.vehicle, (*terms, *self.shared_terms)))
            rates = with_terms_on_forces(rates, axles, flow, sorted(acting, key=lambda term: term.order))
        return at_another_body(rates, there, terms)

    def similarity(self, series: Series, terms: Sequence[Term]) -> Similarity:
        """Return how terms change the curves of the axles; one with an unchanged curve is left out."""
        altering = self._altering_tires(terms)
        return similarity(series, self.vehicle, altering) if altering else Similarity({}, {})

    def _tire_ratios(self, series: Series, terms: Sequence[Term]) -> Ratios:
        """Return `tire_ratios`, from the cache if the values of the terms that matter are known."""
        altering = self._altering_tires(terms)
        if not altering:
            return {}

        def made() -> tuple[Ratios, Series]:
            # The series is kept in the cache, so that its id stays unique.
            return tire_ratios(series, self.vehicle, altering), series

        return self._ratios_cache((id(series), key_of_terms(altering)), made)[0]

    def _altering_tires(self, terms: Sequence[Term]) -> list[Term]:
        """Return the terms that change tyres, and those that move axles beside them; none if no tyre changes."""
        found = [term for term in terms if alters_tires(term) or moves_axles(self.vehicle, term)]
        return found if any(map(alters_tires, found)) else []

    def _weighted(self, series: Series, weights: np.ndarray, slips: tuple[Ratio, Ratio]) -> np.ndarray:
        """Return the weighted sum of the smooth functions by force, shape (3, N), without storing each function.

        Parameters
        ----------
        slips : tuple of float or ndarray of shape (N,)
            Factors of the slip angles in front and behind [1].
        """
        times = len(_MEMORY_SECONDS)
        ends = np.cumsum([len(_EVEN), 1, *2 * (len(_ODD), 4), 2 * times, 2 * times])
        even, size, front, front_sizes, rear, rear_sizes, along, by_front, by_rear = np.split(weights, ends)
        z = self._scaled(series, slips)
        by_time = [part.reshape(times, -1) for part in (along, by_front, by_rear)]
        q = series.period / self._memory_seconds()
        return weighted_functions(
            z,
            _scaled_steer(series),
            np.array(_EVEN),
            np.array(_ODD),
            even,
            np.stack([front, rear]),
            np.concatenate([size, front_sizes, rear_sizes]),
            np.hstack(by_time),
            np.array([begin for begin, _ in series.recording.segments]),
            np.exp(-q),
            -np.expm1(-q) / q,
        )

    def _directions(self) -> np.ndarray:
        return self.vehicle.force_matrix() * self._peak * _SMOOTH_DEVIATION

    def _functions(self, series: Series) -> list[tuple[int, np.ndarray]]:
        """Return smooth functions, (F, N) each, with the number of their force: 0 longitudinal, 1 front, 2 rear."""
        z = self._scaled(series)
        return [*self._smooth(z), *self._memory(z, series)]

    def _scaled(self, series: Series, slips: tuple[Ratio, Ratio] = (1.0, 1.0)) -> np.ndarray:
        """Return the features, scaled and within bounds, shape (4, N); `slips` as in `_weighted`."""
        z = features(series, self.vehicle, self.shared_terms)
        z[:, 0] *= slips[0]
        z[:, 1] *= slips[1]
        return np.ascontiguousarray(_squash(z, self.center, self.width).T)

    def _memory_seconds(self) -> np.ndarray:
        return np.array(_MEMORY_SECONDS) * np.sqrt(self.vehicle.wheelbase / 2.7)

    @cached_property
    def _beside(self) -> SingleTrack:
        """Return the nominal model with the shared terms."""
        return extended_model(self.vehicle, self.shared_terms)

    @cached_property
    def _altered(self) -> tuple[SingleTrack, ...]:
        """Return the model that is a step away from the nominal one with the shared terms, along each tangent."""
        out, car = [], self.vehicle
        for kind, variant, parameter, step in tangents():
            scaled = step * kind.sizes(car).get(parameter, 1.0)
            neutral = {key: kind.neutral[key] for key in kind.units}
            term = kind({**neutral, parameter: kind.neutral[parameter] + scaled}, variant)
            out.append(extended_model(car, (*self.shared_terms, term)))
        return tuple(out)

    @staticmethod
    def _smooth(z: np.ndarray) -> list[tuple[int, np.ndarray]]:
        a, b, c, v = z
        size = np.abs(c)
        slips, rest = (
            {(p, q): x * y for (p, x), (q, y) in product(enumerate(_powers(one, 4)), enumerate(_powers(two, 4)))}
            for one, two in ((a, b), (c, v))
        )

        def products(powers: Sequence[tuple[int, ...]], *others: np.ndarray) -> np.ndarray:
            out = np.empty((len(powers) + len(others), len(a)))
            for row, (i, j, k, m) in zip(out, powers, strict=False):
                np.multiply(slips[i, j], rest[k, m], out=row)
            out[len(powers) :] = others
            return out

        even = products(_EVEN, size)
        odd = products(_ODD, a * size, b * size, np.abs(a) * a, np.abs(b) * b)
        return [(0, even), (1, odd), (2, odd)]

    def _memory(self, z: np.ndarray, series: Series) -> list[tuple[int, np.ndarray]]:
        """Return low-pass filtered commands less the commands: actuators and suspension of a real car respond late.

        Slip angles are not filtered here; tyre relaxation, a tangent, represents their delay. Their rates with the
        steer rate determine r' = v_x (delta' - alpha_f' + alpha_r')/L at constant speed, whatever the yaw moment is.
        A discrepancy that could represent r' by r' itself would hide a change of the yaw inertia.
        """
        a, b, c, _ = z
        delta, along, front, rear = _scaled_steer(series), [], [], []
        for tau in self._memory_seconds().tolist():
            torque, steer, slip = (first_order_response(x, 1.0 / tau, series.recording) - x for x in (c, delta, a * a))
            along += [torque, slip]
            front += [steer, torque * a]
            rear.append(torque * b)
        return [(0, np.array(along)), (1, np.array(front)), (2, np.array(rear))]


def _scaled_steer(series: Series) -> np.ndarray:
    """Return the steer angle over its 99 % quantile in size, shape (N,) [1]."""
    return series.steer_angle / max(float(np.quantile(np.abs(series.steer_angle), 0.99)), 1e-6)


def spread(functions: Iterable[tuple[int, Sequence[np.ndarray]]], directions: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the rates of functions that scale a force, a few at a time, shape (N, 3, c).

    Parameters
    ----------
    functions : iterable of (int, sequence of ndarray of shape (N,))
        The number of the force (0 longitudinal, 1 front, 2 rear) and functions that scale it.
    directions : ndarray, shape (3, 3)
        Rates caused by a unit of each force, in columns.
    """
    for axis, several in functions:
        for some in _few_of(several):
            yield np.stack(some, axis=1)[:, None, :] * directions[:, axis, None]


def _few_of(items: Sequence[Any]) -> Iterator[Sequence[Any]]:
    return (items[k : k + _COLUMNS_AT_A_TIME] for k in range(0, len(items), _COLUMNS_AT_A_TIME))


def build_shared_discrepancy(vehicle: Vehicle, series: Series) -> SharedDiscrepancy:
    """Return the basis functions of a vehicle, scaled to the range of features in `series`, a simulation."""
    z = features(series, vehicle)
    width = np.maximum(np.quantile(np.abs(z[:, :2]), 0.995, axis=0), 1e-3)
    low, high = np.quantile(z[:, 2:], [0.005, 0.995], axis=0)
    center = np.array([0.0, 0.0, *(0.5 * (low + high))])
    return SharedDiscrepancy(vehicle, center, np.array([*width, *np.maximum(0.5 * (high - low), 1e-3)]))


def features(series: Series, vehicle: Vehicle, shared_terms: Sequence[Term] = ()) -> np.ndarray:
    """Return alpha_f, alpha_r [rad], T/T_max [1] and v_x [m/s] at the predicted states, shape (N, 4).

    With `shared_terms`, steer angle and torque are those after the actuators of these terms.
    """
    flow = series.flow(extended_model(vehicle, shared_terms))
    ratio = (flow.T if shared_terms else series.torque) / vehicle.max_torque
    return np.stack([flow.front.slip_angle, flow.rear.slip_angle, ratio, series.predicted[:, 0]], axis=1)


def scaled_features(series: Series, vehicle: Vehicle) -> np.ndarray:
    """Return the features, each over its 99 % quantile in size, shape (N, 4) [1]."""
    z = features(series, vehicle)
    return z / np.maximum(np.quantile(np.abs(z), 0.99, axis=0), 1e-9)


def tangents() -> tuple[tuple[type[Term], str, str, float], ...]:
    """Return term, variant, parameter and step from neutral of every tangent, from the term classes.

    The step, in units of `Term.sizes`, is both the tangent's width and the prior deviation.
    """
    return tuple((kind, *entry) for kind in CATALOGUE.values() for entry in kind.discrepancy)


def _squash(z: np.ndarray, center: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Scale features to [-1, 1] within the known range; outside they saturate, so that nothing is extrapolated."""
    x = (z - center) / width
    outside = np.abs(x) > 1.0
    x[outside] = np.sign(x[outside]) * (1.0 + np.tanh(np.abs(x[outside]) - 1.0))
    return x


def _powers(x: np.ndarray, most: int) -> list[np.ndarray]:
    """Return x^0 to x^most."""
    out = [np.ones_like(x)]
    for _ in range(most):
        out.append(out[-1] * x)
    return out
