"""Results of a diagnosis: the data classes from which `diagnosis.json`, the report and the proof are written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from split_cli.diagnosis.statement.improvement import NORMAL_95, CorrectedVehicle, Improvement
from split_cli.vehicle.parameters import EffectSpec

_AS_GOOD = 2.5  # standard errors up to which an alternative's fitted variant is as good; another one may be meant

Verdict = Literal["match", "mismatch", "undecided"]


@dataclass(frozen=True)
class ParameterEstimate:
    """Estimate of one parameter, in `unit`."""

    value: float
    std_error: float | None
    unit: str
    interval_95: tuple[float, float]

    def covering(self, other: ParameterEstimate) -> ParameterEstimate:
        """Return this estimate with an interval that also contains another's."""
        low = min(self.interval_95[0], other.interval_95[0])
        high = max(self.interval_95[1], other.interval_95[1])
        error = max(high - self.value, self.value - low) / NORMAL_95
        return replace(self, std_error=max(error, self.std_error or 0.0), interval_95=(low, high))


@dataclass(frozen=True)
class Combination:
    """A weighted sum of parameters whose interval excludes no effect, where no single parameter's does.

    Attributes
    ----------
    weights : mapping of str to float
        By parameter; the largest is 1.
    value : float
        Weighted sum of the parameters less their neutral values.
    unit : str
        Common unit of the parameters; empty if they differ.
    interval_95 : tuple of float
        Of the sum, simultaneous for all weighted sums (Scheffe).
    """

    weights: Mapping[str, float]
    value: float
    unit: str
    interval_95: tuple[float, float]


@dataclass(frozen=True)
class RivalSummary:
    """Another term in place of a finding.

    Attributes
    ----------
    excess : float
        Cost of the explanation with it less that with the finding [chi squared].
    z : float
        The same in standard errors over blocks of time [1].
    """

    term: str
    variant: str
    excess: float
    z: float


@dataclass(frozen=True)
class Finding:
    """A named effect of the car, or a sensor fault.

    Attributes
    ----------
    gap_explained : float
        Increase of the held-out squared error if this term alone is removed, as a share of that above the noise floor
        [1].
    alternatives : tuple of str
        Ids of terms that explain these data as well, and of equivalent terms; a pair is written ``a+b``.
    effect_to_noise : float
        Rms of its 0.05 s prediction error over that of sensor noise, largest over channels [1].
    runners_up : tuple of RivalSummary
        Other terms in its place, best first.
    separated_by : tuple of str
        For each alternative, the excitation that would distinguish it.
    exported : bool
        Whether it belongs into the vehicle file; sensor faults do not.
    combination : Combination or None
        If no parameter's interval excludes its neutral value.
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
    def label(self) -> str:
        """``term`` or ``term (variant)``."""
        return EffectSpec(self.term, variant=self.variant).label

    @property
    def placebo(self) -> RivalSummary | None:
        """The best other term that is no alternative."""
        return next((rival for rival in self.runners_up if rival.term not in self.alternatives), None)

    def is_as_good(self, rival: RivalSummary) -> bool:
        """Return whether a runner-up is an alternative in the variant that was fitted."""
        return rival.term in self.alternatives and (rival.z < _AS_GOOD or rival.excess <= 0.0)


@dataclass(frozen=True)
class Lead:
    """An explanation that is no finding.

    It needs values beyond a real car's range, held-out data are predicted worse with it, or the findings may hide it.

    Attributes
    ----------
    parameters : mapping of str to ParameterEstimate
        Values that it would need.
    limits : mapping of str to (float, float)
        Range of a real car of those parameters that would be outside; empty if none is.
    share : float
        Its saving, alone or beside the findings, over that of the best explanation [1]. If held-out data are the
        reason, its `gap_explained` as a finding.
    instead : tuple of str
        Ids of terms that explain nearly as much within a car's range, best first.
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
        Variables and scores, largest first. A score is the share of the gap that the variable explains alone [1].
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
    """Test of whether the remainder after the findings is noise.

    Attributes
    ----------
    share : float
        Unexplained share of the gap [1].
    by_group : tuple of (str, float)
        Saving of each group of functions of the flexible fit, largest first [chi squared].
    formula : str
        The best sparse formula as a lead; empty when the remainder is noise.
    explained : float or None
        Share of the held-out squared error above the noise floor that all findings explain by themselves [1]; None if
        it was not measured.
    """

    p_value: float
    share: float
    effect_to_noise: float
    by_group: tuple[tuple[str, float], ...]
    formula: str = ""
    explained: float | None = None

    def without_structure(self, findings: Sequence[Finding]) -> float:
        """Return the share of the gap [1] that neither findings nor a smooth function explain.

        Without a measured joint share the sum of the findings' shares is used, although these may overlap.
        """
        explained = self.explained
        if explained is None:
            explained = sum(finding.gap_explained for finding in findings)
        return max(1.0 - self.share - explained, 0.0)


@dataclass(frozen=True)
class Detectable:
    """Detection limit of a term.

    Attributes
    ----------
    parameters : mapping of str to (float, str)
        Smallest value that would be named, and its unit, with the other parameters at neutral. Parameters that would
        not be named at any size are left out.
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
        Share of the real drive at common operating points [1].
    findings : tuple of Finding
        Strongest first.
    history : tuple of str
        Steps of the search, in words.
    sentences : tuple of str
        Summary.
    detectable : tuple of Detectable
        Detection limits. With the verdict ``undecided`` they hold as if nothing differed.
    corrected_vehicle : CorrectedVehicle or None
        None without findings of the car, or without enough held-out time.
    leads : tuple of Lead
        Explanations that are no findings.
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
    def doubt(self) -> str:
        """What speaks against the names or their file, said before all that speaks for them; empty if nothing does."""
        if self.corrected_vehicle is None or self.corrected_vehicle.accepted or not self.findings:
            return ""
        if self.improvement is not None and self.improvement.corrects_simulation:
            # The file lacks what the simulation has, too, and that may have cancelled with a finding.
            return "The names hold beside the simulation. The file alone predicts held-out data worse with them."
        return "Do not rely on these names yet: held-out data are predicted worse with them than with the given file."

    @property
    def summary(self) -> str:
        """The sentences as one paragraph."""
        return " ".join(self.sentences)
