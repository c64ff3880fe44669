"""Damping of few columns against the matrix written out."""

import numpy as np
import pytest

from split_cli.diagnosis.innovations.projection import damped


@pytest.mark.parametrize("columns", [(), (1,), (3,), (8,), (9,)])
def test_damping_is_the_matrix_written_out(columns):
    rng = np.random.default_rng(3)
    basis, _ = np.linalg.qr(rng.standard_normal((200, 17)))
    root = rng.uniform(0.0, 1.0, 17)
    rows = rng.standard_normal((200, *columns))
    expected = (np.eye(200) - basis @ np.diag(root) @ basis.T) @ rows
    found = damped(rows, basis, root)
    assert found.shape == rows.shape
    # An identity: the two differ by rounding.
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-13)


def test_columns_that_are_no_block_of_memory_are_damped_alike():
    rng = np.random.default_rng(4)
    basis, _ = np.linalg.qr(rng.standard_normal((50, 5)))
    rows = rng.standard_normal((6, 50)).T[:, ::2]
    np.testing.assert_allclose(damped(rows, basis, np.ones(5)), rows - basis @ (basis.T @ rows), rtol=0.0, atol=1e-13)
