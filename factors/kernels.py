"""Robust kernels of the Autocal paper, eqs. (9) to (12), for single factors and for stacked samples.

e is the whitened norm of one sample's residual. A kernel replaces its cost e²/2 by ρ(e) and its weight 1
by ρ'(e)/e, which is GTSAM's convention; in the paper's, ρ_paper(s) = 2 ρ(√s) with s = e². Two of the
printed formulas are wrong: (10) is discontinuous at s = τ² unless τ = 1 (the intended tail is 2τ√s − τ²), and (12)
decreases with s (the intended function is τ² − τ⁴/(τ² + s) = τ² s/(τ² + s)).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import is_positive

_SMALL = 1e-9  # lower bound of whitened norms in quotients


@dataclass(frozen=True)
class Kernel:
    """A robust kernel.

    Attributes:
        loss: ρ(e, k) of whitened norms e ≥ 0, elementwise.
        weight: ρ'(e, k)/e, elementwise.
        curvature: ρ''(e, k), elementwise; below 0 where the kernel redescends.
        tuning: k by the residual's dimension (1, 2 or 3) for 95 % efficiency on Gaussian noise. L1 has
            no such k: its efficiency is 64, 79 and 85 %, and k only rounds off the tip at e = 0.
    """

    loss: Callable[[Array, float], Array]
    weight: Callable[[Array, float], Array]
    curvature: Callable[[Array, float], Array]
    tuning: Mapping[int, float]


def _tuning(*constants: float) -> Mapping[int, float]:
    return MappingProxyType(dict(zip((1, 2, 3), constants, strict=True)))


def _huber_loss(e: Array, k: float) -> Array:
    return np.where(e <= k, 0.5 * e**2, k * (e - 0.5 * k))


def _huber_weight(e: Array, k: float) -> Array:
    return k / np.maximum(e, k)


def _huber_curvature(e: Array, k: float) -> Array:
    return np.where(e <= k, 1.0, 0.0)


KERNELS: Mapping[str, Kernel] = MappingProxyType(
    {
        # (9) except for a constant k/2, and e²/2k below k, so that the weight stays finite at e = 0.
        "l1": Kernel(
            lambda e, k: _huber_loss(e, k) / k,
            lambda e, k: _huber_weight(e, k) / k,
            lambda e, k: _huber_curvature(e, k) / k,
            _tuning(1e-3, 1e-3, 1e-3),
        ),
        # (10), with the continuous tail.
        "huber": Kernel(_huber_loss, _huber_weight, _huber_curvature, _tuning(1.345, 1.5011, 1.6280)),
        # (11)
        "cauchy": Kernel(
            lambda e, k: 0.5 * k**2 * np.log1p((e / k) ** 2),
            lambda e, k: 1.0 / (1.0 + (e / k) ** 2),
            lambda e, k: (1.0 - (e / k) ** 2) / (1.0 + (e / k) ** 2) ** 2,
            _tuning(2.3849, 2.5486, 2.6656),
        ),
        # (12), with the increasing form.
        "geman-mcclure": Kernel(
            lambda e, k: 0.5 * (k * e) ** 2 / (k**2 + e**2),
            lambda e, k: (k**2 / (k**2 + e**2)) ** 2,
            lambda e, k: k**4 * (k**2 - 3 * e**2) / (k**2 + e**2) ** 3,
            _tuning(3.7874, 4.0956, 4.3373),
        ),
    }
)


def kernel(name: str) -> Kernel:
    """Return the kernel of that name.

    Raises:
        MagycError: there is none.
    """
    if not isinstance(name, str) or name not in KERNELS:
        raise MagycError(f"robust kernel {name!r:.40} unknown; there are {', '.join(KERNELS)}")
    return KERNELS[name]


def tuning_constant(name: str, dimension: int, tuning: float | None = None) -> float:
    """Return `tuning`, or the kernel's own constant for residuals of this dimension."""
    constants = kernel(name).tuning
    if tuning is None:
        if dimension not in constants:
            raise MagycError(f"kernel {name!r}: give `tuning` for residuals of dimension {dimension}")
        return constants[dimension]
    if not is_positive(tuning):
        raise MagycError(f"kernel {name!r}: tuning constant {tuning}; it must be finite and above 0")
    return float(tuning)


def robustify(
    name: str, residual: Array, jacobians: Sequence[Array] = (), tuning: float | None = None
) -> tuple[Array, list[Array]]:
    """Scale each sample's whitened residual so that half its squared norm is ρ(e), with exact Jacobians.

    r̃ = g r, g = √(2ρ)/e, and J̃ = g J + (w/g − g) r̂ r̂ᵀ J, w the kernel's weight; hence
    ‖r̃‖²/2 = ρ(e) and J̃ᵀ r̃ = w Jᵀ r, the gradient of the robust cost.

    Args:
        name: name of the kernel.
        residual: (n, rows), whitened, one sample per row.
        jacobians: each (n, rows, columns).
        tuning: the kernel's constant; default 95 % efficiency for `rows` rows.

    Returns:
        Residual and Jacobians of the same shapes.
    """
    k = tuning_constant(name, residual.shape[1], tuning)
    e = np.maximum(np.sqrt(np.einsum("ni,ni->n", residual, residual)), _SMALL)
    scale = np.sqrt(2.0 * KERNELS[name].loss(e, k)) / e
    radial = KERNELS[name].weight(e, k) / scale - scale
    unit = residual / e[:, None]
    projector = scale[:, None, None] * np.eye(residual.shape[1])
    projector += radial[:, None, None] * unit[:, :, None] * unit[:, None, :]
    return scale[:, None] * residual, [projector @ jacobian for jacobian in jacobians]


def narrowed(misfits: Sequence[float]) -> float:
    """Return the factor of a kernel's tuning constant while a graph settles: wide first (graduated non-convexity).

    With a calibration that is far off, every sample looks like an outlier. The typical misfit is then far above 1 and
    widens the kernel by the same factor, which amounts to least squares. As the estimate settles the factor falls to
    1, unless more than half of the blocks are outliers.

    Args:
        misfits: median whitened norm of each recent block's samples, 1 where the model fits; NaN is ignored.
    """
    known = np.asarray(misfits, dtype=float)
    known = known[np.isfinite(known)]
    return float(np.clip(np.median(known), 1.0, 1e4)) if len(known) else 1.0
