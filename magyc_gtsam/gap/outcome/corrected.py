"""The calibration that results from a refit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.gauge import fix_scale
from magyc_gtsam.factors.chain.chain_values import DELAY
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.factors.effects.signals import rows_by_kind
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.rules import RULES


def as_calibration(result: Refit, field_strength: float | None, extra: tuple[Term, ...] = ()) -> Calibration:
    """Return the model as a calibration: its terms in SI units, then `extra` terms, which change no reading."""
    model, parameters = result.model, result.model.parameters
    base = np.flatnonzero(model.free)[:12]
    covariance = result.covariance[: len(base), : len(base)]
    soft_iron, unit, reported = fix_scale(unvech(parameters[:6]), covariance, field_strength)
    terms, followed = [], rows_by_kind(result.twin.problem.recording.channels)
    for index, term in enumerate(model.terms):
        value, spread = result.value_of(index)
        kind = TERMS[term.name].kind
        terms.append(Term(term.name, value, spread, term.setting, () if kind is None else followed.get(kind, ())))
    late = np.flatnonzero(np.flatnonzero(model.free) == DELAY)  # free without a timing, too
    return Calibration(
        soft_iron,
        parameters[6:9],
        parameters[9:12],
        covariance=reported,
        delay=float(parameters[DELAY]),
        delay_sigma=float(np.sqrt(result.covariance[late[0], late[0]])) if len(late) else None,
        terms=(*terms, *extra),
        converged=result.converged,
        message="converged" if result.converged else "the joint refit did not converge",
        method="gap",
        noise={"magnetic_field": model.noise.magnetometer, "angular_rate": model.noise.gyroscope},
        field_strength=unit,
        diagnostics={"windows": result.twin.n, "cost": float(result.twin.reduced.cost)},
    )


def given_strength(calibration: Calibration | None) -> float | None:
    """Return the field strength, T, that was given for a calibration; a measured one is that of its place alone."""
    known = {} if calibration is None else calibration.configuration
    given = any(known.get(name) is not None for name in ("field_strength", "field"))
    return calibration.field_strength if given and calibration is not None else None


def unmoved(before: Calibration, after: Calibration) -> Calibration:
    """Return `after`, with the soft and hard iron of `before` if their difference is small relative to its sigmas.

    An effect that moves the iron by a small part of its sigma did not cause an error of the heading; to follow it would
    be to follow the noise as often as not.
    """
    change = [after.soft_iron - before.soft_iron, after.hard_iron - before.hard_iron]
    sigmas = [after.sigma["soft_iron"], after.sigma["hard_iron"]]
    moved = np.concatenate([(c / np.maximum(s, 1e-300)).ravel() for c, s in zip(change, sigmas, strict=True)])
    if float(np.sqrt((moved**2).mean())) > RULES.worth_moving:
        return after
    return replace(after, soft_iron=before.soft_iron, hard_iron=before.hard_iron)
