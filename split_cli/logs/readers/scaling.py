"""Whole numbers that become quantities by the factors and offsets that stand above them in a table."""

import numpy as np

from split_cli.logs.readers.cells import number_of
from split_cli.logs.readers.dialect import Sniffed


def by_factor(values: np.ndarray, sniffed: Sniffed, index: int) -> np.ndarray | None:
    """Return whole numbers by the factor and the offset that stand above them; None where there is nothing to do.

    A file with parts of ones in any column that has a factor holds quantities already.
    """
    if _is_scaled_already(sniffed):
        return None
    cells = [row[index].strip() if row else "" for row in (sniffed.factors, sniffed.offsets)]
    factor, offset = (number_of(cell, sniffed.dialect.decimal) for cell in cells)
    factor, offset = factor if np.isfinite(factor) else 1.0, offset if np.isfinite(offset) else 0.0
    finite = values[np.isfinite(values)]
    if factor in (0.0, 1.0) or np.any(finite % 1.0 != 0.0):
        return None
    return values * factor + offset


def _is_scaled_already(sniffed: Sniffed) -> bool:
    """Whether the first rows hold parts of ones in a column with a factor."""
    if sniffed.factors is None:
        return sniffed.offsets is None
    decimal = sniffed.dialect.decimal
    scaled = [n for n, cell in enumerate(sniffed.factors) if number_of(cell.strip(), decimal) not in (0.0, 1.0)]
    scaled = [n for n in scaled if np.isfinite(number_of(sniffed.factors[n].strip(), decimal))]
    cells = (number_of(row[n].strip(), decimal) for row in sniffed.rows for n in scaled if n < len(row))
    return any(np.isfinite(value) and value % 1.0 != 0.0 for value in cells)
