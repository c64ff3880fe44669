"""`Operations` along a whole recording, and the balance of forces there, by compiled loops.

They are for what evaluates one recording many times. They differ from NumPy's by some units of the last digit, so
that what has to be the same to the bit for one sample and for many takes NumPy's.
"""

from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from split_cli.vehicle.flow import Flow
from split_cli.vehicle.operations import NumpyOperations

_QUARTER_TURN = 0.5 * np.pi


class CompiledOperations(NumpyOperations):
    """`Operations` on contiguous arrays of shape (N,); on anything else as NumPy has them."""

    @staticmethod
    def sin(a: Any) -> Any:
        """Return sin(a)."""
        return _loops().sine(a) if is_along(a) and _is_within_quarter_turn(a) else np.sin(a)

    @staticmethod
    def cos(a: Any) -> Any:
        """Return cos(a)."""
        return _loops().cosine(a) if is_along(a) and _is_within_quarter_turn(a) else np.cos(a)

    @staticmethod
    def atan2(a: Any, b: Any) -> Any:
        """Return the angle of (b, a)."""
        if is_along(a) and is_along(b) and a.size == b.size and b.min() > 0.0:
            return _loops().atan_of_ratio(a, b)
        return np.arctan2(a, b)

    @staticmethod
    def sine_of_multiple_of_atan(c: Any, a: Any) -> Any:
        """Return sin(c atan(a))."""
        if isinstance(c, float) and 0.0 <= c <= 2.0 and is_along(a):
            return _loops().sine_of_multiple_of_atan(c, a)
        return np.sin(c * np.arctan(a))

    @staticmethod
    def balance(f: Flow) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Return (v_x', v_y', r') of an evaluated flow, shape (N,) each; None where the plain form is needed."""
        body = (f.mass, f.rotating_mass, f.yaw_inertia, f.l_f, f.l_r)
        if not is_along(f.sine) or not all(map(np.isscalar, body)):
            return None
        front, rear = f.front, f.rear
        axles = (front.longitudinal_force, front.lateral_force, rear.longitudinal_force, rear.lateral_force)
        varying = []
        for value in (*axles, f.force_x, f.force_y, f.moment, f.sine, f.cosine, f.vx, f.vy, f.r):
            whole = np.full(f.sine.size, value) if np.isscalar(value) else value
            if not is_along(whole) or whole.size != f.sine.size:
                return None
            varying.append(whole)
        dvx, dvy, dr = _loops().balance(*varying, *map(float, body))
        return dvx, dvy, dr


def with_change(total: Any, weight: float, after: Any, before: Any) -> Any:
    """Return a sum with a weight times what an array has become beyond what it was; the sum may be altered."""
    if not (is_along(after) and is_along(before) and after.size == before.size):
        return total + weight * (after - before)
    total = total if is_along(total) else np.full(after.size, total)
    _loops().add_change(total, float(weight), after, before)
    return total


@cache
def _loops() -> ModuleType:
    """Return the compiled loops, loaded on first use: most commands need none."""
    from split_cli.vehicle import _single_track_numba

    return _single_track_numba


def is_along(values: Any) -> bool:
    """Return whether values lie as the compiled loops take them."""
    return (
        isinstance(values, np.ndarray)
        and values.ndim == 1
        and values.size > 0
        and values.dtype == np.float64
        and values.flags.c_contiguous
    )


def _is_within_quarter_turn(angles: np.ndarray) -> bool:
    return bool(angles.min() >= -_QUARTER_TURN and angles.max() <= _QUARTER_TURN)


COMPILED = CompiledOperations()
