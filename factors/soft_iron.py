"""Priors that keep the inverse soft iron, l = vech(C), away from C = 0."""

from __future__ import annotations

import gtsam
import numpy as np

from magyc_gtsam.factors.chain.vech import SYMMETRIC_UNITS, unvech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import Noise, Residual, custom_factor
from magyc_gtsam.factors.variables import Array, vector


def norm_error(l: Array, want_jacobians: bool = False) -> Residual:  # noqa: E741
    """Return ‖l‖ − 1 (1,) and its Jacobian lᵀ/‖l‖ (1, 6), eqs. (9) and (10) of the MAGYC paper."""
    norm = float(np.sqrt(l @ l))
    if norm == 0:
        raise MagycError("norm prior: it has no derivative at l = 0; start from another soft iron")
    return np.array([norm - 1.0]), [l[None, :] / norm] if want_jacobians else []


def determinant_error(l: Array, want_jacobians: bool = False) -> Residual:  # noqa: E741
    """Return det C − 1 (1,) and its Jacobian (1, 6): the cofactors, those off the diagonal doubled."""
    c = unvech(l)
    cofactors = np.cross(c[[1, 2, 0]], c[[2, 0, 1]])
    residual = np.array([c[0] @ cofactors[0] - 1.0])
    return residual, [np.tensordot(SYMMETRIC_UNITS, cofactors)[None, :]] if want_jacobians else []


def norm_prior(soft_iron_key: int, noise: Noise) -> gtsam.CustomFactor:
    """Return the factor ‖l‖ = 1 on a 6-vector, eq. (9); without it C = 0, d = 0 solves residual (7)."""
    return custom_factor("norm prior", noise, [soft_iron_key], [vector(6)], 1, norm_error)


def determinant_prior(soft_iron_key: int, noise: Noise) -> gtsam.CustomFactor:
    """Return the factor det C = 1 on a 6-vector, the scale fixed by the authors' later package."""
    return custom_factor("determinant prior", noise, [soft_iron_key], [vector(6)], 1, determinant_error)
