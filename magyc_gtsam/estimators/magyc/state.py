"""The state of the MAGYC paper, (C, d, b), and its conversion to soft iron, hard iron, bias and a calibration.

C is the inverse soft iron as l = vech(C), d = C · hard iron in gauss, b the gyroscope bias in rad/s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import gtsam
import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.magyc.derivative_windows import GAUSS
from magyc_gtsam.factors.chain.vech import SYMMETRIC_UNITS, unvech, vech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.gyro_derivative import CompressedGyroDerivative
from magyc_gtsam.factors.priors import determinant_prior, norm_prior
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.observability import GYRO_BIAS_LIMIT, HARD_IRON_LIMIT, SOFT_IRON_LIMIT, assess
from magyc_gtsam.recording import Array, Recording

INVERSE_SOFT_IRON, PSEUDO_HARD_IRON, GYRO_BIAS = KEYS = (
    gtsam.symbol("l", 0),
    gtsam.symbol("d", 0),
    gtsam.symbol("b", 0),
)
NAMES = dict(zip(KEYS, ("the soft iron", "the hard iron", "the gyroscope bias"), strict=True))

_MOST_UNEXPLAINED = 0.1  # largest standard deviation of the calibrated field's strength, relative to its mean

Prior = Literal["norm", "determinant"]
_PRIORS = {"norm": norm_prior, "determinant": determinant_prior}


def initial_values() -> gtsam.Values:
    """Return C = I, d = 0, b = 0, which takes both sensors as calibrated (section V)."""
    values = gtsam.Values()
    values.insert(INVERSE_SOFT_IRON, vech(np.eye(3)))
    values.insert(PSEUDO_HARD_IRON, np.zeros(3))
    values.insert(GYRO_BIAS, np.zeros(3))
    return values


def scale_prior(kind: Prior, sigma: float, windows: int = 1) -> gtsam.CustomFactor:
    """Return prior (9) on C, "norm", or the authors' later "determinant", combined for `windows` equal priors.

    Raises:
        MagycError: unknown prior.
    """
    there = ", ".join(_PRIORS)
    if not isinstance(kind, str):
        raise MagycError(
            f"prior: this method's is one of {there}; an earlier calibration is a prior of 'smoother' alone"
        )
    if kind not in _PRIORS:
        raise MagycError(f"prior {shortened(kind)!r} unknown; there are {there}")
    return _PRIORS[kind](INVERSE_SOFT_IRON, sigma / np.sqrt(windows))


@dataclass(frozen=True, eq=False)
class MagycState:
    """One estimate: l (6,), d (3,) gauss, b (3,) rad/s."""

    l: Array  # noqa: E741
    d: Array
    b: Array

    @classmethod
    def of(cls, values: gtsam.Values) -> MagycState:
        """Read the state from a graph's values."""
        return cls(*(values.atVector(key) for key in KEYS))

    @property
    def soft_iron(self) -> Array:
        """(3, 3), of determinant 1; (−C, −d) solves (7) too and gives the same matrix.

        Raises:
            MagycError: C is singular.
        """
        c = unvech(self.l)
        determinant = float(np.linalg.det(c))
        if abs(determinant) < 1e-12 * np.linalg.norm(c) ** 3:
            raise MagycError("the inverse soft iron became singular; the motion does not determine it")
        result: Array = np.linalg.inv(c) * np.cbrt(determinant)
        return result

    @property
    def hard_iron(self) -> Array:
        """(3,) T."""
        return np.asarray(np.linalg.solve(unvech(self.l), self.d) * GAUSS, dtype=np.float64)

    @property
    def parameters(self) -> Array:
        """(12,) vech(soft iron), hard iron T, gyroscope bias rad/s.

        Raises:
            MagycError: C is singular.
        """
        return np.concatenate([vech(self.soft_iron), self.hard_iron, self.b])

    def covariance(self, residuals: CompressedGyroDerivative) -> Array:
        """Return the covariance (12, 12) of vech(A) at det A = 1, h in T and b, as if only residual (7) were noisy."""
        residual, jacobians = residuals.error(self.l, self.d, self.b, want_jacobians=True)
        jacobian = np.hstack(jacobians)
        variance = residual @ residual / max(3 * residuals.samples - 12, 1)
        scale = np.concatenate([self.l, self.d, np.zeros(3)])  # the direction that (7) leaves free is fixed
        scale *= np.linalg.norm(jacobian) / (scale @ scale)
        graph = np.linalg.inv(jacobian.T @ jacobian + np.outer(scale, scale)) * variance

        # dA = A (tr(C⁻¹ dC)/3 − dC C⁻¹) at det A = 1, and dh = C⁻¹ (dd − dC h).
        inverse = np.linalg.inv(unvech(self.l))
        soft_iron, h = inverse / np.cbrt(np.linalg.det(inverse)), inverse @ self.d
        relative = SYMMETRIC_UNITS @ inverse
        trace = np.trace(relative, axis1=1, axis2=2) / 3
        mapping = np.zeros((12, 12))
        mapping[:6, :6] = vech(soft_iron @ (trace[:, None, None] * np.eye(3) - relative)).T
        mapping[6:9, :6] = -GAUSS * inverse @ (SYMMETRIC_UNITS @ h).T
        mapping[6:9, 6:9] = GAUSS * inverse
        mapping[9:, 9:] = np.eye(3)
        covariance: Array = mapping @ graph @ mapping.T
        return covariance


def calibration_of(
    parameters: Array,
    covariance: Array | None,
    recording: Recording,
    *,
    method: str,
    message: str,
    converged: bool,
    field_strength: float | None,
    diagnostics: Mapping[str, Any],
    configuration: Mapping[str, Any],
) -> Calibration:
    """Return the calibration of a MAGYC method.

    The paper gives no covariance, and none is reported: residual (7) has noise in its regressors, so that the
    estimate is biased and the graph's marginals are not its spread. They only show which parameters the motion leaves
    undetermined; such a result does not count as converged.

    Args:
        parameters: (12,) vech(soft iron) at determinant 1, hard iron T, gyroscope bias rad/s.
        covariance: (12, 12) of them, by `MagycState.covariance`; None if there is no minimum.
        recording: the data, which determine the field's strength.
        method, message, diagnostics, configuration: as in `Calibration`.
        converged: whether the optimiser converged.
        field_strength: T, scales the soft iron; None leaves its determinant at 1.
    """
    soft_iron, hard_iron, gyro_bias = unvech(parameters[:6]), parameters[6:9], parameters[9:]
    field = np.linalg.solve(soft_iron, (recording.magnetometer.value - hard_iron).T)
    norm = np.linalg.norm(field, axis=0)
    strength, spread = float(norm.mean()), float(norm.std())
    reasons, observability = [] if converged else [message], None
    if spread > _MOST_UNEXPLAINED * strength:
        reasons.append(
            f"the strength of the calibrated field still varies by {spread / strength:.0%} (at most "
            f"{_MOST_UNEXPLAINED:.0%} is tolerated): compare with method='smoother', which "
            "checks the sensors' axes"
        )
    if np.linalg.eigvalsh(soft_iron)[0] <= 0:
        reasons.append("the soft iron is not positive definite")
    elif covariance is not None:
        observability = assess(covariance, soft_iron, strength, recording, hard_iron)
        if not observability.observable:
            reasons.append(f"not observable: {observability.weak[0].sentence}")
    if field_strength is not None:
        soft_iron, strength = soft_iron * (strength / field_strength), field_strength
    return Calibration(
        soft_iron,
        hard_iron,
        gyro_bias,
        converged=not reasons,
        message="; ".join(reasons) or message,
        method=method,
        field_strength=strength,
        observability=observability,
        diagnostics=diagnostics,
        configuration=configuration,
    )


def limits_about(parameters: Array, field: Array) -> Array:
    """Return the limits (12,) of observability for the parameters, given the field (n, 3) T."""
    strength = float(np.median(np.linalg.norm(field - parameters[6:9], axis=1)))
    return np.repeat([SOFT_IRON_LIMIT, HARD_IRON_LIMIT * strength, GYRO_BIAS_LIMIT], [6, 3, 3])
