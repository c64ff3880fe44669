"""What a diagnosis says: the tree that `diagnosis.json`, the report and the proof are written from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from split_cli.diagnosis.statement.improvement import NORMAL_95, CorrectedVehicle, Improvement

_AS_GOOD = 2.5  # standard errors; of an exact degeneracy another variant may have been fitted, and be worse

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
        error = max(high - self.value, self.value - low) / NORMAL_95
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
    gap_explained : float
        Share of the held-out squared error above the noise floor that returns when this term alone is removed.
    alternatives : tuple of str
        Terms that fit as well on this data, and exact degeneracies; a pair is written ``a+b``.
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
    """An explanation that is no finding.

    No real car has what it would need, held-out time speaks against it, or the findings may hide it.

    Attributes
    ----------
    parameters : mapping of str to ParameterEstimate
        What it would need.
    limits : mapping of str to (float, float)
        What a real car can have, of those parameters that would have to go beyond; empty where none would.
    share : float
        Of what the best explanation saves, how much this one would save, alone or beside the findings; where
        held-out time speaks against it, its `gap_explained` as a finding.
    instead : tuple of str
        Terms that explain nearly as much within what a car can have, best first.
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
    share : float
        Of the gap that has no name [1].
    by_group : tuple of (str, float)
        What kinds of dependence explain of it, strongest first, in units of chi squared.
    formula : str
        The best sparse formula as a lead; empty when the remainder is noise.
    explained : float or None
        Share of the held-out squared error above the noise floor that all findings take by themselves [1]; None
        where it was not measured.
    """

    p_value: float
    share: float
    effect_to_noise: float
    by_group: tuple[tuple[str, float], ...]
    formula: str = ""
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
class Detectable:
    """From which size on a term would have been named, alone.

    Attributes
    ----------
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
    compared_share : float
        Share of the real drive where both have been.
    findings : tuple of Finding
        Strongest first.
    history : tuple of str
        Steps of the selection, in words.
    sentences : tuple of str
        The whole in sentences that a reader can act on.
    detectable : tuple of Detectable
        What a silence about each term is worth. Where the verdict is undecided, sizes hold if nothing differs yet.
    corrected_vehicle : CorrectedVehicle or None
        None where nothing of the car was found, or no held-out time can judge it.
    leads : tuple of Lead
        Explanations that are no findings, with what they would take and what explains as much.
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
    sentences: tuple[str, ...] = ()
    detectable: tuple[Detectable, ...] = ()
    corrected_vehicle: CorrectedVehicle | None = None
    leads: tuple[Lead, ...] = ()

    @property
    def summary(self) -> str:
        """The sentences as one paragraph."""
        return " ".join(self.sentences)
