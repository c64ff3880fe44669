"""Excitation that separates a finding from its alternatives."""

from collections.abc import Container, Sequence
from dataclasses import dataclass

from split_cli.diagnosis.statement.wording import term_name
from split_cli.vehicle.effects import CATALOGUE, Mimic


@dataclass(frozen=True)
class Separation:
    """How a term differs from an alternative."""

    alternative: str  # id; a combination is written ``a+b``
    hint: str  # the excitation or channel that would tell them apart, or why nothing can
    exact: bool  # whether no drive can

    @property
    def words(self) -> str:
        """Return it as one line for a list."""
        name = term_name(self.alternative)
        name = name[:1].upper() + name[1:]
        return f"{name}: no recording can, {self.hint}" if self.exact else f"{name}: {self.hint}"


def exact_mimics(term: str, variant: str) -> tuple[str, ...]:
    """Return what explains any recording as well as this term does in this variant."""
    mimics = CATALOGUE[term].mimics
    return tuple(one.terms for one in mimics if one.exact and one.holds(variant) and one.terms != term)


def without_doubles(terms: Sequence[str]) -> list[str]:
    """Return terms without those that are the same force as another of them, as a constant grade and rolling are."""
    same = {other for one in terms if one in CATALOGUE for other in exact_mimics(one, "")}
    return [one for one in terms if one not in same]


def separable_by_lacking(term: str, variant: str, measured: Container[str]) -> tuple[str, ...]:
    """Return what only channels tell from a term of which one was not measured, by declaration of either."""

    def lacking(mimic: Mimic) -> bool:
        return any(channel not in measured for channel in mimic.without)

    own = [one.terms for one in CATALOGUE[term].mimics if one.holds(variant) and lacking(one)]
    return *own, *(kind.id for kind in CATALOGUE.values() for one in kind.mimics if one.terms == term and lacking(one))


def look_alike(term: str, other: str) -> bool:
    """Return whether one of two terms declares that it looks like the other."""
    return any(one.terms == b for a, b in ((term, other), (other, term)) for one in CATALOGUE[a].mimics)


def separation(term: str, variant: str, alternative: str) -> Separation:
    """Return what would tell a term from an alternative: as declared by either of them, else by their kind."""
    kind = CATALOGUE[term]
    declared = [one for one in kind.mimics if one.holds(variant)]
    for mimic in declared:
        if mimic.exact and _same(mimic, alternative):
            return Separation(alternative, mimic.when, True)
    for mimic in declared:
        if _same(mimic, alternative) and mimic.separated_by:
            return Separation(alternative, mimic.separated_by, False)
    parts = alternative.split("+")
    for part in (one for one in parts if one in CATALOGUE):
        for mimic in CATALOGUE[part].mimics:
            if _same(mimic, term) and mimic.separated_by:
                return Separation(alternative, mimic.separated_by, False)
    for mimic in declared:
        if mimic.separated_by and set(mimic.terms.split("+")) & set(parts):
            return Separation(alternative, mimic.separated_by, False)
    return Separation(alternative, _by_kind(term, parts), False)


def _same(mimic: Mimic, terms: str) -> bool:
    return set(mimic.terms.split("+")) == set(terms.split("+"))


def _by_kind(term: str, others: Sequence[str]) -> str:
    """Return the excitation that brings out what two kinds of terms do differently."""
    kinds = [CATALOGUE[one] for one in (term, *others) if one in CATALOGUE]
    families, late = {kind.family for kind in kinds}, {kind.acts_late() for kind in kinds}

    def one_of_them(family: str) -> bool:
        return family in families and len(families) > 1

    if one_of_them("measurement"):
        return "position and yaw recorded beside the velocities"
    if one_of_them("time"):
        return "the same manoeuvre at the start and at the end of a drive"
    if late == {True}:
        return "steps of steering and of torque, each at two speeds"
    if families == {"place"}:
        return "gentle and hard turns on the same stretch, with and without torque"
    if one_of_them("place"):
        return "the same place at another speed and in the other direction"
    if one_of_them("air"):
        return "the same manoeuvre in the opposite direction"
    if len(late) > 1:
        return "steps of steering and torque, and steady driving between them"
    if one_of_them("along"):
        return "acceleration and braking on a straight, and turns without torque"
    if one_of_them("steering"):
        return "steady turns to both sides, gentle and near the limit, at two speeds"
    return "steady turns up to the limit at two speeds, with and without torque"
