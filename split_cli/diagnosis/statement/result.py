"""What a diagnosis says: the tree that `diagnosis.json`, the report and the proof are written from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

__all__ = [
    "Combination",
    "CorrectedVehicle",
    "Detectable",
    "Diagnosis",
    "Finding",
    "HorizonErrors",
    "Improvement",
    "InputFile",
    "Lead",
    "Location",
    "ParameterEstimate",
    "Place",
    "RemainderTest",
    "RivalSummary",
    "StateChange",
    "Verdict",
]

_NORMAL_95 = 1.96
_AS_GOOD = 2.5  # standard errors; of an exact degeneracy another variant may have been fitted, and be worse
_SHOWS = 1.25  # error before over the noise floor, from which on held-out rollouts show a gap

Verdict = Literal["match", "mismatch", "undecided"]


@dataclass(frozen=True)
class ParameterEstimate:
    """One parameter of a finding."""

    value: float
    std_error: float | None
    unit: str
    interval_95: tuple[float, float]

    def covering(self, other: ParameterEstimate) -> ParameterEstimate:
        """Return this estimate with an interval that also holds another's."""
        low = min(self.interval_95[0], other.interval_95[0])
        high = max(self.interval_95[1], other.interval_95[1])
        error = max(high - self.value, self.value - low) / _NORMAL_95
        return replace(self, std_error=max(error, self.std_error or 0.0), interval_95=(low, high))


@dataclass(frozen=True)
class Combination:
    """A weighted sum of a finding's parameters that is known, where none of them is by itself.

    Attributes
    ----------
    weights : mapping of str to float
        By parameter; the largest is 1.
    value : float
        Weighted sum of how far the parameters are from neutral.
    unit : str
        Of the parameters; empty where they differ in it, the weights then having units.
    interval_95 : tuple of float
        Of the sum, simultaneous with all other sums (Scheffe).
    """

    weights: Mapping[str, float]
    value: float
    unit: str
    interval_95: tuple[float, float]


@dataclass(frozen=True)
class RivalSummary:
    """Another term in a finding's place.

    Attributes
    ----------
    term, variant : str
    excess : float
        How much worse it explains the recording, in units of chi squared.
    z : float
        The same in standard errors, from block by block differences.
    """

    term: str
    variant: str
    excess: float
    z: float


@dataclass(frozen=True)
class Finding:
    """A named piece of physics, or a fault of the measurement.

    Attributes
    ----------
    term, variant : str
    parameters : mapping of str to ParameterEstimate
    gap_explained : float
        Share of the held-out squared error above the noise floor that returns when this term alone is removed.
    alternatives : tuple of str
        Terms that fit as well on this data, and exact degeneracies; a pair is written ``a+b``.
    sentence : str
    effect_to_noise : float
        Rms of its 0.05 s prediction error over that of sensor noise, in the worst channel [1].
    runners_up : tuple of RivalSummary
        Best first; the first that is no alternative is the placebo.
    separated_by : tuple of str
        Excitations that would tell alternatives apart.
    exported : bool
        Whether it belongs into the vehicle file; sensor faults do not.
    combination : Combination or None
        What is known of the parameters together, where no interval of one leaves out its neutral value.
    """

    term: str
    variant: str
    parameters: Mapping[str, ParameterEstimate]
    gap_explained: float
    alternatives: tuple[str, ...]
    sentence: str
    effect_to_noise: float
    runners_up: tuple[RivalSummary, ...] = ()
    separated_by: tuple[str, ...] = ()
    exported: bool = True
    combination: Combination | None = None

    @property
    def placebo(self) -> RivalSummary | None:
        """The best wrong term."""
        return next((rival for rival in self.runners_up if rival.term not in self.alternatives), None)

    def is_as_good(self, rival: RivalSummary) -> bool:
        """Return whether a runner-up is an alternative, in the very variant it was fitted in."""
        return rival.term in self.alternatives and (rival.z < _AS_GOOD or rival.excess <= 0.0)


@dataclass(frozen=True)
class Lead:
    """An explanation that is no finding, since no real car of this size has what it would need.

    Attributes
    ----------
    term, variant : str
    parameters : mapping of str to ParameterEstimate
        What it would need.
    limits : mapping of str to (float, float)
        What a real car can have, of those parameters that would have to go beyond.
    share : float
        Of what the best explanation saves, how much this one would save alone.
    instead : tuple of str
        Terms that explain nearly as much within what a car can have, best first.
    sentence : str
    """

    term: str
    variant: str
    parameters: Mapping[str, ParameterEstimate]
    limits: Mapping[str, tuple[float, float]]
    share: float
    instead: tuple[str, ...]
    sentence: str


@dataclass(frozen=True)
class Place:
    """A stretch of track: s [m], lap length [m] or None, and the world position of its middle [m]."""

    s_start: float
    s_end: float
    lap_length: float | None
    reference: Literal["position", "dead_reckoned"]
    x: float | None
    y: float | None


@dataclass(frozen=True)
class Location:
    """Where the gap is.

    Attributes
    ----------
    forces : mapping of str to float
        Shares of ``longitudinal``, ``front_lateral``, ``rear_lateral``; they sum to 1.
    depends_on : tuple of (str, float)
        Variables and scores, strongest first; a score is the share of the gap the variable alone explains.
    region : mapping of str to (float, float)
        Where the gap is larger than elsewhere, by variable, SI.
    place : Place or None
    time : (float, float) or None
        In the real drive's t [s].
    share_of_gap, share_of_samples : float
        Of the region, place or time above.
    """

    forces: Mapping[str, float]
    depends_on: tuple[tuple[str, float], ...]
    region: Mapping[str, tuple[float, float]]
    place: Place | None
    time: tuple[float, float] | None
    share_of_gap: float
    share_of_samples: float


@dataclass(frozen=True)
class RemainderTest:
    """Whether what is left after the findings is noise.

    Attributes
    ----------
    p_value : float
    share : float
        Of the gap that has no name [1].
    effect_to_noise : float
    by_group : tuple of (str, float)
        What kinds of dependence explain of it, strongest first, in units of chi squared.
    formula : str
        The best sparse formula as a lead; empty when the remainder is noise.
    drifts : tuple of (str, float)
        What the findings' parameters drift with, strongest first, and the cost a drift would save.
    explained : float or None
        Share of the held-out squared error above the noise floor that returns when all findings are removed [1];
        None where it was not measured.
    """

    p_value: float
    share: float
    effect_to_noise: float
    by_group: tuple[tuple[str, float], ...]
    formula: str = ""
    drifts: tuple[tuple[str, float], ...] = ()
    explained: float | None = None

    def without_structure(self, findings: Sequence[Finding]) -> float:
        """Return the share of the gap [1] that neither findings nor a smooth function explain.

        Shares of single findings may overlap; their sum stands in where they were not measured together.
        """
        explained = self.explained
        if explained is None:
            explained = sum(finding.gap_explained for finding in findings)
        return max(1.0 - self.share - explained, 0.0)


@dataclass(frozen=True)
class StateChange:
    """Held-out rms errors of one velocity at the end of free running: nominal model and corrected vehicle.

    Attributes
    ----------
    channel, unit : str
    horizon : float
        [s]
    nominal, corrected, persistence, noise_floor : float
        In `unit`.
    change : float
        Of the squared error, corrected less nominal, in standard errors by blocks of time [1].
    """

    channel: str
    unit: str
    horizon: float
    nominal: float
    corrected: float
    persistence: float
    noise_floor: float
    change: float

    @property
    def is_worse(self) -> bool:
        """Whether the corrected vehicle predicts worse than the nominal one, beyond chance and beyond noise."""
        return self.change > _NORMAL_95 and self.corrected > self.noise_floor

    @property
    def is_better(self) -> bool:
        """Whether it predicts better, beyond chance."""
        return self.change < -_NORMAL_95


@dataclass(frozen=True)
class CorrectedVehicle:
    """The vehicle with what was found of the car, judged beside the nominal model on held-out time.

    Attributes
    ----------
    states : tuple of StateChange
        Every velocity after one step of 0.05 s and at the longest horizon that fits, 2 s at most.
    """

    states: tuple[StateChange, ...]

    @property
    def accepted(self) -> bool:
        """Whether it is no worse than the nominal model in any state beyond chance."""
        return not any(one.is_worse for one in self.states)


@dataclass(frozen=True)
class HorizonErrors:
    """Held-out rms errors of open-loop rollouts of one length: v_x, v_y [m/s], r [rad/s].

    Attributes
    ----------
    horizon : float
        [s]
    before, physics, split_only, after, persistence : tuple of three floats
        As in `Improvement`.
    noise_floor : tuple of three floats
        What sensor noise at the start and at the end makes.
    confidence : mapping of str to list
        95 % intervals by block bootstrap, channel by channel, and the number of ``blocks``.
    starts : int
    change : mapping of str to (float, float, float)
        Of a stage's squared error against ``before``, in standard errors by blocks of time [1].
    mean : mapping of str to (float, float, float)
        Mean error of a stage over all starts, model less recording.
    """

    horizon: float
    before: tuple[float, ...]
    physics: tuple[float, ...]
    split_only: tuple[float, ...]
    after: tuple[float, ...]
    persistence: tuple[float, ...]
    noise_floor: tuple[float, ...]
    confidence: Mapping[str, object]
    starts: int
    change: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    mean: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    def mean_share(self, stage: str, k: int) -> float | None:
        """Return how much of a stage's squared error in channel k its mean error makes [1]; None where unknown."""
        error = getattr(self, stage)[k]
        return (self.mean[stage][k] / error) ** 2 if stage in self.mean and error > 0.0 else None

    def most_changed(self, stage: str) -> int:
        """Return the channel (0 to 2) whose error a stage changes most in units of noise, for better or worse."""
        changes = zip(self.before, getattr(self, stage), self.noise_floor, strict=True)
        sizes = [abs(other - before) / max(noise, 1e-12) for before, other, noise in changes]
        return sizes.index(max(sizes))

    def worse(self, stage: str) -> tuple[int, ...]:
        """Return the channels whose error a stage makes larger beyond chance (5 %, two-sided)."""
        return tuple(k for k, z in enumerate(self.change.get(stage, ())) if z > _NORMAL_95)

    def beaten_by_persistence(self, stage: str) -> tuple[int, ...]:
        """Return the channels that velocities held as they are predict better than a stage does."""
        pairs = zip(getattr(self, stage), self.persistence, strict=True)
        return tuple(k for k, (error, held) in enumerate(pairs) if error > held)


@dataclass(frozen=True)
class Improvement:
    """Held-out one-step errors in label units, of v_x, v_y [m/s^2] and r [rad/s^2].

    Attributes
    ----------
    before, physics, after, split_only, persistence : tuple of three floats
        Simulation as learned; plus terms; plus terms and SPLIT; plus SPLIT alone; last velocities held.
    noise_floor : tuple of three floats or None
    confidence : mapping of str to list
        95 % intervals by block bootstrap, channel by channel.
    rollouts : tuple of HorizonErrors
        Shortest first; none where no horizon fits into the held-out time.
    removed : mapping of str to (float, float, float) or None
        For ``physics``, ``split_only`` and ``after``: the share of the squared error above the noise floor that is
        gone, channels weighed by their noise, and its 95 % interval; None where nothing was left to improve.
    simulation_part : mapping of str to mapping
        What of the simulation the models ``before`` and ``physics`` hold, ``longitudinal`` and ``lateral``:
        ``nominal`` for the nominal model alone, ``taught`` with what the simulation taught at recorded states,
        ``taught_elsewhere`` also of others.
    trust : mapping of str to (float, float, float)
        Share of SPLIT's prediction that ``split_only`` and ``after`` apply, an output [1].
    """

    before: tuple[float, ...]
    physics: tuple[float, ...]
    after: tuple[float, ...]
    split_only: tuple[float, ...]
    persistence: tuple[float, ...]
    noise_floor: tuple[float, ...] | None
    confidence: Mapping[str, object]
    rollouts: tuple[HorizonErrors, ...] = ()
    removed: Mapping[str, tuple[float, float, float] | None] = field(default_factory=dict)
    simulation_part: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    trust: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    @property
    def tells(self) -> bool:
        """Whether held-out time shows the gap at all: an effect of one place may lie outside it."""
        shown = [
            b / max(n, 1e-12) for one in self.rollouts for b, n in zip(one.before, one.noise_floor, strict=True)
        ]
        return any(self.removed.values()) or max(shown, default=0.0) > _SHOWS


@dataclass(frozen=True)
class Detectable:
    """From which size on a term would have been named, alone.

    Attributes
    ----------
    term : str
    parameters : mapping of str to (float, str)
        Value and unit, of each the value it needs while the others are as without the effect; those are left out
        that would be named at no size.
    """

    term: str
    parameters: Mapping[str, tuple[float, str]]


@dataclass(frozen=True)
class InputFile:
    """A file that was read: name without folder, SHA-256, and role."""

    name: str
    sha256: str
    role: Literal["real", "sim", "holdout", "vehicle"]


@dataclass(frozen=True)
class GapSeries:
    """The gap along one real recording.

    Attributes
    ----------
    drive : str
    t, s : ndarray, shape (G,)
    row : ndarray of int64, shape (G,)
    x, y : ndarray, shape (G,)
        World position [m]; NaN without one.
    operating_point : ndarray, shape (G, 4)
        alpha_f, alpha_r [rad], T/T_max [1] and v_x [m/s].
    compared : ndarray of bool, shape (G,)
        Whether simulation and reality have both been there.
    forces : ndarray, shape (G, 3)
        Total longitudinal, front lateral and rear lateral force [N], averaged over about 0.2 s.
    remainder : ndarray, shape (G, 3)
        The same after the findings.
    """

    drive: str
    t: np.ndarray
    s: np.ndarray
    row: np.ndarray
    x: np.ndarray
    y: np.ndarray
    operating_point: np.ndarray
    compared: np.ndarray
    forces: np.ndarray
    remainder: np.ndarray


@dataclass(frozen=True)
class Diagnosis:
    """Everything a diagnosis found.

    Attributes
    ----------
    verdict : {"match", "mismatch", "undecided"}
    p_value : float or None
    compared_share : float
        Share of the real drive where both have been.
    not_judged : tuple of str
    location : Location or None
    findings : tuple of Finding
        Strongest first.
    unexplained : bool
    remainder : RemainderTest or None
    improvement : Improvement or None
    inputs : tuple of InputFile
    settings : mapping
    gaps : tuple of GapSeries
    history : tuple of str
        Steps of the selection, in words.
    summary : str
        One paragraph a reader can act on.
    detectable : tuple of Detectable
        What a silence about each term is worth; none where nothing was decided.
    corrected_vehicle : CorrectedVehicle or None
        None where nothing of the car was found, or no held-out time can judge it.
    leads : tuple of Lead
        Explanations that no real car can have, with what it would take and what explains as much.
    """

    verdict: Verdict
    p_value: float | None
    compared_share: float
    not_judged: tuple[str, ...] = ()
    location: Location | None = None
    findings: tuple[Finding, ...] = ()
    unexplained: bool = False
    remainder: RemainderTest | None = None
    improvement: Improvement | None = None
    inputs: tuple[InputFile, ...] = ()
    settings: Mapping[str, object] = field(default_factory=dict)
    gaps: tuple[GapSeries, ...] = ()
    history: tuple[str, ...] = ()
    summary: str = ""
    detectable: tuple[Detectable, ...] = ()
    corrected_vehicle: CorrectedVehicle | None = None
    leads: tuple[Lead, ...] = ()
