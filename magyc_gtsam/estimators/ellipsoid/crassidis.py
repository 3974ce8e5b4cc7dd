"""`crassidis`: Crassidis, Lai and Harman, "Real-time attitude-independent three-axis magnetometer calibration", 2005.

An extended Kalman filter on the model of TWOSTEP: `CrassidisFilter` for onboard use, and a pass over a whole recording.
Equation numbers are those of section 4 of the review (Papafotis, Nikitas, Sotiriadis, Sensors 2021, 21, 5288).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.estimators.ellipsoid.entry_point import entry_point
from magyc_gtsam.estimators.ellipsoid.magnetometer_only import Ellipsoid, check_positive
from magyc_gtsam.estimators.ellipsoid.twostep import ORDER, UNITS
from magyc_gtsam.factors.chain.vech import vech
from magyc_gtsam.recording import Array

# Share of the field strength, four times the review's nominal value (80). A filter that is overconfident at its start
# does not recover, whereas an underconfident one loses little.
NOISE = 0.02
OFFSET_SIGMA, SHAPE_SIGMA = 0.1, 0.15  # sigmas of the start h = 0, D = 0, in field strengths and relative
_REPORTS = 50  # calls of progress over a recording


class CrassidisFilter:
    """The extended Kalman filter for y = T m + h, ‖m‖ = 1, updated sample by sample.

    >>> filter = CrassidisFilter()
    >>> for sample in ((1.1, 0.0, 0.1), (0.1, 0.9, 0.0), (0.0, 0.1, 1.0)):
    ...     filter.update(sample)
    >>> filter.matrix.shape, filter.offset.shape
    ((3, 3), (3,))

    Attributes:
        theta: (9,) b and D11, D22, D33, D12, D13, D23 (16); b is the bias before the soft iron, y = T (m + b).
        covariance: (9, 9) of theta.
    """

    def __init__(
        self,
        noise: float = NOISE,
        *,
        offset_sigma: float = OFFSET_SIGMA,
        shape_sigma: float = SHAPE_SIGMA,
    ) -> None:
        """Initialise the filter without distortion.

        Args:
            noise: σ of a sample, in field strengths, like the samples.
            offset_sigma, shape_sigma: standard deviations of the initial b and D.
        """
        check_positive(noise=noise, offset_sigma=offset_sigma, shape_sigma=shape_sigma)
        self.theta = np.zeros(9)
        self.covariance = np.diag(np.repeat([offset_sigma**2, shape_sigma**2], [3, 6]))
        self._mean = -3 * noise**2  # (5a)
        # (5b): (I + D) y − b is the field, of length 1 apart from noise
        self._variance = 4 * noise**2 + 6 * noise**4

    def update(self, sample: ArrayLike) -> None:
        """Process one sample y (3,), in field strengths."""
        y = np.asarray(sample, dtype=np.float64)
        b, D = self.theta[:3], self.theta[3:][ORDER]
        m = y + D @ y - b
        slope = np.hstack([-np.eye(3), (UNITS @ y).T])  # ∂m/∂θ; m is linear in θ
        H = -2 * m @ slope  # (19); the same as −S F + 2 J of (20), (21)
        # z − φ(θ) of (4) and (17) is ‖m‖² − 1.
        innovation = m @ m - 1 - self._mean
        PH = self.covariance @ H
        gain = PH / (H @ PH + self._variance)  # (18c)
        self.theta = self.theta + gain * innovation  # (18a)
        self.covariance = self.covariance - np.outer(gain, PH)  # (18b)

    @property
    def matrix(self) -> Array:
        """(3, 3) T = (I + D)⁻¹, (22)."""
        return np.linalg.inv(np.eye(3) + self.theta[3:][ORDER])

    @property
    def offset(self) -> Array:
        """(3,) h of y = T m + h, unlike (22), which gives b of the filter's model y = T (m + b)."""
        return self.matrix @ self.theta[:3]

    @property
    def calibration_covariance(self) -> Array:
        """(9, 9) covariance of vech(T) and h."""
        T, b = self.matrix, self.theta[:3]
        dT = -T @ UNITS @ T
        jacobian = np.zeros((9, 9))
        jacobian[:6, 3:] = vech(dT).T
        jacobian[6:, :3] = T
        jacobian[6:, 3:] = (dT @ b).T
        covariance: Array = jacobian @ self.covariance @ jacobian.T
        return covariance


def crassidis(
    y: Array,
    *,
    noise: float | None = None,
    offset_sigma: float = OFFSET_SIGMA,
    shape_sigma: float = SHAPE_SIGMA,
    progress: Callable[[float], None] | None = None,
) -> Ellipsoid:
    """Fit the ellipsoid to samples (n, 3) without units by one pass of the filter, in order of time.

    Args:
        y: samples (n, 3).
        noise: σ of a sample; None takes NOISE, and scales the covariance by the residuals.
        offset_sigma, shape_sigma: standard deviations of the start, relative to the field.
        progress: called with the share done.
    """
    filter_ = CrassidisFilter(
        NOISE if noise is None else noise, offset_sigma=offset_sigma, shape_sigma=shape_sigma
    )
    every = -(-len(y) // _REPORTS)
    for index, sample in enumerate(y):
        filter_.update(sample)
        if progress and index % every == 0:
            progress(index / len(y))
    T, h = filter_.matrix, filter_.offset
    covariance = filter_.calibration_covariance
    if noise is None:
        residual = np.linalg.norm(np.linalg.solve(T, (y - h).T), axis=0) - 1
        covariance *= float(np.mean(residual**2)) / NOISE**2
    return Ellipsoid(T, h, message=f"filtered {len(y)} samples", covariance=covariance)


calibrate_crassidis = entry_point("crassidis", crassidis)
