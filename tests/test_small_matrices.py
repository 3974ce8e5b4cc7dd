"""Linear algebra of small matrices by LAPACK's own routines."""

from __future__ import annotations

import numpy as np
import pytest

from magyc_gtsam.factors.chain.small import inverse, inverse_root
from magyc_gtsam.factors.errors import SingularError


def test_an_inverse_root_is_that_of_the_matrix() -> None:
    rows = np.random.default_rng(0).standard_normal((5, 9))
    root = inverse_root(rows @ rows.T)
    assert root is not None
    np.testing.assert_allclose(root.T @ root, inverse(rows @ rows.T))
    assert inverse_root(np.diag([1.0, -1.0])) is None
    with pytest.raises(SingularError):
        inverse(np.zeros((2, 2)))


def test_of_an_empty_matrix_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    """LAPACK prints errors past Python's streams, which would be in the output of a command."""
    root = inverse_root(np.zeros((0, 0)))
    assert root is not None
    assert root.shape == (0, 0)
    assert capfd.readouterr() == ("", "")
