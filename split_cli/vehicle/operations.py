"""Mathematical operations that NumPy and CasADi share, so that both evaluate the same physics.

A term or model takes an `Operations` and uses nothing else beside + - * / ** and unary minus. The CasADi
implementation lives in `export`, the only place besides control that knows CasADi.
"""

from typing import Any, Protocol

import numpy as np


class Operations(Protocol):
    """Elementwise operations on whatever array or symbol the implementation uses."""

    def sin(self, a: Any) -> Any: ...
    def cos(self, a: Any) -> Any: ...
    def atan(self, a: Any) -> Any: ...
    def atan2(self, a: Any, b: Any) -> Any: ...
    def tanh(self, a: Any) -> Any: ...
    def exp(self, a: Any) -> Any: ...
    def sqrt(self, a: Any) -> Any: ...
    def minimum(self, a: Any, b: Any) -> Any: ...
    def maximum(self, a: Any, b: Any) -> Any: ...
    def where(self, condition: Any, a: Any, b: Any) -> Any: ...


class NumpyOperations:
    """`Operations` on NumPy arrays of any broadcastable shapes."""

    sin = staticmethod(np.sin)
    cos = staticmethod(np.cos)
    atan = staticmethod(np.arctan)
    atan2 = staticmethod(np.arctan2)
    tanh = staticmethod(np.tanh)
    exp = staticmethod(np.exp)
    sqrt = staticmethod(np.sqrt)
    minimum = staticmethod(np.minimum)
    maximum = staticmethod(np.maximum)
    where = staticmethod(np.where)


NUMPY = NumpyOperations()
