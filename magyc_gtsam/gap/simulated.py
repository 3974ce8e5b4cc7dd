"""The user's own simulator against the data: which of its assumptions do the data reject?

Both recordings go through the same estimation; what differs by more than both can be wrong is an assumption that
fails. The motions need not be the same, for the twin takes the motion out of each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from scipy.stats import norm

from magyc_gtsam.factors.rotations import Array
from magyc_gtsam.factors.soft_iron import unvech, vech
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.naming import Look
from magyc_gtsam.gap.refit import Refit
from magyc_gtsam.gap.result import Assumption
from magyc_gtsam.gap.score import FAMILY_WISE, Score

_Row = tuple[str, float, float, float, str]
_AXES = ("x", "y", "z")


def compare(measured: Look, simulated: Look) -> tuple[Assumption, ...]:
    """Parameters, noise and effects of the two, the rejected ones first."""
    rows = [*_noise(measured.refit, simulated.refit), *_parameters(measured.refit, simulated.refit)]
    rows += list(_effects(measured.scores, simulated.scores))
    limit = float(norm.isf(FAMILY_WISE / max(len(rows), 1) / 2))
    result = [_assumption(row, limit) for row in rows]
    return tuple(sorted(result, key=lambda a: -abs(a.measured - a.simulated) / max(a.sigma, 1e-300)))


def _assumption(row: _Row, limit: float) -> Assumption:
    what, simulated, measured, sigma, unit = row
    rejected = bool(abs(measured - simulated) > limit * sigma)
    words = f"{what}: the simulator has {simulated:.3g} {unit}, the data {measured:.3g} {unit} (± {sigma:.2g})"
    return Assumption(
        what, simulated, measured, sigma, unit, rejected, words + ("" if rejected else ", no contradiction")
    )


def _noise(measured: Refit, simulated: Refit) -> Iterator[_Row]:
    for name, index, scale, unit in (
        ("magnetometer noise per sample", 0, 1e6, "µT"),
        ("gyroscope noise per sample", 1, 1e3, "mrad/s"),
    ):
        values = [float(r.model.noise[index]) * scale for r in (simulated, measured)]
        # A level from n squares is known to 1/√(2n) of itself; the gyroscope's shows in the links only.
        shares = [(2.0 * r.twin.n) ** -0.5 * (1.0 if index == 0 else 3.0) for r in (simulated, measured)]
        first, second = values
        yield name, first, second, float(np.hypot(*np.multiply(values, shares))), unit


def _parameters(measured: Refit, simulated: Refit) -> Iterator[_Row]:
    def read(of: Callable[[Array], Array]) -> tuple[Array, Array]:
        values, variances = [], []
        for result in (simulated, measured):
            theta, covariance = result.model.parameters[:12], result.covariance[:12, :12]
            at = of(theta)
            steps = 1e-4 * np.maximum(np.abs(theta), 1e-9)
            slope = np.stack([(of(theta + step) - at) / steps[i] for i, step in enumerate(np.diag(steps))], axis=1)
            values.append(at)
            variances.append(np.diag(slope @ covariance @ slope.T))
        return np.array(values), np.sqrt(np.sum(variances, axis=0))

    def shape(theta: Array) -> Array:
        soft = unvech(theta[:6])
        return vech(soft / np.cbrt(abs(np.linalg.det(soft)))) * 100

    groups: tuple[tuple[str, tuple[str, ...], Callable[[Array], Array], str], ...] = (
        ("field strength", ("",), lambda t: np.array([np.cbrt(abs(np.linalg.det(unvech(t[:6]))))]) * 1e6, "µT"),
        ("soft iron", ("xx", "xy", "xz", "yy", "yz", "zz"), shape, "%"),
        ("hard iron", _AXES, lambda t: t[6:9] * 1e6, "µT"),
        ("gyroscope bias", _AXES, lambda t: t[9:12] * 1e3, "mrad/s"),
    )
    for name, parts, of, unit in groups:
        (first, second), sigma = read(of)
        for i, part in enumerate(parts):
            yield f"{name} {part}".strip(), float(first[i]), float(second[i]), float(sigma[i]), unit


def _effects(measured: list[Score], simulated: list[Score]) -> Iterator[_Row]:
    """Effects with one setting, by the parameter that differs most."""
    by_name = {s.name: s for s in simulated}
    for score in measured:
        other = by_name.get(score.name)
        if score.generic or other is None or len(score.expected) != len(other.expected):
            continue
        if len(score.variants) > 1:  # found at different settings: not the same quantity
            continue
        term = TERMS[score.name]
        sigma = np.sqrt(np.diag(score.covariance) + np.diag(other.covariance))
        worst = int(np.argmax(np.abs(score.expected - other.expected) / np.maximum(sigma, 1e-300)))
        part = term.names(len(score.expected))[worst]
        values = other.expected[worst] * term.scale, score.expected[worst] * term.scale
        yield (
            f"{term.label}, {part}",
            float(values[0]),
            float(values[1]),
            float(sigma[worst] * term.scale),
            term.unit,
        )
