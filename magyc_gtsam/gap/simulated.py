"""Comparison of the user's simulator with the data: the assumptions of the simulator that the data reject.

Effects are named in both recordings in the same way. An assumption is rejected if an effect is found in one recording
only, or if a value differs by more than its uncertainty in both. The motions may differ, because the twin accounts for
each.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from itertools import zip_longest
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from magyc_gtsam.estimators.gauge import fix_scale
from magyc_gtsam.factors.chain.facts import field_strength
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import ENTRIES, unvech, vech
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.effects.term import AXES
from magyc_gtsam.gap.evidence.beside import Beside
from magyc_gtsam.gap.evidence.candidates import Candidates, what_matters
from magyc_gtsam.gap.evidence.weighing import weigh
from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.result import Assumption, Effect, Gap
from magyc_gtsam.gap.rules import RULES

_Row = tuple[str, float, float, float, str]
_GROUPS = (("soft iron", ENTRIES), ("hard iron", AXES), ("gyroscope bias", AXES))


class SimulatedGap(NamedTuple):
    """The result for one of the two recordings: the gap, and the model with its effects."""

    gap: Gap
    fitted: Refit


def compare(measured: SimulatedGap, simulated: SimulatedGap) -> tuple[Assumption, ...]:
    """Compare effects, parameters and noise of the two recordings.

    Parameters and noise are those of the models with the effects that were found.

    Returns:
        Rejected assumptions first; last, those that one recording could not test.
    """
    models = measured.fitted, simulated.fitted
    rows = [*_noise(*models), *_parameters(*models), *_unnamed(measured, simulated)]
    pairs = list(_pairs(measured.gap.effects, simulated.gap.effects))
    rows += [_row(own, other) for own, other in pairs if own is not None and other is not None]
    limit = -float(ndtri(RULES.family_wise / max(len(rows), 1) / 2))
    compared = [_assumption(row, limit) for row in rows]
    compared.sort(key=lambda a: -abs(a.measured - a.simulated) / max(a.sigma, 1e-300))
    return (
        *(_found_in_one(own, other) for own, other in pairs if own is None or other is None),
        *_misfit_in_one(measured.gap, simulated.gap),
        *compared,
        *_untested(measured.gap, simulated.gap),
    )


def _pairs(
    measured: tuple[Effect, ...], simulated: tuple[Effect, ...]
) -> Iterator[tuple[Effect | None, Effect | None]]:
    """Yield the effects of one name in both, in the order in which they were found; None for a missing one."""
    for name in dict.fromkeys(e.name for e in (*measured, *simulated)):
        own, other = ([e for e in side if e.name == name] for side in (measured, simulated))
        yield from zip_longest(own, other)


def _size(effect: Effect) -> tuple[float, float]:
    """Return the length of the effect's value, and its sigma."""
    value, sigma = np.ravel(effect.value), np.ravel(effect.sigma)
    length = float(np.linalg.norm(value))
    return length, float(np.linalg.norm(value * sigma)) / max(length, 1e-300)


def _row(measured: Effect, simulated: Effect) -> _Row:
    """Return an effect in both: its most different parameter, or its size if it has a setting (a time or phase)."""
    if measured.setting or simulated.setting or len(measured.value) != len(simulated.value):
        (first, before), (second, after) = _size(simulated), _size(measured)
        return measured.label, first, second, float(np.hypot(before, after)), measured.unit
    sigma = np.hypot(measured.sigma, simulated.sigma)
    worst = int(np.argmax(np.abs(measured.value - simulated.value) / np.maximum(sigma, 1e-300)))
    what = ", ".join([measured.label, *([measured.parameters[worst]] if len(sigma) > 1 else [])])
    return what, float(simulated.value[worst]), float(measured.value[worst]), float(sigma[worst]), measured.unit


def _found_in_one(measured: Effect | None, simulated: Effect | None) -> Assumption:
    """Return the assumption for an effect that was found in one recording only."""
    effect = measured or simulated
    assert effect is not None
    size, sigma = _size(effect)
    sizes = (0.0, size) if measured else (size, 0.0)
    words = "the simulator lacks" if measured else "the simulator alone has"
    return Assumption(effect.label, *sizes, sigma, effect.unit, True, f"{words}: {effect.sentence}")


def _misfit_in_one(measured: Gap, simulated: Gap) -> Iterator[Assumption]:
    """Yield the assumption for a misfit without a name in one recording only, with its number of hypotheses."""
    own, other = (float(len(gap.diagnostics["leftover"])) for gap in (measured, simulated))
    if bool(own) != bool(other):
        words = (
            f"the simulator lacks: {measured.sentence}"
            if own
            else f"the simulator alone has: {simulated.sentence}"
        )
        yield Assumption("hypotheses that something without a name is missing", other, own, 0.0, "", True, words)


def _untested(measured: Gap, simulated: Gap) -> Iterator[Assumption]:
    """Yield the effects for which one recording lacks a channel, and that were found in neither."""
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
        # A level from n squares has a relative sigma of 1/√(2n); the gyroscope's is determined by the links only.
        shares = [(2.0 * r.twin.n) ** -0.5 * (1.0 if index == 0 else 3.0) for r in (simulated, measured)]
        first, second = values
        yield name, first, second, float(np.hypot(*np.multiply(values, shares))), unit


def _parameters(measured: Refit, simulated: Refit) -> Iterator[_Row]:
    names = [f"{name} {part}" for name, parts in _GROUPS for part in parts]
    units = ("µT", *["%"] * 6, *["µT"] * 3, *["mrad/s"] * 3)
    (first, known), (second, more) = _shown(simulated), _shown(measured)
    sigma = np.sqrt(known + more)
    yield from zip(("field strength", *names), first.tolist(), second.tolist(), sigma.tolist(), units, strict=True)


def _shown(result: Refit) -> tuple[Array, Array]:
    """Return field strength, soft iron, hard iron and bias (13,) of a model in shown units, and their variances."""
    theta, covariance = result.model.parameters[:12], result.covariance[:12, :12]
    strength, slope = field_strength(theta[:6])
    soft_iron, _, of_shape = fix_scale(unvech(theta[:6]), covariance)
    scale = np.repeat([1e6, 1e2, 1e6, 1e3], [1, 6, 3, 3])
    value = np.concatenate([[strength], vech(soft_iron), theta[6:]])
    variance = np.append(slope @ covariance[:6, :6] @ slope, np.diag(of_shape))
    return scale * value, scale**2 * variance


def _unnamed(measured: SimulatedGap, simulated: SimulatedGap) -> Iterator[_Row]:
    """Yield the effects with one setting that were found in neither, by their most different parameter."""
    found = {*measured.gap.names, *simulated.gap.names}
    own, other = (_estimates(each.fitted, found) for each in (measured, simulated))
    for name in (name for name in own if name in other):
        term, (second, more), (first, less) = TERMS[name], own[name], other[name]
        if len(first) != len(second):
            continue
        sigma = np.sqrt(np.diag(more) + np.diag(less))
        worst = int(np.argmax(np.abs(second - first) / np.maximum(sigma, 1e-300)))
        what = f"{term.label}, {term.names(len(first))[worst]}"
        before, after, deviation = (float(each[worst] * term.scale) for each in (first, second, sigma))
        yield what, before, after, deviation, term.unit


def _estimates(fitted: Refit, found: Collection[str]) -> dict[str, tuple[Array, Array]]:
    """Return {effect with one setting that is not in a model: its estimate (k,) and covariance (k, k), SI}."""
    twin = fitted.twin
    # Values at different settings are different quantities.
    names = [name for name, term in TERMS.items() if name not in found and not term.missing(twin)]
    candidates = Candidates.of(twin, [name for name in names if len(TERMS[name].settings(twin)) == 1], ())
    result = {}
    for name, one in weigh(candidates, Beside.of_model(twin)).items():
        value, covariance = one.estimate
        unit = what_matters(twin, name, one.setting, len(value))
        result[name] = value * unit, covariance * np.outer(unit, unit)
    return result
