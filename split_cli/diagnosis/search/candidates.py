"""`Candidate`: a term in one variant, with ranges, steps and starting values of its parameters for fits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from split_cli.diagnosis.recording.series import Series
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.effects.search import Course, Range
from split_cli.vehicle.parameters import EffectSpec, Vehicle

__all__ = ["Candidate", "Range", "build_candidates"]

_NEAR = 0.1  # steps from a bound within which a value counts as at the bound [1]
_WIDE = (1.0, 4.0, 12.0, -1.0, -4.0, -12.0)  # factors on a start for `widely_started` [1]


@dataclass(frozen=True)
class Candidate:
    """One term in one variant, with ranges and starting values of its parameters."""

    term: str
    variant: str
    ranges: Mapping[str, Range]
    starts: tuple[Mapping[str, float], ...]  # several if the cost has several minima
    located: str = ""  # ``patch``, ``stretch`` or ``wave`` if a place along the track is scanned for, else empty
    complexity: float = 1.0  # number of parameters that the price counts; a place counts more than a scale
    # By parameter, the distance from no effect up to which the equations of motion alone have to show a fault.
    by_acceleration: Mapping[str, float] = field(default_factory=dict)

    def build(self, values: Mapping[str, float]) -> Term:
        """Return the term with values clipped to their ranges."""
        inside = {name: float(min(max(values[name], limit.lower), limit.upper)) for name, limit in self.ranges.items()}
        return CATALOGUE[self.term](inside, self.variant)

    def everywhere(self) -> tuple[Term, float]:
        """Return a located term that acts all along the track, and its distance from no effect."""
        return CATALOGUE[self.term].everywhere(self.variant)

    def widely_started(self) -> Candidate:
        """Return the candidate with starts of both signs, up to 12 times as far from neutral, if it has one."""
        if len(self.starts) != 1:
            return self
        (start,) = self.starts
        wide = [self.moved(start, factor) for factor in _WIDE]
        return replace(self, starts=tuple(one for one in wide if self.allows(one)))

    def moved(self, start: Mapping[str, float], factor: float) -> dict[str, float]:
        """Return a start whose distance from neutral is multiplied; parameters without a neutral value stay."""
        neutral = CATALOGUE[self.term].neutral
        return {
            name: value if neutral.get(name) is None else neutral[name] + factor * (value - neutral[name])
            for name, value in start.items()
        }

    def allows(self, values: Mapping[str, float]) -> bool:
        """Return whether values are inside the ranges."""
        return all(limit.lower <= values[name] <= limit.upper for name, limit in self.ranges.items())

    def at_limit(self, values: Mapping[str, float]) -> bool:
        """Return whether a value is at an end of a real car's range, so that the data may want more."""
        neutral = CATALOGUE[self.term].neutral

        def ends(name: str, limit: Range) -> bool:
            near = _NEAR * limit.step
            beyond = values[name] >= limit.upper - near and not limit.ends_complete
            below = values[name] <= limit.lower + near and not limit.ends_at_none
            return (beyond or below) and abs(values[name] - neutral[name]) > near

        return any(ends(name, limit) for name, limit in self.ranges.items() if neutral.get(name) is not None)

    def is_within_tolerance(self, values: Mapping[str, float], *, shown_by_motion: bool = False) -> bool:
        """Return whether all values are within the tolerances of sound sensors; most terms have none.

        Parameters
        ----------
        shown_by_motion : bool
            Whether the equations of motion alone show the values: what an acceleration may show does not count then.
        """
        limits = {name: one.tolerance for name, one in self.ranges.items()} if shown_by_motion else self.tolerances
        return all(away < limits[name] for name, away in self.away(values).items())

    @property
    def tolerances(self) -> dict[str, float]:
        """Distance from no effect by parameter up to which a fault is within tolerance, in its unit."""
        return {name: max(one.tolerance, self.by_acceleration.get(name, 0.0)) for name, one in self.ranges.items()}

    def away(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the distances of values from neutral; parameters without a neutral value are left out."""
        neutral = CATALOGUE[self.term].neutral
        return {name: abs(values[name] - neutral[name]) for name in self.ranges if neutral.get(name) is not None}

    def without_position(self, *, beside_simulation: bool) -> Candidate:
        """Return the candidate with the larger tolerances of recordings without position.

        Without a simulation the equations of motion have model-form error, and show no fault of a sensor alone.
        """
        lacking = self.with_tolerances({name: one.tolerance_without_position for name, one in self.ranges.items()})
        felt = {name: one.tolerance_by_acceleration for name, one in self.ranges.items()}
        return replace(lacking, by_acceleration=felt) if beside_simulation else lacking.with_tolerances(felt)

    def with_tolerances(self, tolerances: Mapping[str, float]) -> Candidate:
        """Return the candidate with at least these tolerances, by parameter, see `Range`."""
        ranges = {
            name: replace(limit, tolerance=max(limit.tolerance, tolerances.get(name, 0.0)))
            for name, limit in self.ranges.items()
        }
        return replace(self, ranges=ranges)

    def is_another(self, values: Mapping[str, float]) -> bool:
        """Return whether a value is at a bound where the term equals another term of the catalogue."""
        return any(
            limit.ends_as_another and values[name] <= limit.lower + _NEAR * limit.step
            for name, limit in self.ranges.items()
        )

    def unlimited(self) -> Candidate:
        """Return the candidate with wider ranges, to find the value beyond a real car's range that it would need."""
        neutral = CATALOGUE[self.term].neutral
        ranges = {
            name: limit if neutral.get(name) is None else limit.widened(neutral[name])
            for name, limit in self.ranges.items()
        }
        return replace(self, ranges=ranges)

    @property
    def needs(self) -> frozenset[str]:
        """What a recording must have to show the term, see `Term.needs`; a located term also needs position."""
        kind = CATALOGUE[self.term]
        place = frozenset({"position"} if self.located else ())
        return kind.needs | kind.variant_needs.get(self.variant, frozenset()) | place

    @property
    def effect(self) -> str:
        """Name of the effect: a variant with parameters of its own, such as another late channel, is another one."""
        own = self.variant in CATALOGUE[self.term].variant_units and not self.located
        return self.label if own else self.term

    @property
    def label(self) -> str:
        """``term`` or ``term (variant)``."""
        return EffectSpec(self.term, variant=self.variant).label


def build_candidates(vehicle: Vehicle, series: Series) -> list[Candidate]:
    """Return every term and variant that makes sense for a vehicle and a recording."""
    course = Course(max(float(series.t[-1]), 1.0), series.lap_length or float(series.s.max()))
    out = []
    for kind in CATALOGUE.values():
        for variant in kind.variants:
            search = kind.search(vehicle, course, variant)
            if search is None:
                continue
            search = search.times(kind.sizes(vehicle))
            complexity = float(len(search.ranges)) if search.complexity is None else search.complexity
            out.append(Candidate(kind.id, variant, search.ranges, search.starts, search.located, complexity))
    return out
