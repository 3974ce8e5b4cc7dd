"""Common parts of the magnetometer-only methods: normalisation of samples, and conversion to a `Calibration`.

Each method fits the ellipsoid y = K m + h, ‖m‖ = 1, to samples without units. This module removes the rotation of K,
which no magnetometer can observe, and adds the scale, the covariance and the assessment. A method has the form

    samples = normalised_field(recording)
    with fitting("twostep"):
        ellipsoid = Ellipsoid(matrix, offset, converged, message)  # fitted to samples.value
    return to_calibration(recording, samples, ellipsoid, method="twostep", field_strength=field_strength)
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.closest_point import closest_points
from magyc_gtsam.estimators.gauge import fix_scale
from magyc_gtsam.factors.chain.vech import SYMMETRIC_UNITS
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import is_positive
from magyc_gtsam.observability import HARD_IRON_LIMIT, assess
from magyc_gtsam.recording import Array, Recording

UNKNOWNS = 9  # six of the ellipsoid's shape, three of its centre
REMEDY = "turn the sensor about more axes, leave disturbed stretches out (start=, end=), or choose another method"
_FLATTEST = 1e-3  # ratio of thickness to width of the samples below which they lie in a plane
_SINGULAR = 1e-12  # ratio of smallest to largest eigenvalue of the scaled information matrix
_MOST_STRETCHED = 3.0  # largest ratio of longest to shortest axis of the ellipsoid
_MOST_UNEXPLAINED = 0.1  # largest share of the field strength left unexplained


class Normalised(NamedTuple):
    """Samples without units: field in T = centre + unit · value, value (n, 3) of about unit length."""

    value: Array
    centre: Array
    unit: float


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """The ellipsoid y = matrix · m + offset, ‖m‖ = 1, that a method fitted to `Normalised.value`.

    Attributes:
        matrix: (3, 3) K, up to a rotation of m.
        offset: (3,) h.
        converged: whether the method's stopping rule was met.
        message: why it stopped.
        covariance: (9, 9) of vech(√(K Kᵀ)) and h, if the method has its own; None lets `to_calibration` compute that
            of the weighted least squares.
        weights: (n,) in [0, 1], the method's robust weight of each sample; None for 1.
        radial: whether the residual of the method is ‖m‖ − 1, as in most, or the distance of y from the ellipsoid.
        diagnostics: values of the method, JSON types only.
    """

    matrix: Array
    offset: Array
    converged: bool = True
    message: str = ""
    covariance: Array | None = None
    weights: Array | None = None
    radial: bool = True
    diagnostics: Mapping[str, Any] = field(default_factory=dict)


def normalised_field(recording: Recording) -> Normalised:
    """Return the magnetometer's own samples, centred and scaled.

    The review scales its data too (section 10.1.1: "trivial, and common"). y = K m + h holds about any origin, and
    starts such as m = y / ‖y‖ need one inside the ellipsoid. The centre is the midpoint of the central 98 % of each
    axis, which neither time at rest nor single spikes affect much.

    Raises:
        MagycError: too few samples, or all of them in a plane, on a line or at a point.
    """
    samples = recording.magnetometer.value
    if len(samples) <= UNKNOWNS:
        raise MagycError(
            f"magnetic_field: {len(samples)} samples, more than {UNKNOWNS} are needed for as many parameters"
        )
    centre = np.quantile(samples, [0.01, 0.99], axis=0).mean(axis=0)
    extent = np.linalg.svd(samples - samples.mean(axis=0), compute_uv=False) / np.sqrt(len(samples))
    flat = extent < _FLATTEST * max(float(extent[0]), _FLATTEST * float(np.abs(samples).max()))
    if flat.any():
        shape = ("at a point", "on a line", "in a plane")[int(np.argmax(flat))]
        shown, name = recording.field_shown
        thickness = ", ".join(f"{e * shown:.3g}" for e in extent)
        raise MagycError(
            f"magnetic_field: all samples lie {shape} (deviations {thickness} {name} along their own axes, the least "
            f"must exceed {_FLATTEST:g} of the largest): turn the sensor about more axes"
        )
    unit = float(np.median(np.linalg.norm(samples - centre, axis=1)))
    return Normalised((samples - centre) / unit, centre, unit)


@contextmanager
def fitting(method: str) -> Iterator[None]:
    """Convert arithmetic failures of a method (division by zero, overflow, a singular matrix) to a MagycError."""
    try:
        with np.errstate(divide="raise", over="raise", invalid="raise"):
            yield
    except (np.linalg.LinAlgError, FloatingPointError) as error:
        raise MagycError(f"method {method!r} failed: {error}; {REMEDY}") from None


def ended(converged: bool, iterations: int) -> str:
    """Return the message of a method that iterates."""
    return f"{'converged' if converged else 'no convergence'} in {iterations} iterations"


def check_positive(**options: float) -> None:
    """Check that options are numbers above zero.

    Raises:
        MagycError: one is not.
    """
    for name, value in options.items():
        if not is_positive(value):
            raise MagycError(f"{name}: must be a number above 0, got {value!r}")


def symmetric_root(matrix: Array) -> Array:
    """Return A = √(K Kᵀ), symmetric positive definite: K without the rotation or reflection on its right."""
    left, stretch, _ = np.linalg.svd(matrix)
    root: Array = (left * stretch) @ left.T
    return root


def to_calibration(
    recording: Recording,
    samples: Normalised,
    ellipsoid: Ellipsoid,
    *,
    method: str,
    field_strength: float | None = None,
    configuration: Mapping[str, Any] | None = None,
) -> Calibration:
    """Return the calibration of an ellipsoid, in tesla, with covariance (9, 9) and assessment.

    Args:
        recording, samples: the data, and the result of `normalised_field`.
        ellipsoid: the method's fit to `samples.value`.
        method: its name in `magyc_gtsam.methods()`.
        field_strength: T; None gives the soft iron determinant 1.
        configuration: the options of the method.

    Returns:
        The calibration; converged is False, with the reasons in `message`, if the method did not converge, the
        directions do not determine the ellipsoid, it does not fit, or noise biases the method.

    Raises:
        MagycError: the fit is not an ellipsoid (infinite, not a number, or flat).
    """
    matrix, offset = np.asarray(ellipsoid.matrix), np.asarray(ellipsoid.offset)
    if not np.isfinite(matrix).all() or not np.isfinite(offset).all() or _flat(matrix):
        reason = "the ellipsoid is flat or infinite" + ("" if ellipsoid.converged else f", {ellipsoid.message}")
        raise MagycError(f"method {method!r} failed: {reason}; {REMEDY}")
    root = symmetric_root(matrix)
    sigma, covariance, bias = _assessed(samples.value, root, offset, ellipsoid)
    if ellipsoid.covariance is not None:
        covariance = ellipsoid.covariance
    if covariance is not None and ellipsoid.weights is None:
        covariance = covariance + np.outer(bias, bias)
    known = np.zeros((UNKNOWNS, UNKNOWNS)) if covariance is None else covariance
    soft_iron, strength, reported = fix_scale(root * samples.unit, known * samples.unit**2, field_strength)
    hard_iron = samples.centre + samples.unit * offset
    observability = None
    if covariance is not None:
        observability = assess(reported, soft_iron, strength, recording, hard_iron)
    reasons = [] if ellipsoid.converged else [ellipsoid.message or "no convergence"]
    if observability is None:
        reasons.append(
            "the directions of the field leave the ellipsoid undetermined: turn the sensor about more axes"
        )
    elif not observability.observable:
        reasons.append(f"not observable: {observability.weak[0].sentence}")
    reasons += _misfits(recording, samples.unit, root, sigma, float(np.linalg.norm(bias[6:])))
    return Calibration(
        soft_iron=soft_iron,
        hard_iron=hard_iron,
        covariance=None if covariance is None else reported,
        converged=not reasons,
        message="; ".join(reasons) or ellipsoid.message or "converged",
        method=method,
        noise={"magnetic_field": sigma * samples.unit},
        field_strength=strength,
        observability=observability,
        diagnostics={"samples": len(samples.value)} | dict(ellipsoid.diagnostics),
        configuration=dict(configuration or {})
        | ({} if field_strength is None else {"field_strength": field_strength})
        | ({"magnetic_field_unit": "counts"} if recording.magnetic_field_unit == "counts" else {}),
    )


def _misfits(recording: Recording, unit: float, root: Array, sigma: float, off: float) -> list[str]:
    """Return the reasons not to trust an ellipsoid.

    Args:
        recording: determines the unit of the messages.
        unit: T per unit of the other arguments.
        root: (3, 3) shape of the ellipsoid.
        sigma: standard deviation of the residuals.
        off: distance of the centre from the maximum-likelihood centre.
    """
    reasons = []
    factor, name = recording.field_shown
    shown = factor * unit
    strength = float(np.cbrt(np.linalg.det(root)))
    if sigma > _MOST_UNEXPLAINED * strength:
        reasons.append(
            f"the ellipsoid leaves {sigma * shown:.1f} {name} unexplained (at most {_MOST_UNEXPLAINED:.0%} of the "
            "field is tolerated): the field or the instrument changed during the recording; choose an interval "
            "(start=, end=)"
        )
    longest, _, shortest = np.linalg.svd(root, compute_uv=False)
    if longest > _MOST_STRETCHED * shortest:
        reasons.append(
            f"the ellipsoid is {longest / shortest:.1f} times as long as wide, more than iron does (at most "
            f"{_MOST_STRETCHED:g} is tolerated): turn the sensor about more axes"
        )
    if off > HARD_IRON_LIMIT * strength:
        by = f"another {off * shown:.1f} {name}" if off <= strength else "more than the field itself"
        reasons.append(
            f"the samples' distances from the ellipsoid pull its centre by {by} (limit "
            f"{HARD_IRON_LIMIT * strength * shown:.1f} {name}): noise biases this method here; turn the sensor about "
            "more axes, or choose another method"
        )
    return reasons


def _flat(matrix: Array) -> bool:
    stretch = np.linalg.svd(matrix, compute_uv=False)
    return bool(stretch[2] <= 1e-6 * stretch[0])


def _assessed(
    samples: Array, root: Array, offset: Array, ellipsoid: Ellipsoid
) -> tuple[float, Array | None, Array]:
    """Return the noise of a sample, and the covariance (9, 9) and the bias (9,) of vech(A) and h.

    An estimate that solves Σ w r dr = 0 has the covariance H⁻¹ (Σ w² r² dr drᵀ) H⁻¹ with H = Σ w dr drᵀ (White
    1980), for any distribution of the residuals; r is ‖A⁻¹(y − h)‖ − 1 or the distance from the ellipsoid. The
    covariance is None if H is singular. Least squares of the distances is the maximum likelihood for equal noise on all
    axes, so one Gauss–Newton step on them measures the bias of a method that minimises another criterion. Of a robust
    method, which gives weights, the step is within the scatter that its own covariance holds.
    """
    points = closest_points(root, offset, samples.T)
    foot, normal, distance = points.direction.T, points.normal.T, points.distance
    distance_slope = -np.hstack([np.einsum("ni,jik,nk->nj", normal, SYMMETRIC_UNITS, foot), normal])
    trust = np.ones(len(samples)) if ellipsoid.weights is None else ellipsoid.weights
    freedom = max(float(trust.sum()) - UNKNOWNS, 1.0)
    sigma = float(np.sqrt(np.sum(trust * distance**2) / freedom))
    likeliest = _information(distance_slope, trust)
    if likeliest is None:
        return sigma, None, np.zeros(UNKNOWNS)
    step = -np.linalg.solve(likeliest, distance_slope.T @ (trust * distance))

    residual, slope = distance, distance_slope
    if ellipsoid.radial:
        field_ = np.linalg.solve(root, (samples - offset).T).T
        norm = np.linalg.norm(field_, axis=1)
        gradient = np.linalg.solve(root, field_.T).T / norm[:, None]
        by_shape = np.einsum("ni,jik,nk->nj", gradient, SYMMETRIC_UNITS, field_)
        residual, slope = norm - 1, -np.hstack([by_shape, gradient])
    information = _information(slope, trust)
    if information is None:
        return sigma, None, np.zeros(UNKNOWNS)
    inverse = np.linalg.inv(information)
    score = slope * (trust * residual)[:, None]
    moved = score @ inverse  # of the estimate by each sample
    return sigma, moved.T @ moved * len(samples) / freedom, -step


def _information(slope: Array, weight: Array) -> Array | None:
    """Return Σ w s sᵀ; None if it is singular after scaling the parameters."""
    information: Array = (slope * weight[:, None]).T @ slope
    scale = np.sqrt(np.diag(information))
    eigenvalues = np.linalg.eigvalsh(information / np.outer(scale, scale))
    return information if eigenvalues[0] > _SINGULAR * eigenvalues[-1] else None
