"""Named physical terms that may be added to the nominal single track, one file a family.

Every module here is read: a term that its `__all__` lists is in the catalogue, and all that is said of it stands
on its class.

May import: vehicle (single_track, tire, operations, parameters), errors.
"""

import pkgutil
from importlib import import_module

from split_cli.errors import VehicleError, nearest_names
from split_cli.vehicle.effects.recording import Recording
from split_cli.vehicle.effects.term import Mimic, Term
from split_cli.vehicle.parameters import EffectSpec, Vehicle

__all__ = ["CATALOGUE", "Mimic", "Recording", "Term", "build_terms", "find_terms"]


def find_terms(package: str = __name__) -> dict[str, type[Term]]:
    """Return the terms that the modules of a package list, by id, in the modules' order."""
    found = {}
    for one in sorted(pkgutil.iter_modules(import_module(package).__path__), key=lambda one: one.name):
        module = import_module(f"{package}.{one.name}")
        for name in getattr(module, "__all__", ()):
            kind = getattr(module, name)
            if isinstance(kind, type) and issubclass(kind, Term) and kind is not Term:
                found[kind.id] = kind
    return found


CATALOGUE: dict[str, type[Term]] = find_terms()


def build_terms(vehicle: Vehicle) -> tuple[Term, ...]:
    """Return the terms a vehicle file's ``effects`` name.

    Raises
    ------
    VehicleError
        If a term is unknown, or a parameter is unknown, missing, or beyond what the term's `limits` allow.
    """
    terms = []
    for effect in vehicle.effects:
        where = f"vehicle {vehicle.name}, effects"
        if effect.term not in CATALOGUE:
            what = f"unknown term {effect.term!r}"
            raise VehicleError(what, where=where, advice=nearest_names(effect.term, CATALOGUE))
        kind = CATALOGUE[effect.term]
        if effect.variant not in kind.variants:
            advice = nearest_names(effect.variant, kind.variants)
            raise VehicleError(f"{effect.term} has no variant {effect.variant!r}", where=where, advice=advice)
        units = kind.parameter_units(effect.variant)
        unknown = set(effect.parameters) - set(units)
        missing = set(units) - set(effect.parameters)
        if unknown:
            name = sorted(unknown)[0]
            advice = nearest_names(name, units)
            raise VehicleError(f"{effect.term} has no parameter {name!r}", where=where, advice=advice)
        if missing:
            advice = "Add it under `parameters`; docs/catalogue.md tells what each term needs."
            raise VehicleError(f"{effect.term} lacks {', '.join(sorted(missing))}", where=where, advice=advice)
        _refuse_beyond(kind, effect, vehicle, where)
        terms.append(kind(dict(effect.parameters), effect.variant))
    return tuple(terms)


def _refuse_beyond(kind: type[Term], effect: EffectSpec, vehicle: Vehicle, where: str) -> None:
    units, limits = kind.parameter_units(effect.variant), kind.limits(vehicle)
    for name, value in effect.parameters.items():
        low, high = limits[name]
        rounding = 1e-9 * max(abs(low), abs(value))  # of a value that was found at a limit
        if not low - rounding <= value <= high + rounding:
            unit = "" if units[name] == "1" else f" {units[name]}"
            raise VehicleError(
                f"{effect.term}.{name} is {value:g}{unit}, beyond any car's: {low:.3g} to {high:.3g}{unit}",
                where=where,
                advice="Is it in SI units? docs/catalogue.md tells what each parameter means.",
            )
