"""What altered numbers change, without a run for each: a run parts where a number turns something.

Each number is handed in as a `Probe`, which holds its value and its altered values. As long as every comparison
comes out alike for all of them, one run stands for all. Where one comes out differently, or where the value leaves
the probe (an array is multiplied by it, a function of C takes it), the process forks. The child goes on with the
altered number alone and says what came of it: what a run with that number from the start would say.
"""

from __future__ import annotations

import math
import operator
import os
import pickle
import tempfile
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

_Key = tuple[str, float]


class _Run:
    """One run of a procedure: which alterations ride along, and which one this process has taken."""

    def __init__(self, wanted: set[_Key], save: Callable[[_Key, int], None] | None) -> None:
        self.riding, self.taken, self.save = set(wanted), None, save
        self.turned: set[_Key] = set()

    def part(self, name: str, factor: float) -> bool:
        """Fork for an alteration that makes a difference; True in the child, where it is what happens."""
        if self.taken is not None or (name, factor) not in self.riding:
            return False
        self.riding.discard((name, factor))
        self.turned.add((name, factor))
        if self.save is None:
            return False
        child = os.fork()
        if child == 0:
            self.taken = (name, factor)
            return True
        self.save((name, factor), os.waitpid(child, 0)[1])
        return False


class Probe:
    """A number that stands for its altered values, too.

    Parameters
    ----------
    run : _Run
    name : str
    values : mapping from factor to number
        1.0 is the number as it is.
    """

    __slots__ = ("_name", "_run", "_values")
    __hash__ = None

    def __init__(self, run: _Run, name: str, values: Mapping[float, Any]) -> None:
        self._run, self._name, self._values = run, name, dict(values)

    def _settle(self, results: Mapping[float, Any]) -> Any:
        """Return the one result, after children have left for each alteration whose result is another one."""
        for factor, other in results.items():
            if factor != 1.0 and not _alike(other, results[1.0]) and self._run.part(self._name, factor):
                return other
        return self._now(results)

    def _now(self, results: Mapping[float, Any]) -> Any:
        taken = self._run.taken
        return results[taken[1]] if taken and taken[0] == self._name else results[1.0]

    def _apply(self, function: Callable[..., Any], *others: Any, flipped: bool = False) -> Any:
        plain = [other.value() if isinstance(other, Probe) else other for other in others]
        order = (lambda one: [*plain, one]) if flipped else (lambda one: [one, *plain])
        return {factor: function(*order(one)) for factor, one in self._values.items()}

    def _derived(self, function: Callable[..., Any], *others: Any, flipped: bool = False) -> Any:
        results = self._apply(function, *others, flipped=flipped)
        if all(isinstance(one, int | float) for one in results.values()):
            return Probe(self._run, self._name, results)
        return self._settle(results)

    def value(self) -> Any:
        """Return the plain number, once children have left for what it might be instead."""
        return self._settle(self._values)

    def __float__(self) -> float:
        return float(self.value())

    def __index__(self) -> int:
        return operator.index(self.value())

    def __int__(self) -> int:
        return self._settle(self._apply(int))

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return np.asarray(self.value(), dtype=dtype)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        mine = next(k for k, one in enumerate(inputs) if one is self)
        rest = [one.value() if isinstance(one, Probe) and one is not self else one for one in inputs]
        call = getattr(ufunc, method)
        results = {f: call(*rest[:mine], one, *rest[mine + 1 :], **options) for f, one in self._values.items()}
        if all(isinstance(one, float) for one in results.values()):
            return Probe(self._run, self._name, {f: float(one) for f, one in results.items()})
        return self._settle(results)

    def __bool__(self) -> bool:
        return self._settle(self._apply(bool))

    def __format__(self, how: str) -> str:
        return format(self._now(self._values), how)

    def __repr__(self) -> str:
        return repr(self._now(self._values))

    def __copy__(self) -> Probe:
        return self

    def __deepcopy__(self, memo: Any) -> Probe:
        return self

    def __reduce__(self) -> Any:
        return type(self.value()), (self.value(),)


def _comparing(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda self, other: self._settle(self._apply(function, other))


def _computing(function: Callable[..., Any], flipped: bool = False) -> Callable[..., Any]:
    return lambda self, *others: self._derived(function, *others, flipped=flipped)


for _name in ("lt", "le", "gt", "ge", "eq", "ne"):
    setattr(Probe, f"__{_name}__", _comparing(getattr(operator, _name)))
for _name in ("add", "sub", "mul", "truediv", "floordiv", "mod", "pow"):
    setattr(Probe, f"__{_name}__", _computing(getattr(operator, _name)))
    setattr(Probe, f"__r{_name}__", _computing(getattr(operator, _name), flipped=True))
for _name, _function in (("neg", operator.neg), ("pos", operator.pos), ("abs", abs), ("round", round)):
    setattr(Probe, f"__{_name}__", _computing(_function))
for _name in ("floor", "ceil", "trunc"):
    setattr(Probe, f"__{_name}__", _computing(getattr(math, _name)))


def turned(
    procedure: Callable[[dict[str, Any]], Any], numbers: Mapping[str, Mapping[float, Any]]
) -> tuple[Any, set[_Key]]:
    """Run a procedure once; return its outcome and the alterations that would have changed something on the way.

    Any other alteration changes nothing. Arguments are those of `outcomes`.
    """
    wanted = {(name, factor) for name, values in numbers.items() for factor in values if factor != 1.0}
    run = _Run(wanted, None)
    return procedure({name: Probe(run, name, values) for name, values in numbers.items()}), run.turned


def _alike(a: Any, b: Any) -> bool:
    return np.array_equal(a, b) if isinstance(a, np.ndarray) or isinstance(b, np.ndarray) else bool(a == b)


def outcomes(
    procedure: Callable[[dict[str, Any]], Any],
    numbers: Mapping[str, Mapping[float, Any]],
    told: Callable[[str, float, Any], None] = lambda name, factor, outcome: None,
) -> tuple[Any, dict[_Key, Any]]:
    """Run a procedure as it is, and for each alteration that comes to make a difference.

    Parameters
    ----------
    procedure : callable
        Takes the numbers by name; what it returns can be pickled. Threads of its own must be off.
    numbers : mapping from name to a mapping from factor to value
        Factor 1.0 is the number as it is; the others are the alterations that are asked for.
    told : callable
        Called with name, factor and outcome as soon as an alteration has come to its end.

    Returns
    -------
    outcome : object
        As the numbers are.
    altered : dict from (name, factor) to object
        Of the alterations that made a difference somewhere; of the others the outcome is the same.

    Raises
    ------
    RuntimeError
        Where an altered run ended without an outcome.
    """
    found: dict[_Key, Any] = {}
    wanted = {(name, factor) for name, values in numbers.items() for factor in values if factor != 1.0}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "outcome"

        def save(key: _Key, status: int) -> None:
            if status or not path.exists():
                raise RuntimeError(f"the run with {key[0]} times {key[1]:g} ended without an outcome")
            found[key] = pickle.loads(path.read_bytes())
            path.unlink()
            told(*key, found[key])

        run = _Run(wanted, save)
        try:
            outcome = procedure({name: Probe(run, name, values) for name, values in numbers.items()})
            if run.taken is not None:
                path.write_bytes(pickle.dumps(outcome))
                os._exit(0)
        except BaseException:
            if run.taken is not None:
                traceback.print_exc()
                os._exit(1)
            raise
    return outcome, found
