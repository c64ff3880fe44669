"""A drive prepared for the diagnosis: predicted states for evaluating physics, recorded ones for judging it.

A model is evaluated at states that earlier samples predict. A smoothed state knows the noise of later samples, and
what a model makes of it follows the very noise that it is judged by: any flexible correction then learns too little
damping (for a model evaluated in the middle of a sample this is the drift term of Onsager and Machlup, 1953).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from split_cli.diagnosis.cache import Recent
from split_cli.logs.assembling.dead_reckoning import TOGETHER, TOLERANCE
from split_cli.logs.assembling.noise import difference_noise
from split_cli.logs.drive import INPUT_CHANNELS, Drive
from split_cli.vehicle.compiled_operations import COMPILED
from split_cli.vehicle.effects import Recording, Term, build_terms
from split_cli.vehicle.effects.recording import over_samples
from split_cli.vehicle.flow import Flow
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack, complete

#: Corrected velocities of a recording that are kept, with the flow at them [1]. A search moves other parameters
#: far more often than those of sensors; more than those of four threads and their steps are never asked again.
REMEMBERED = 8
#: Noise of a channel over its spread below which it is no noise that can be seen [1]. Judgement: the rounding of
#: a channel of four digits.
VISIBLE = 1e-4
_WINDOWS_SECONDS = (0.05, 0.08, 0.12, 0.18, 0.26, 0.36)
#: Degrees of polynomials through earlier samples that may predict the next one [1].
_DEGREES = (1, 2, 3)
# A window counts as too long when what it takes away exceeds the noise by more than this.
_SLACK = 1.04
_WORTHLESS = 1e3


@dataclass(frozen=True)
class Series:
    """One drive, ready for evaluation."""

    # name, role: role is ``real``, ``sim`` or ``holdout``.
    name: str
    role: str
    drive: Drive
    recording: Recording  # its clock
    # measured, smooth, predicted: (N, 3): v_x, v_y, r as recorded, smoothed, and predicted from earlier samples.
    measured: np.ndarray
    smooth: np.ndarray
    predicted: np.ndarray
    # torque, steer_angle: (N,): means over the sample that begins at each row [N m], [rad]: the value itself of a
    # held input, halfway to the next sample of one that runs in straight lines.
    torque: np.ndarray
    steer_angle: np.ndarray
    # t, s, yaw: (N,): [s] from the drive's first sample, [m], [rad].
    t: np.ndarray
    s: np.ndarray
    yaw: np.ndarray
    noise: np.ndarray  # (3,): standard deviation of a sample of v_x, v_y, r
    lap_length: float | None = None
    place_reference: str = "dead_reckoned"
    # Whether what smoothing left moves with a late channel, see `with_residue_moved`.
    residue_moves: bool = False
    # Made anew for a copy with other arrays.
    _nominal_flows: dict[int, Flow] = field(default_factory=dict, init=False, repr=False, compare=False)
    _changed_by: dict[tuple[str, str], frozenset[str]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _corrected_before: Recent[tuple[np.ndarray, np.ndarray, np.ndarray]] = field(
        default_factory=lambda: Recent(REMEMBERED), init=False, repr=False, compare=False
    )
    _read_before: Recent[dict[str, np.ndarray]] = field(
        default_factory=lambda: Recent(REMEMBERED), init=False, repr=False, compare=False
    )
    _accelerations_before: Recent[dict[str, np.ndarray]] = field(
        default_factory=lambda: Recent(REMEMBERED), init=False, repr=False, compare=False
    )
    _flows_before: Recent[tuple[np.ndarray, Flow]] = field(
        default_factory=lambda: Recent(REMEMBERED), init=False, repr=False, compare=False
    )
    _arrived_before: Recent[tuple[Flow, Flow]] = field(
        default_factory=lambda: Recent(REMEMBERED), init=False, repr=False, compare=False
    )

    def __getstate__(self) -> dict:
        # Flows are found by ids of vehicles, which another process gives to others.
        return {**self.__dict__, "_nominal_flows": {}}

    def __len__(self) -> int:
        return len(self.t)

    @property
    def period(self) -> float:
        """Sample period [s]."""
        return self.recording.period

    @property
    def stated_noise(self) -> np.ndarray:
        """Noise of v_x, v_y, r, shape (3,).

        Notes
        -----
        v_x tells nothing where torque was derived from it. A v_y that was integrated from a_y errs slowly: white
        noise that leaves means over its correlation time as unsure stands for that, sqrt(2 tau/period) times as
        large. The filter then takes v_y from the model and the yaw rate.
        """
        stated = self.noise * np.array([_WORTHLESS if self.drive.metadata.torque_follows_motion else 1.0, 1.0, 1.0])
        if self.drive.metadata.lateral_velocity_is_integrated:
            std = self.drive["vy_std"] if "vy_std" in self.drive else TOLERANCE * self.drive["vx"]
            stated[1] = max(stated[1], np.sqrt(2.0 * TOGETHER / self.period * np.mean(std**2)))
        return stated

    def corrected(self, terms: Sequence[Term]) -> tuple[np.ndarray, np.ndarray]:
        """Return measured and smooth velocities with the sensors' faults among `terms` taken off."""
        return self._all_corrected(terms)[:2]

    def evaluated(self, terms: Sequence[Term]) -> tuple[np.ndarray, np.ndarray]:
        """Return measured and predicted velocities with the sensors' faults among `terms` taken off."""
        measured, _, predicted = self._all_corrected(terms)
        return measured, predicted

    def _all_corrected(self, terms: Sequence[Term]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        # A sensor's delay is taken into account by the commands' clock, see `SensorDelay`.
        correcting = [term for term in terms if term.corrects and self.is_moved_by(term)]
        if not correcting:
            return self.measured, self.smooth, self.predicted
        # One explanation is asked for by the model and by every witness in turn, and while others are fitted.
        return self._corrected_before(values_of(correcting), lambda: self._corrected(correcting))

    def with_residue_moved(self, terms: Sequence[Term]) -> Series:
        """Return the series with what smoothing left moved in time as late channels among `terms` say.

        Fast signal belongs to it, which is as late as the rest. A correction alone moves the smooth part, since noise
        that moved along would make each try of a fit another draw of it. Where nothing is fitted any more, a
        correction moves both (`residue_moves`).
        """
        measured, smooth, _ = self._channels
        left = {name: measured[name] - smooth[name] for name in smooth}
        for term in terms:
            left = term.correct_noise(left, self.recording)
        moved = np.stack([smooth[name] + left[name] for name in smooth], axis=1)
        return replace(self, measured=moved, residue_moves=False)

    def is_moved_by(self, term: Term) -> bool:
        """Return whether a term changes the model or the velocities: an accelerometer's bias leaves both alone."""
        return not term.corrects or self._changes(term, ("vx", "vy", "r"))

    def _changes(self, term: Term, channels: Sequence[str]) -> bool:
        """Return whether a sensor's fault is one of some channels, by its term and variant."""
        kind = (term.id, term.variant)
        if kind not in self._changed_by:
            before = self._readings
            after = term.correct(before, self.recording)
            self._changed_by[kind] = frozenset(name for name, one in before.items() if after[name] is not one)
        return term.moves_samples or not self._changed_by[kind].isdisjoint(channels)

    def _corrected(self, terms: Sequence[Term]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        measured, smooth, predicted = self._channels
        for term in terms:
            good = self._put_right(term, smooth)
            if term.moves_samples:
                left = {name: measured[name] - smooth[name] for name in good}
                left = term.correct_noise(left, self.recording) if self.residue_moves else left
                measured = {name: good[name] + left[name] for name in good}
            else:
                measured = self._put_right(term, measured)
            smooth, predicted = good, self._put_right(term, predicted)
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

    def _put_right(self, term: Term, velocity: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return velocities with a sensor's fault taken off, channel by channel."""
        good = term.correct({**velocity, "t": self.t}, self.recording)
        return {name: good[name] for name in velocity}

    def accelerations(self, terms: Sequence[Term]) -> dict[str, np.ndarray]:
        """Return ``ax`` and ``ay`` [m/s^2] without sensors' faults and weight on inclined roads, shape (N,) each.

        With what `terms` say of both taken off, the changes of the velocities are left, v_x' - v_y r and
        v_y' + v_x r. Samples without a number are filled by straight lines; a channel that was not recorded is
        left out.
        """
        telling = [term for term in terms if term.corrects or term.is_felt]
        # Both accelerometers are asked in turn.
        return self._accelerations_before(values_of(telling), lambda: self._accelerations(telling))

    def _accelerations(self, terms: Sequence[Term]) -> dict[str, np.ndarray]:
        correcting = [term for term in terms if term.corrects]
        # What comes after the last fault of an accelerometer changes none of them.
        own = [k for k, term in enumerate(correcting) if self._changes(term, ("ax", "ay"))]
        correcting = correcting[: max(own, default=-1) + 1]
        out = self._read_before(values_of(correcting), lambda: self._read_right(correcting))
        for term in terms:
            if term.is_felt:
                weight = dict(zip(("ax", "ay"), term.weight_felt(self.s), strict=True))
                out = {name: column - weight[name] for name, column in out.items()}
        return out

    def _read_right(self, terms: Sequence[Term]) -> dict[str, np.ndarray]:
        """Return ``ax`` and ``ay`` [m/s^2] without sensors' faults, shape (N,) each."""
        columns = self._readings
        for term in terms:
            columns = term.correct(columns, self.recording)
        return {name: columns[name] for name in ("ax", "ay") if name in columns}

    @cached_property
    def _readings(self) -> dict[str, np.ndarray]:
        """Return smoothed velocities and accelerations, samples without a number filled, and time, (N,) each."""
        accelerations = {name: _filled(self.drive[name]) for name in ("ax", "ay") if name in self.drive}
        return {**self._channels[1], **accelerations, "t": self.t}

    def flow(self, model: SingleTrack, velocity: np.ndarray | None = None) -> Flow:
        """Evaluate a model in the middle of every sample, at the predicted states unless others are given.

        Notes
        -----
        Inputs are means over samples, and states those of the middle, so that one evaluation a sample integrates
        to second order whatever an input does between samples. Delays and linear lags commute with the mean over
        a sample: of a staircase they are exact. Place, time and yaw are those of the sample's begin.
        """
        if velocity is not None and velocity is not self.predicted:
            bare = self._without_terms_at(velocity, model.vehicle)
        else:
            bare = self._without_terms(model.vehicle)
        if not model.terms:
            complete(bare.front, bare.ops)
            complete(bare.rear, bare.ops)
            return bare
        acting = tuple(term for term in model.terms if type(term).actuate is not Term.actuate)
        arrived = self._arrived(bare, model.vehicle, acting) if acting else None
        return self._flow(model, bare.vx, bare.vy, bare.r, bare=bare, arrived=arrived)

    def _arrived(self, bare: Flow, vehicle: Vehicle, acting: tuple[Term, ...]) -> Flow:
        """Return the flow with the terms that act on commands alone, as it was made before for the same values."""

        def made() -> tuple[Flow, Flow]:
            # Flows without terms are kept beside it, so that no others can come to have their id.
            return bare, self._flow(SingleTrack(vehicle, acting), bare.vx, bare.vy, bare.r, bare=bare)

        return self._arrived_before((id(bare), values_of(acting)), made)[1]

    def inputs(self, model: SingleTrack, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what actuators make of torque [N m] and steer angle [rad], means over samples, (N,) each."""
        velocity = over_samples(velocity, self.recording)
        flow = model.actuated(*velocity.T, self.torque, self.steer_angle, **self._situation)
        return flow.T + 0.0 * self.t, flow.delta + 0.0 * self.t

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
        """Return the flow without any term, from which all others take what their terms leave as it was."""
        # A flow holds its vehicle, so that no other can come to have its id.
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
            # Velocities are kept with their flow, so that no others can come to have their id. Wheels point where
            # they do at the recorded velocities.
            return velocity, SingleTrack(vehicle, ()).turned(self._without_terms(vehicle), *columns)

        return self._flows_before((id(velocity), id(vehicle)), made)[1]

    def transitions_begin(self) -> np.ndarray:
        """Return where the filter starts anew, shape (N - 1,), the transition over a gap included."""
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


def values_of(terms: Sequence[Term]) -> tuple:
    """Return what tells terms from others: ids, variants and values."""
    return tuple((term.id, term.variant, *sorted(term.parameters.items())) for term in terms)


def extended_model(vehicle: Vehicle, terms: Sequence[Term] = ()) -> SingleTrack:
    """Return the nominal model, the effects its file names included, with more terms."""
    return SingleTrack(vehicle, (*build_terms(vehicle), *terms))


def build_series(
    drive: Drive, role: str, s: np.ndarray, *, lap_length: float | None = None, place_reference: str = "dead_reckoned"
) -> Series:
    """Prepare a drive; `s` is its track position, shape (N,)."""
    segments = tuple((run.start, run.stop) for run in drive.segments())
    recording = Recording(drive.period, segments)
    measured = np.stack([drive["vx"], drive["vy"], drive["r"]], axis=1)
    noise = np.array([difference_noise(column, list(segments)) for column in measured.T])
    # A channel without visible noise would make certainty of rounding.
    floor = VISIBLE * np.maximum(measured.std(axis=0), 1e-6)
    noise = np.where(np.isfinite(noise), np.maximum(noise, floor), floor)
    smooth = np.stack(
        [_smoothed(column, sigma, recording) for column, sigma in zip(measured.T, noise, strict=True)], axis=1
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
        predicted=_all_predicted(measured, smooth, noise, recording)[0],
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


def _smoothed(values: np.ndarray, sigma: float, recording: Recording) -> np.ndarray:
    """Fit local cubics over the longest window that takes away no more than noise."""
    from scipy.signal import savgol_filter

    best = values
    for seconds in _WINDOWS_SECONDS:
        length = 2 * int(round(0.5 * seconds / recording.period)) + 1
        if length < 5:
            continue
        trial = values.copy()
        fitted = False
        for begin, end in recording.segments:
            if end - begin > length:
                trial[begin:end] = savgol_filter(values[begin:end], length, 3, mode="interp")
                fitted = True
        if not fitted or np.std(trial - values) > _SLACK * sigma:
            break
        best = trial
    return best


def predicted_by_model(series: Series, vehicle: Vehicle) -> Series:
    """Return the series with states predicted by the nominal model too, where that errs less.

    Notes
    -----
    The model's rates at the predicted states, summed up, move with the commands as the car does. What it lacks varies
    slowly, and is what polynomials predict then. Neither knows what comes later.
    """
    moved, recording = np.zeros_like(series.measured), series.recording
    plain = _all_predicted(series.measured, series.smooth, series.noise, recording)
    rates = replace(series, predicted=plain[0]).rates(extended_model(vehicle))
    for begin, end in recording.segments:
        moved[begin + 1 : end] = np.cumsum(series.period * rates[begin : end - 1], axis=0)
    by_model = _all_predicted(series.measured - moved, series.smooth - moved, series.noise, recording)
    predicted = np.where(by_model[1] < plain[1], moved + by_model[0], plain[0])
    return replace(series, predicted=predicted)


def _all_predicted(
    measured: np.ndarray, smooth: np.ndarray, noise: np.ndarray, recording: Recording
) -> tuple[np.ndarray, np.ndarray]:
    """Return predictions of every channel, shape (N, 3), and the rms by which they miss the samples, shape (3,)."""
    found = [predicted_from_the_past(*columns, recording) for columns in zip(measured.T, smooth.T, noise, strict=True)]
    return np.stack([one for one, _ in found], axis=1), np.array([error for _, error in found])


def predicted_from_the_past(
    values: np.ndarray, smooth: np.ndarray, sigma: float, recording: Recording
) -> tuple[np.ndarray, float]:
    """Return every sample, shape (N,), as a polynomial through earlier ones predicts it, and the rms error.

    Degree and window are those that err least. Where a recording begins, and where a prediction errs more than one
    measured sample does, the smoothed value stays: noise is next to nothing there, beside what varies.
    """
    best, least = smooth, np.sqrt(2.0) * sigma  # of a prediction that errs as one sample does, seen with its noise
    for seconds in _WINDOWS_SECONDS:
        length = int(round(seconds / recording.period))
        for degree in (one for one in _DEGREES if one < length):
            weights = np.linalg.pinv(np.vander(np.arange(-length, 0) / length, degree + 1, increasing=True))[0]
            trial, known = smooth.copy(), np.zeros(len(values), dtype=bool)
            for begin, end in recording.segments:
                if end - begin > length:
                    trial[begin + length : end] = np.convolve(values[begin:end], weights[::-1], mode="valid")[:-1]
                    known[begin + length : end] = True
            error = float(np.sqrt(np.mean((values - trial)[known] ** 2))) if known.any() else np.inf
            if error < least:
                best, least = trial, error
    return best, least
