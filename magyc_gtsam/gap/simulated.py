"""The user's own simulator against the data: which of its assumptions do the data reject?

Both recordings go through the same search; an effect that is found in one alone, and what differs by more than both
can be wrong, is an assumption that fails. The motions need not be the same, for the twin takes the motion out of each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import zip_longest
from typing import NamedTuple

import numpy as np
from scipy.stats import norm

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import unvech, vech
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.result import Assumption, Effect, Gap
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.search.naming import Look

_Row = tuple[str, float, float, float, str]
_AXES = ("x", "y", "z")


class Side(NamedTuple):
    """What was found in one of the two recordings: the gap, and the last look at its model."""

    gap: Gap
    last: Look


def compare(measured: Side, simulated: Side) -> tuple[Assumption, ...]:
    """Effects, parameters and noise of the two, the rejected ones first; what one could not show is last.

    Parameters and noise are those beside the effects that were found.
    """
    models = measured.last.refit, simulated.last.refit
    rows = [*_noise(*models), *_parameters(*models), *_unnamed(measured, simulated)]
    pairs = list(_pairs(measured.gap.effects, simulated.gap.effects))
    rows += [_row(own, other) for own, other in pairs if own is not None and other is not None]
    limit = float(norm.isf(RULES.family_wise / max(len(rows), 1) / 2))
    compared = [_assumption(row, limit) for row in rows]
    compared.sort(key=lambda a: -abs(a.measured - a.simulated) / max(a.sigma, 1e-300))
    return (
        *(_lacking(own, other) for own, other in pairs if own is None or other is None),
        *_nameless(measured.gap, simulated.gap),
        *compared,
        *_untested(measured.gap, simulated.gap),
    )


def _pairs(
    measured: tuple[Effect, ...], simulated: tuple[Effect, ...]
) -> Iterator[tuple[Effect | None, Effect | None]]:
    """Effects of one name in both, in the order of finding; None where the other has it not."""
    for name in dict.fromkeys(e.name for e in (*measured, *simulated)):
        own, other = ([e for e in side if e.name == name] for side in (measured, simulated))
        yield from zip_longest(own, other)


def _size(effect: Effect) -> tuple[float, float]:
    """The length of its value, and the sigma of that."""
    value, sigma = np.ravel(effect.value), np.ravel(effect.sigma)
    length = float(np.linalg.norm(value))
    return length, float(np.linalg.norm(value * sigma)) / max(length, 1e-300)


def _row(measured: Effect, simulated: Effect) -> _Row:
    """An effect in both: by the parameter that differs most, or by its size where each has a time or phase."""
    if measured.setting or simulated.setting or len(measured.value) != len(simulated.value):
        (first, before), (second, after) = _size(simulated), _size(measured)
        return measured.label, first, second, float(np.hypot(before, after)), measured.unit
    sigma = np.hypot(measured.sigma, simulated.sigma)
    worst = int(np.argmax(np.abs(measured.value - simulated.value) / np.maximum(sigma, 1e-300)))
    what = ", ".join([measured.label, *([measured.parameters[worst]] if len(sigma) > 1 else [])])
    return what, float(simulated.value[worst]), float(measured.value[worst]), float(sigma[worst]), measured.unit


def _lacking(measured: Effect | None, simulated: Effect | None) -> Assumption:
    """An effect that was found in one of the two alone."""
    effect = measured or simulated
    assert effect is not None
    size, sigma = _size(effect)
    sizes = (0.0, size) if measured else (size, 0.0)
    words = "the simulator lacks" if measured else "the simulator alone has"
    return Assumption(effect.label, *sizes, sigma, effect.unit, True, f"{words}: {effect.sentence}")


def _nameless(measured: Gap, simulated: Gap) -> Iterator[Assumption]:
    """What is missing in one of the two alone and was given no name, by how many hypotheses show it."""
    own, other = (float(len(gap.diagnostics["leftover"])) for gap in (measured, simulated))
    if bool(own) != bool(other):
        words = (
            f"the simulator lacks: {measured.sentence}"
            if own
            else f"the simulator alone has: {simulated.sentence}"
        )
        yield Assumption("hypotheses that something without a name is missing", other, own, 0.0, "", True, words)


def _untested(measured: Gap, simulated: Gap) -> Iterator[Assumption]:
    """What one of the two has no channel for, and was not found in the other either."""
    own, other = ({u.name: u for u in gap.untested} for gap in (measured, simulated))
    for name, candidate in (own | other).items():
        if name in measured.names or name in simulated.names:
            continue
        whose = "either recording" if name in own and name in other else "the data"
        if name not in own:
            whose = "the simulator's recording"
        words = f"{candidate.label}: not compared: {candidate.reason.replace('the recording', whose)}"
        yield Assumption(candidate.label, np.nan, np.nan, np.nan, "", False, words)


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


def _unnamed(measured: Side, simulated: Side) -> Iterator[_Row]:
    """Effects with one setting that were found in neither, by the parameter that differs most."""
    found = {*measured.gap.names, *simulated.gap.names}
    by_name = {score.name: score for score in simulated.last.scores}
    for score in measured.last.scores:
        other = by_name.get(score.name)
        if score.generic or score.name in found or other is None or len(score.expected) != len(other.expected):
            continue
        if len(score.variants) > 1:  # at different settings it is not the same quantity
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
