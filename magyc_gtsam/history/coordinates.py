"""Coordinates s (5,) of the soft iron: the traceless part of its matrix logarithm.

S = exp(Σ s_i E_i) has determinant 1 for every s. The scale, which a log can determine only if the field strength is
known, is thus separate, and the covariance of s is regular where that of vech(S) is not.
"""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.vech import SYMMETRIC_UNITS, vech
from magyc_gtsam.recording import Array

SHAPE = 5


def _basis() -> Array:
    """Return (5, 3, 3) orthonormal symmetric matrices of trace zero."""
    root = np.sqrt(0.5)
    basis = np.zeros((SHAPE, 3, 3))
    basis[0] = np.diag([root, -root, 0.0])
    basis[1] = np.diag([1.0, 1.0, -2.0]) / np.sqrt(6)
    for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2)), start=2):
        basis[k, i, j] = basis[k, j, i] = root
    return basis


BASIS = _basis()


def shape_of(soft_iron: Array) -> tuple[Array, float]:
    """Return s (5,) and the logarithm of the scale ∛det S of a positive definite S (3, 3)."""
    value, vector = np.linalg.eigh(soft_iron)
    logarithm = (vector * np.log(value)) @ vector.T
    return np.einsum("kij,ij->k", BASIS, logarithm), float(np.trace(logarithm) / 3)


def soft_iron_of(shape: Array, log_scale: float = 0.0) -> Array:
    """Return S (3, 3) of s (5,), the inverse of `shape_of`."""
    value, vector = np.linalg.eigh(np.einsum("k,kij->ij", shape, BASIS))
    result: Array = (vector * np.exp(value + log_scale)) @ vector.T
    return result


def shape_slope(soft_iron: Array) -> Array:
    """Return the derivative (5, 6) of s by vech(S): d log S = V (Γ ∘ Vᵀ dS V) Vᵀ, Γ the divided differences of log."""
    value, vector = np.linalg.eigh(soft_iron)
    slopes = np.einsum("ai,kab,bj->kij", vector, SYMMETRIC_UNITS, vector) * _divided(value)
    turned = np.einsum("ai,kab,bj->kij", vector, BASIS, vector)
    result: Array = np.einsum("lij,kij->lk", turned, slopes)
    return result


def soft_iron_slope(shape: Array, log_scale: float = 0.0) -> Array:
    """Return the derivative (6, 5) of vech(S) by s at constant scale."""
    soft_iron = soft_iron_of(shape, log_scale)
    value, vector = np.linalg.eigh(soft_iron)
    turned = np.einsum("ai,kab,bj->kij", vector, BASIS, vector) / _divided(value)
    back = np.einsum("ai,kij,bj->kab", vector, turned, vector)
    result: Array = vech(back).T
    return result


def _divided(value: Array) -> Array:
    """Return the divided differences (3, 3) of the logarithm at eigenvalues (3,)."""
    difference = value[:, None] - value
    same = np.abs(difference) < 1e-9 * value
    log = np.log(value)
    result: Array = np.where(same, 1 / value[:, None], (log[:, None] - log) / np.where(same, 1.0, difference))
    return result
