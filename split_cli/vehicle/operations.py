"""Mathematical operations that NumPy and CasADi share, so that both evaluate the same physics.

A term or model takes an `Operations` and uses nothing else beside + - * / ** and unary minus. The CasADi
implementation lives in `export`, the only place besides control that knows CasADi.
"""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np


class Operations(Protocol):
    """Elementwise operations on whatever array or symbol the implementation uses."""

    def sin(self, a: Any) -> Any: ...
    def cos(self, a: Any) -> Any: ...
    def atan(self, a: Any) -> Any: ...
    def atan2(self, a: Any, b: Any) -> Any: ...
    def sine_of_multiple_of_atan(self, c: Any, a: Any) -> Any: ...
    def tanh(self, a: Any) -> Any: ...
    def exp(self, a: Any) -> Any: ...
    def sqrt(self, a: Any) -> Any: ...
    def minimum(self, a: Any, b: Any) -> Any: ...
    def maximum(self, a: Any, b: Any) -> Any: ...
    def where(self, condition: Any, a: Any, b: Any) -> Any: ...


class NumpyOperations:
    """`Operations` on NumPy arrays of any broadcastable shapes."""

    sin: Callable[[Any], Any] = staticmethod(np.sin)
    cos: Callable[[Any], Any] = staticmethod(np.cos)
    atan = staticmethod(np.arctan)
    atan2: Callable[[Any, Any], Any] = staticmethod(np.arctan2)
    tanh = staticmethod(np.tanh)
    exp = staticmethod(np.exp)
    sqrt = staticmethod(np.sqrt)
    minimum = staticmethod(np.minimum)
    maximum = staticmethod(np.maximum)
    where = staticmethod(np.where)

    @staticmethod
    def sine_of_multiple_of_atan(c: Any, a: Any) -> Any:
        """Return sin(c atan(a))."""
        return np.sin(c * np.arctan(a))


NUMPY = NumpyOperations()
