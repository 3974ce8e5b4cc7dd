"""The evidence of innovations as a function of the amplitudes of columns: against the explicit density."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from magyc_gtsam.gap.model.amplitudes import EvidenceOfAmplitudes

RANDOM = np.random.default_rng(5)
ROWS = 40
COLUMNS, INNOVATION = RANDOM.standard_normal((6, ROWS)), 3 * RANDOM.standard_normal((1, ROWS))
EVIDENCE = EvidenceOfAmplitudes.of(np.zeros((0, ROWS)), INNOVATION, COLUMNS, COLUMNS @ COLUMNS.T)
DEVIATIONS = np.array([0.5, 2.0, 0.0, 1.0, 0.1, 3.0])


def test_it_is_the_density_of_noise_and_columns() -> None:
    log, noise = EVIDENCE.log(DEVIATIONS)
    covariance = noise**2 * (np.eye(ROWS) + (COLUMNS.T * DEVIATIONS**2) @ COLUMNS)
    density = multivariate_normal.logpdf(INNOVATION[0], cov=covariance) + 0.5 * ROWS * np.log(2 * np.pi)
    assert noise > 1
    assert log == pytest.approx(density)


@pytest.mark.parametrize("given", [slice(0, 2), slice(2, 3), slice(1, 4), slice(4, None)])
def test_columns_with_given_amplitudes_are_marginalised_once(given: slice) -> None:
    others = np.delete(np.arange(6), given)
    found = EVIDENCE.given(given, DEVIATIONS[given]).log(DEVIATIONS[others])
    assert found == pytest.approx(EVIDENCE.log(DEVIATIONS))


def test_what_the_model_contains_counts_for_nothing() -> None:
    base = np.linalg.qr(RANDOM.standard_normal((ROWS, 2)))[0].T
    beside = EvidenceOfAmplitudes.of(base, INNOVATION, COLUMNS, COLUMNS @ COLUMNS.T)
    rows, moved = (
        COLUMNS + RANDOM.standard_normal((6, 2)) @ base,
        INNOVATION + RANDOM.standard_normal((1, 2)) @ base,
    )
    assert EvidenceOfAmplitudes.of(base, moved, rows, rows @ rows.T).log(DEVIATIONS) == pytest.approx(
        beside.log(DEVIATIONS)
    )
