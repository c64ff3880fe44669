"""`Series`: a drive prepared for the diagnosis, with states at which models are evaluated and their rates there.

A series holds the velocities three times: as measured, smoothed, and predicted from earlier samples
(`predicted_states`). Models are evaluated at the predicted states and judged by the measured ones. All three are
corrected for the sensor faults among the terms of an explanation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from split_cli.diagnosis.cache import RecentResults
from split_cli.diagnosis.recording.predicted_states import predicted_channels, smoothed_by_cubics
from split_cli.logs.assembling.dead_reckoning import TOGETHER, TOLERANCE
from split_cli.logs.assembling.noise import difference_noise
from split_cli.logs.drive import INPUT_CHANNELS, Drive
from split_cli.vehicle.compiled_operations import COMPILED
from split_cli.vehicle.effects import Recording, Term, build_terms
from split_cli.vehicle.effects.recording import over_samples
from split_cli.vehicle.flow import Flow
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack, complete

#: Number of cached results of each kind [1]: corrected velocities, and flows at them. A search changes parameters of
#: sensors less often than others. Results beyond those of four threads and their steps are not needed again.
REMEMBERED = 8
#: Least noise of a channel over its standard deviation [1]; smaller noise cannot be distinguished from rounding.
#: Judgement: the rounding of a channel of four digits.
VISIBLE = 1e-4
#: Parts of a sample in which a late steer angle is followed [1]: they leave a sixteenth of the moment of a step. It
#: affects accuracy and time alone.
_PARTS = 4
#: Factor on the noise of a channel that carries no information [1].
_WORTHLESS = 1e3


@dataclass(frozen=True)
class Series:
    """One drive with its measured, smoothed and predicted velocities, and cached evaluations of models on it."""

    # name, role: role is ``real``, ``sim`` or ``holdout``.
    name: str
    role: str
    drive: Drive
    recording: Recording  # its clock
    # measured, smooth, predicted: (N, 3): v_x, v_y, r as recorded, smoothed, and predicted from earlier samples.
    measured: np.ndarray
    smooth: np.ndarray
    predicted: np.ndarray
    # torque, steer_angle: (N,): means over the interval that begins at each sample [N m], [rad]. For a held input that
    # is the sample itself, for an interpolated one the value halfway to the next sample.
    torque: np.ndarray
    steer_angle: np.ndarray
    # t, s, yaw: (N,): [s] from the drive's first sample, [m], [rad].
    t: np.ndarray
    s: np.ndarray
    yaw: np.ndarray
    noise: np.ndarray  # (3,): standard deviation of a sample of v_x, v_y, r
    lap_length: float | None = None
    place_reference: str = "dead_reckoned"
    # Whether the correction of a late channel also shifts what smoothing removed, see `with_residue_moved`.
    residue_moves: bool = False
    # Caches; a copy with other arrays begins with empty ones.
    _nominal_flows: dict[int, Flow] = field(default_factory=dict, init=False, repr=False, compare=False)
    _changed_by: dict[tuple[str, str], frozenset[str]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _corrected_cache: RecentResults[tuple[np.ndarray, np.ndarray, np.ndarray]] = field(
        default_factory=lambda: RecentResults(REMEMBERED), init=False, repr=False, compare=False
    )
    _read_cache: RecentResults[dict[str, np.ndarray]] = field(
        default_factory=lambda: RecentResults(REMEMBERED), init=False, repr=False, compare=False
    )
    _accelerations_cache: RecentResults[dict[str, np.ndarray]] = field(
        default_factory=lambda: RecentResults(REMEMBERED), init=False, repr=False, compare=False
    )
    _moments_cache: RecentResults[np.ndarray] = field(
        default_factory=lambda: RecentResults(REMEMBERED), init=False, repr=False, compare=False
    )
    _flows_cache: RecentResults[tuple[np.ndarray, Flow]] = field(
        default_factory=lambda: RecentResults(REMEMBERED), init=False, repr=False, compare=False
    )
    _arrived_cache: RecentResults[tuple[Flow, Flow]] = field(
        default_factory=lambda: RecentResults(REMEMBERED), init=False, repr=False, compare=False
    )

    def __getstate__(self) -> dict:
        # Flows are cached by the id of a vehicle, which is not unique across processes.
        return {**self.__dict__, "_nominal_flows": {}}

    def __len__(self) -> int:
        return len(self.t)

    @property
    def period(self) -> float:
        """Sample period [s]."""
        return self.recording.period

    @property
    def stated_noise(self) -> np.ndarray:
        """Standard deviation of a sample of v_x, v_y [m/s] and r [rad/s] that the whitening filter assumes, shape (3,).

        Notes
        -----
        v_x carries no information if the torque was derived from it. A v_y that was integrated from a_y has a slow
        error with the correlation time tau. It is replaced by white noise, sqrt(2 tau/period) times as large, which
        has the same variance of means over tau. The filter then takes v_y from the model and the yaw rate.
        """
        stated = self.noise * np.array([_WORTHLESS if self.drive.metadata.torque_follows_motion else 1.0, 1.0, 1.0])
        if self.drive.metadata.lateral_velocity_is_integrated:
            std = self.drive["vy_std"] if "vy_std" in self.drive else TOLERANCE * self.drive["vx"]
            stated[1] = max(stated[1], np.sqrt(2.0 * TOGETHER / self.period * np.mean(std**2)))
        return stated

    def corrected(self, terms: Sequence[Term]) -> tuple[np.ndarray, np.ndarray]:
        """Return measured and smoothed velocities, (N, 3) each, corrected for the sensor faults among `terms`."""
        return self._all_corrected(terms)[:2]

    def evaluated(self, terms: Sequence[Term]) -> tuple[np.ndarray, np.ndarray]:
        """Return measured and predicted velocities, (N, 3) each, corrected for the sensor faults among `terms`."""
        measured, _, predicted = self._all_corrected(terms)
        return measured, predicted

    def _all_corrected(self, terms: Sequence[Term]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        # A delay common to all sensors shifts the commands instead, see `SensorDelay`.
        correcting = [term for term in terms if term.corrects and self.is_moved_by(term)]
        if not correcting:
            return self.measured, self.smooth, self.predicted
        # The model and each witness need the same corrected velocities, also while other parameters are fitted.
        return self._corrected_cache(key_of_terms(correcting), lambda: self._corrected(correcting))

    def with_residue_moved(self, terms: Sequence[Term]) -> Series:
        """Return the series with the residue of smoothing shifted in time by the late channels among `terms`.

        The residue is measured minus smooth. It contains fast signal, which is as late as the rest. While a delay is
        fitted only the smooth part is shifted: noise that shifted along would differ at each trial value. Where
        nothing is fitted any more, a correction shifts both (`residue_moves`).
        """
        measured, smooth, _ = self._channels
        left = {name: measured[name] - smooth[name] for name in smooth}
        for term in terms:
            left = term.correct_noise(left, self.recording)
        moved = np.stack([smooth[name] + left[name] for name in smooth], axis=1)
        return replace(self, measured=moved, residue_moves=False)

    def is_moved_by(self, term: Term) -> bool:
        """Return whether a term changes the model or the velocities; an accelerometer's bias changes neither."""
        return not term.corrects or self._changes(term, ("vx", "vy", "r"))

    def _changes(self, term: Term, channels: Sequence[str]) -> bool:
        """Return whether a sensor fault changes one of these channels, by its term and variant."""
        kind = (term.id, term.variant)
        if kind not in self._changed_by:
            before = self._readings
            after = term.correct(before, self.recording)
            self._changed_by[kind] = frozenset(name for name, one in before.items() if after[name] is not one)
        return term.moves_samples or not self._changed_by[kind].isdisjoint(channels)

    def _corrected(self, terms: Sequence[Term]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        measured, smooth, predicted = self._channels
        for term in terms:
            good = self._without_fault(term, smooth)
            if term.moves_samples:
                left = {name: measured[name] - smooth[name] for name in good}
                left = term.correct_noise(left, self.recording) if self.residue_moves else left
                measured = {name: good[name] + left[name] for name in good}
            else:
                measured = self._without_fault(term, measured)
            smooth, predicted = good, self._without_fault(term, predicted)
        stays = all(smooth[name] is column for name, column in self._channels[1].items())
        columns = [np.stack(list(one.values()), axis=1) for one in (measured, smooth, predicted)]
        return columns[0], self.smooth if stays else columns[1], self.predicted if stays else columns[2]

    @cached_property
    def _channels(self) -> tuple[dict[str, np.ndarray], ...]:
        """Return measured, smooth and predicted velocities channel by channel, shape (N,) each."""
        return tuple(
            dict(zip(("vx", "vy", "r"), map(np.ascontiguousarray, velocity.T), strict=True))
            for velocity in (self.measured, self.smooth, self.predicted)
        )

    def _without_fault(self, term: Term, velocity: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return velocities corrected for one sensor fault, by channel, shape (N,) each."""
        good = term.correct({**velocity, "t": self.t}, self.recording)
        return {name: good[name] for name in velocity}

    def accelerations(self, terms: Sequence[Term]) -> dict[str, np.ndarray]:
        """Return ``ax`` and ``ay`` [m/s^2], shape (N,) each, without the sensor faults and road angles among `terms`.

        If the terms are right, v_x' - v_y r and v_y' + v_x r remain. Samples that are not finite are interpolated
        linearly; a channel that was not recorded is left out.
        """
        telling = [term for term in terms if term.corrects or term.inclines_car]
        # Both accelerometers need the same result.
        return self._accelerations_cache(key_of_terms(telling), lambda: self._accelerations(telling))

    def _accelerations(self, terms: Sequence[Term]) -> dict[str, np.ndarray]:
        correcting = [term for term in terms if term.corrects]
        # Faults after the last one that concerns an accelerometer change no acceleration.
        own = [k for k, term in enumerate(correcting) if self._changes(term, ("ax", "ay"))]
        correcting = correcting[: max(own, default=-1) + 1]
        out = self._read_cache(key_of_terms(correcting), lambda: self._corrected_accelerations(correcting))
        for term in terms:
            if term.inclines_car:
                weight = dict(zip(("ax", "ay"), term.gravity_component(self.s), strict=True))
                out = {name: column - weight[name] for name, column in out.items()}
        return out

    def _corrected_accelerations(self, terms: Sequence[Term]) -> dict[str, np.ndarray]:
        """Return ``ax`` and ``ay`` [m/s^2] corrected for sensor faults, shape (N,) each."""
        columns = self._readings
        for term in terms:
            columns = term.correct(columns, self.recording)
        return {name: columns[name] for name in ("ax", "ay") if name in columns}

    @cached_property
    def _readings(self) -> dict[str, np.ndarray]:
        """Return smoothed velocities, accelerations without non-finite samples, and time, by channel, (N,) each."""
        accelerations = {name: _filled(self.drive[name]) for name in ("ax", "ay") if name in self.drive}
        return {**self._channels[1], **accelerations, "t": self.t}

    def flow(self, model: SingleTrack, velocity: np.ndarray | None = None) -> Flow:
        """Evaluate a model in the middle of each sampling interval.

        Parameters
        ----------
        velocity : ndarray, shape (N, 3), optional
            v_x, v_y [m/s] and r [rad/s] at the samples; by default the predicted states.

        Notes
        -----
        Inputs are means over the interval and states those of its middle, so that one evaluation an interval
        integrates to second order, whatever an input does between samples. Delays and linear lags commute with the
        mean, so that they are exact for held inputs. Place, time and yaw are those at the begin of the interval.
        """
        if velocity is not None and velocity is not self.predicted:
            bare = self._without_terms_at(velocity, model.vehicle)
        else:
            bare = self._without_terms(model.vehicle)
        if not model.terms:
            complete(bare.front, bare.ops)
            complete(bare.rear, bare.ops)
            return bare
        acting = tuple(term for term in model.terms if term.acts_on_commands())
        arrived = self._arrived(bare, model.vehicle, acting) if acting else None
        return self._flow(model, bare.vx, bare.vy, bare.r, bare=bare, arrived=arrived)

    def _arrived(self, bare: Flow, vehicle: Vehicle, acting: tuple[Term, ...]) -> Flow:
        """Return the flow with only those terms that act on commands, from the cache if their values are known."""

        def made() -> tuple[Flow, Flow]:
            # The flow without terms is kept in the cache, so that its id stays unique.
            return bare, self._flow(SingleTrack(vehicle, acting), bare.vx, bare.vy, bare.r, bare=bare)

        return self._arrived_cache((id(bare), key_of_terms(acting)), made)[1]

    def inputs(self, model: SingleTrack, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return torque [N m] and steer angle [rad] after the actuators of a model, means over intervals, (N,) each."""
        velocity = over_samples(velocity, self.recording)
        flow = model.actuated(*velocity.T, self.torque, self.steer_angle, **self._situation)
        return flow.T + 0.0 * self.t, flow.delta + 0.0 * self.t

    def steer_first_moment(self, vehicle: Vehicle, terms: Sequence[Term]) -> np.ndarray | None:
        """Return by how much a held steer angle arrives early within each sample, shape (N,) [rad]; None if evenly.

        Parameters
        ----------
        vehicle, terms
            The steer angle passes their actuators. One that comes late by a part of a sample, or lags, changes within
            it.

        Notes
        -----
        The first moment q = -(1/h^2) times the integral of (s - h/2) (delta(s) - mean delta) over a sample of period
        h: -1/8 of a step in its middle. It is taken of the means over `_PARTS` parts of the sample, and is 0 where a
        segment ends.
        """
        acting = (term for term in (*build_terms(vehicle), *terms) if term.acts_on_commands())
        acting = tuple(term for term in acting if term.family != "along")
        if "delta" not in self.drive.held or not any(one.acts_late() for one in acting):
            return None
        return self._moments_cache(key_of_terms(acting), lambda: self._steer_first_moment(vehicle, acting))

    def _steer_first_moment(self, vehicle: Vehicle, acting: Sequence[Term]) -> np.ndarray:
        segments = tuple((_PARTS * begin, _PARTS * end) for begin, end in self.recording.segments)
        finer = Recording(self.period / _PARTS, segments)
        columns = (*self.predicted.T, self.torque, self.steer_angle, self.t)
        *state, torque, steer, t = (np.repeat(one, _PARTS) for one in columns)
        model = SingleTrack(vehicle, acting)
        arrived = model.actuated(*state, torque, steer, t=t, ops=COMPILED, recording=finer).delta + 0.0 * t
        ahead = (np.arange(_PARTS) + 0.5) / _PARTS - 0.5
        out = -(arrived.reshape(-1, _PARTS) @ ahead) / _PARTS
        out[[end - 1 for _, end in self.recording.segments]] = 0.0
        return out

    def _flow(self, model: SingleTrack, vx, vy, r, bare: Flow | None = None, arrived: Flow | None = None) -> Flow:
        inputs = self.torque, self.steer_angle
        return model.flow(vx, vy, r, *inputs, **self._situation, bare=bare, arrived=arrived)

    @property
    def _situation(self) -> dict:
        return {"yaw": self.yaw, "t": self.t, "s": self.s, "ops": COMPILED, "recording": self.recording}

    @cached_property
    def _columns(self) -> tuple[np.ndarray, ...]:
        return tuple(np.ascontiguousarray(over_samples(self.predicted, self.recording).T))

    def _without_terms(self, vehicle: Vehicle) -> Flow:
        """Return the flow without any term. Other flows take from it what their terms do not change."""
        # A flow refers to its vehicle, so that the vehicle's id stays unique.
        if id(vehicle) not in self._nominal_flows:
            self._nominal_flows[id(vehicle)] = self._flow(SingleTrack(vehicle, ()), *self._columns)
        return self._nominal_flows[id(vehicle)]

    def rates(self, model: SingleTrack, velocity: np.ndarray | None = None) -> np.ndarray:
        """Return (v_x', v_y', r') of a model in the middle of samples, shape (N, 3); see `flow`."""
        out = np.empty((len(self), 3))
        for channel, row in enumerate(self.rate_rows(model, velocity)):
            out[:, channel] = row
        return out

    def rate_rows(self, model: SingleTrack, velocity: np.ndarray | None = None) -> tuple[np.ndarray, ...]:
        """Return v_x', v_y' and r' of a model in the middle of samples, shape (N,) each."""
        return model.balance(self.flow(model, velocity))

    def _without_terms_at(self, velocity: np.ndarray, vehicle: Vehicle) -> Flow:
        """Return the flow without any term at corrected velocities, shape (N, 3)."""

        def made() -> tuple[np.ndarray, Flow]:
            columns = map(np.ascontiguousarray, over_samples(velocity, self.recording).T)
            # The velocities are kept in the cache, so that their id stays unique. Steer angles do not depend on them.
            return velocity, SingleTrack(vehicle, ()).turned(self._without_terms(vehicle), *columns)

        return self._flows_cache((id(velocity), id(vehicle)), made)[1]

    def transitions_begin(self) -> np.ndarray:
        """Return transitions at which the whitening filter restarts, bool (N - 1,): also those across a gap."""
        begins = np.zeros(len(self) - 1, dtype=bool)
        for first, end in self.recording.segments:
            if first < len(begins):
                begins[first] = True
            if end - 1 < len(begins):
                begins[end - 1] = True
        return begins

    def inside(self) -> np.ndarray:
        """Return which transitions lie inside a segment, shape (N - 1,)."""
        inside = np.ones(len(self) - 1, dtype=bool)
        for _, end in self.recording.segments:
            if end - 1 < len(inside):
                inside[end - 1] = False
        return inside


def key_of_terms(terms: Sequence[Term]) -> tuple:
    """Return a key for caches that is the same for terms of the same ids, variants and parameter values."""
    return tuple((term.id, term.variant, *sorted(term.parameters.items())) for term in terms)


def extended_model(vehicle: Vehicle, terms: Sequence[Term] = ()) -> SingleTrack:
    """Return the nominal model with the effects of its vehicle file and with more terms."""
    return SingleTrack(vehicle, (*build_terms(vehicle), *terms))


def build_series(
    drive: Drive, role: str, s: np.ndarray, *, lap_length: float | None = None, place_reference: str = "dead_reckoned"
) -> Series:
    """Prepare a drive for the diagnosis.

    Parameters
    ----------
    role : {"real", "sim", "holdout"}
    s : ndarray, shape (N,)
        Track position [m].
    lap_length : float, optional
        Length of a closed track [m].
    place_reference : {"position", "dead_reckoned"}
        What the track position was computed from.
    """
    segments = tuple((run.start, run.stop) for run in drive.segments())
    recording = Recording(drive.period, segments)
    measured = np.stack([drive["vx"], drive["vy"], drive["r"]], axis=1)
    noise = np.array([difference_noise(column, list(segments)) for column in measured.T])
    # A channel without visible noise would otherwise be taken as exact.
    floor = VISIBLE * np.maximum(measured.std(axis=0), 1e-6)
    noise = np.where(np.isfinite(noise), np.maximum(noise, floor), floor)
    smooth = np.stack(
        [smoothed_by_cubics(column, sigma, recording) for column, sigma in zip(measured.T, noise, strict=True)], axis=1
    )
    t = drive["t"] - drive["t"][0]
    if "yaw" in drive:
        yaw = np.unwrap(drive["yaw"])
    else:
        yaw = np.concatenate([[0.0], np.cumsum(0.5 * (smooth[1:, 2] + smooth[:-1, 2]))]) * drive.period
    T, delta = (drive[name] if name in drive.held else over_samples(drive[name], recording) for name in INPUT_CHANNELS)
    return Series(
        name=drive.name,
        role=role,
        drive=drive,
        recording=recording,
        measured=measured,
        smooth=smooth,
        predicted=predicted_channels(measured, smooth, noise, recording)[0],
        torque=T,
        steer_angle=delta,
        t=t,
        s=s,
        yaw=yaw,
        noise=noise,
        lap_length=lap_length,
        place_reference=place_reference,
    )


def _filled(values: np.ndarray) -> np.ndarray:
    known = np.isfinite(values)
    if known.all() or not known.any():
        return values
    rows = np.arange(len(values))
    return np.interp(rows, rows[known], values[known])


def predicted_by_model(
    series: Series,
    vehicle: Vehicle,
    row: int = 1,
    terms: Sequence[Term] = (),
    added: Callable[[Series], np.ndarray] | None = None,
) -> Series:
    """Return the series with states predicted with the help of a model, channel by channel if that is better.

    Parameters
    ----------
    row : int
        Samples of a row; a sample is predicted from those before its row.
    terms : sequence of Term
        What the model has beyond the nominal one, such as the lags of the simulation.
    added : callable, optional
        Returns further rates of the model (N, 3) along a recording.

    Notes
    -----
    The model's rates at the predicted states are summed up over time. The difference between measured velocities and
    that sum varies slowly, and polynomials through earlier samples predict it. No later sample is used.
    """
    moved, recording = np.zeros_like(series.measured), series.recording
    plain = predicted_channels(series.measured, series.smooth, series.noise, recording, row)
    there = replace(series, predicted=plain[0])
    rates = there.rates(extended_model(vehicle, terms))
    rates = rates if added is None else rates + added(there)
    for begin, end in recording.segments:
        moved[begin + 1 : end] = np.cumsum(series.period * rates[begin : end - 1], axis=0)
    by_model = predicted_channels(series.measured - moved, series.smooth - moved, series.noise, recording, row)
    predicted = np.where(by_model[1] < plain[1], moved + by_model[0], plain[0])
    return replace(series, predicted=predicted)
