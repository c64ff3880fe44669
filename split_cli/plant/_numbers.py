"""Conversion of parameter dataclasses into namedtuples of float64 for compiled code."""

from collections import namedtuple
from dataclasses import fields, is_dataclass
from functools import lru_cache

_CLASSES: dict[type, type] = {}


@lru_cache(maxsize=64)
def as_numbers(parameters):
    """Return the numeric fields of a (nested) parameter dataclass as a namedtuple; ``name`` is left out.

    A closed loop asks for the same car every 10 ms, and taking a car apart costs as much as moving it.
    """
    cls = _number_class(type(parameters))
    values = [getattr(parameters, name) for name in cls._fields]
    return cls(*(as_numbers(value) if is_dataclass(value) else float(value) for value in values))


def _number_class(source: type) -> type:
    # One class a dataclass: compiled code is specialised on the class, a new one would be compiled again.
    if source not in _CLASSES:
        created = namedtuple(f"{source.__name__}Numbers", [f.name for f in fields(source) if f.name != "name"])
        created.__module__ = __name__
        globals()[created.__name__] = created  # numba's cache finds a class by its import path
        _CLASSES[source] = created
    return _CLASSES[source]
