"""Responses of oscillators to the car's accelerations: what a mass on a spring, which the model lacks, would do.

A load or fuel that sloshes, a trailer and a body that rolls are masses on springs. They are no function of the
operating point and no first-order memory of it. The residuals of a model that lacks one are correlated with what the
accelerations did up to some seconds before. This is the test of the cross-correlation of residuals and inputs (Ljung,
System Identification, 1999, section 16.6), in a basis of lightly damped oscillators.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from split_cli.diagnosis.baseline.discrepancy import scaled_features, spread
from split_cli.diagnosis.innovations.effect_to_noise import windowed
from split_cli.diagnosis.innovations.evidence import Evidence, integrated
from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.recording.series import Series
from split_cli.diagnosis.remainder.flexible import LAGS, FlexiblePiece, rates_by_forces
from split_cli.diagnosis.remainder.structure import FlexibleFit, Structure, build_structure
from split_cli.diagnosis.statement.wording import swinging_in_words
from split_cli.vehicle.effects.recording import Recording, first_order_response
from split_cli.vehicle.parameters import Vehicle

#: Natural frequencies [Hz], half an octave apart. Judgement: fuel in a tank sloshes 0.4 times a second, a body rolls up
#: to three times a second. Faster are servos and tyres, which every car has, and of which a lag is an approximation:
#: between equal model cars they save as much at 5.6 Hz as a load that sloshes.
FREQUENCIES = tuple(0.35 * 2.0 ** (0.5 * k) for k in range(7))
#: Damping ratio [1]. The response is wide by twice the damping ratio, so that neighbours overlap. Judgement.
_DAMPING = 0.1
#: Singular values of the lags below this share of the largest count as zero [1]; judgement: well above rounding.
_RANK = 1e-6
#: Frequencies that far apart in `FREQUENCIES` count as others [1]: an octave and a half. Judgement: an octave off, a
#: response is a third of its peak still.
_APART = 3


@dataclass(frozen=True)
class OscillatorRows:
    """Rows of one recording: of the oscillators of each frequency, and of what they are beside."""

    swings: tuple[FlexiblePiece, ...]
    first_order: FlexiblePiece  # the accelerations and first-order lags of them


def oscillator_rows(one: Evidence) -> OscillatorRows:
    """Return the rows of the oscillators of each frequency, in all directions."""
    along, across = accelerations(one.series, one.vehicle)
    recording, forces = one.series.recording, rates_by_forces(one.vehicle)

    def piece(of_along: list[np.ndarray], of_across: list[np.ndarray], group: str) -> FlexiblePiece:
        blocks = spread([(0, of_along), (1, of_across), (2, of_across)], forces)
        defects = integrated(one.series, np.concatenate(list(blocks), axis=2), one.linear)
        return FlexiblePiece(one.whitener(defects), windowed(one.series, defects, one.at), group)

    def lags(drive: np.ndarray) -> list[np.ndarray]:
        return [drive, *(first_order_response(drive, 1.0 / tau, recording) - drive for tau in LAGS)]

    swings = tuple(
        piece(*(swinging(recording, drive, frequency) for drive in (along, across)), swinging_in_words(frequency))
        for frequency in FREQUENCIES
    )
    return OscillatorRows(swings, piece(lags(along), lags(across), "first order"))


@dataclass(frozen=True)
class Oscillators:
    """The fits of oscillators on the rows of an objective, one for each of the `FREQUENCIES`."""

    fits: tuple[Structure, ...]

    def with_objective(self, objective: MarginalLikelihood) -> Oscillators:
        """Return the same fits with another objective of the same rows."""
        return Oscillators(tuple(replace(one, objective=objective) for one in self.fits))

    def savings(self, residuals: np.ndarray, variance_inflation: float, noise: float) -> dict[str, float]:
        """Return what each frequency saves of whitened residuals (R,) beyond noise [chi squared], by group.

        Parameters
        ----------
        noise : float
            Variance of the noise in the residuals [1].
        """
        return {one.groups[0]: _beyond(one.fit(residuals, variance_inflation), noise) for one in self.fits}

    def least_likely(self, residuals: np.ndarray, variance_inflation: float) -> tuple[float, Structure, FlexibleFit]:
        """Return the frequency whose saving noise makes least likely.

        Parameters
        ----------
        residuals : ndarray, shape (R,)
            Whitened.
        variance_inflation : float
            Factor by which their autocorrelation widens chi squared [1].

        Returns
        -------
        p_value : float
            Corrected for the number of frequencies (Bonferroni).
        structure : Structure
        fit : FlexibleFit
            With what each frequency saves.

        Notes
        -----
        A mass on a spring is at one frequency. What a nominal model gets wrong of every drive is spread over all. So a
        frequency has to save clearly more than any other does beyond its own floor. Others are those that are an octave
        and a half away or more.
        """
        fitted = [one.fit(residuals, variance_inflation) for one in self.fits]
        saved = [_beyond(fit, variance_inflation) for fit in fitted]
        unusual = [max(own - one.floor, 0.0) for own, one in zip(saved, self.fits, strict=True)]
        tested = []
        for k, (one, fit) in enumerate(zip(self.fits, fitted, strict=True)):
            others = (other for j, other in enumerate(unusual) if abs(j - k) >= _APART)
            around = one.objective.policy.self_test.unnamed_margin * max(others, default=0.0)
            beside = replace(one, floor=max(one.floor, around))
            judged = beside.judged(fit, variance_inflation)
            tested.append((min(1.0, len(self.fits) * judged.p_value), beside, judged))
        p_value, structure, fit = min(tested, key=lambda one: one[0])
        groups = [one.groups[0] for one in self.fits]
        every = tuple(sorted(zip(groups, saved, strict=True), key=lambda pair: -pair[1]))
        return p_value, structure, replace(fit, group_saved=every)


def _beyond(fit: FlexibleFit, noise: float) -> float:
    """Return what a fit saves beyond noise of this variance [chi squared]."""
    return max(fit.saved - noise * fit.freedom, 0.0)


def build_oscillators(
    objective: MarginalLikelihood, rows: Sequence[OscillatorRows], floors: Mapping[str, float]
) -> Oscillators:
    """Return the fits of the oscillators on an objective's rows.

    Below its resonance an oscillator is a lag. So only what no first-order lag can represent is fitted.

    Parameters
    ----------
    rows : sequence of OscillatorRows
        Of each recording.
    floors : mapping of str to float
        Reduction of the cost that is no difference, by group [chi squared]; 0 where it is not given.
    """

    def whitened(pieces: Sequence[FlexiblePiece]) -> np.ndarray:
        return objective.whiten(objective.stack([piece.whitened for piece in pieces]))

    known = [one.first_order for one in rows]
    lags = whitened(known)

    def fit(pieces: Sequence[FlexiblePiece]) -> Structure:
        weights = np.linalg.lstsq(lags, whitened(pieces), rcond=_RANK)[0]
        beside = [
            [replace(one, whitened=one.whitened - lag.whitened @ weights, windows=one.windows - lag.windows @ weights)]
            for one, lag in zip(pieces, known, strict=True)
        ]
        return build_structure(objective, beside, floors.get(pieces[0].group, 0.0))

    return Oscillators(tuple(fit(several) for several in zip(*(one.swings for one in rows), strict=True)))


def accelerations(series: Series, vehicle: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """Return what drives the oscillators along and across the car, each over its 99 % quantile in size, (N,) each [1].

    Along the car it is the torque, across it v_x r. Both are of predicted states, which contain no later noise.
    """
    across = series.predicted[:, 0] * series.predicted[:, 2]
    return scaled_features(series, vehicle)[:, 2], across / max(float(np.quantile(np.abs(across), 0.99)), 1e-9)


def swinging(recording: Recording, drive: np.ndarray, frequency: float) -> list[np.ndarray]:
    """Return how far an oscillator is from where its drive would hold it, and that a quarter of a swing before.

    Parameters
    ----------
    drive : ndarray, shape (N,)
        Where the oscillator would come to rest [1].
    frequency : float
        Natural frequency [Hz].

    Returns
    -------
    list of ndarray
        Two of shape (N,), in the unit of the drive; 0 at the start of each segment.

    Notes
    -----
    With w = 2 pi f and damping ratio d let c = w (d + i sqrt(1 - d^2)). The complex state y' = c (drive - y) is a
    first-order lag with a complex rate. Its real and imaginary parts span the position and the velocity of the
    oscillator. It is exact for a drive that is linear between samples, as `first_order_response` is.
    """
    q = 2.0 * np.pi * frequency * recording.period * complex(_DAMPING, np.sqrt(1.0 - _DAMPING**2))
    kept = np.exp(-q)
    mean = (1.0 - kept) / q
    out = np.zeros(len(drive), dtype=complex)
    for begin, end in recording.segments:
        own = drive[begin:end]
        # y+ = kept y + (1 - kept) u + (1 - mean) (u+ - u), from y = u, for the distance y - u.
        out[begin + 1 : end] = lfilter([-mean], [1.0, -kept], np.diff(own))
    return [out.real, out.imag]
