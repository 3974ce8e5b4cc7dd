"""The verdict on the model error, in words and for the diagnostics."""

from __future__ import annotations

from typing import Any

import numpy as np

from magyc_gtsam.estimators.model_error.component import Component
from magyc_gtsam.estimators.model_error.model_error import ModelError
from magyc_gtsam.factors.chain.chain_values import DELAY, SKEW
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.foreign_text import two_digits
from magyc_gtsam.observability import Observability

_MOST = 2.0  # multiple of the observability limits that noise and model error together may reach
_MENTIONED = 0.5  # model error, as a share of the sigma by the sensors' noise, from which it is mentioned
_NAMED = 2  # most components in a sentence
_ROWS = {"hard": slice(6, 9), "soft": slice(0, 6), "gyroscope": slice(9, 12), "rotation": SKEW}


def reason(error: ModelError, probable: Observability, noise: Observability) -> str:
    """Return why the model error is too large to trust a result; "" if it is not.

    Args:
        error: of the fit.
        probable: observability with the probable model error; noise: with the sensors' noise alone.
    """
    if not probable.weak or not noise.observable:
        return ""
    worst = probable.weak[0]
    if worst.sigma <= _MOST * worst.limit:
        return ""
    rows = _ROWS[worst.what.split()[0]]
    found = [component for component in error.worst(rows) if component in error.components][:_NAMED]
    first = found[0] if found else None
    place = "what the model does not explain" if first is None else f"{first.sentence}, which"
    moved = f"by ±{two_digits(worst.sigma)}" if worst.sigma < 100 * worst.limit else "without bounds, in"
    remedy = "record where the field is even" if first is not None and first.of_place else worst.remedy
    sentence = (
        f"{place} may move the {worst.what} {moved} {worst.unit} (limit {_MOST * worst.limit:.2g}): {remedy}"
    )
    return "; ".join([sentence, *(other.sentence for other in found[1:])])


def remark(error: ModelError, noise: Array, whole: Array) -> str:
    """Return the shares of noise and model error in the hard iron's sigma, and the field's variation; "" if negligible.

    Args:
        error: of the fit.
        noise, whole: (12, 12) covariances of the calibration by the sensors' noise, and with the model error.
    """
    if not error.components:
        return ""
    own, total = (float(np.linalg.eigvalsh(matrix[6:9, 6:9])[-1]) for matrix in (noise, whole))
    rest = np.sqrt(max(total - own, 0.0))
    parts = []
    if rest > _MENTIONED * np.sqrt(own):
        place = _sentence(error.worst(_ROWS["hard"])[0], error)
        parts.append(
            f"hard iron ±{two_digits(1e6 * np.sqrt(total))} µT: sensor noise {two_digits(1e6 * np.sqrt(own))} µT, what "
            f"the model does not explain {two_digits(1e6 * rest)} µT ({place})"
        )
    return "; ".join(filter(None, [*parts, variation(error)]))


def variation(error: ModelError) -> str:
    """Return a sentence on the variation of the ambient field; "" if none was found."""
    if error.field_variation is None:
        return ""
    size, period = error.field_variation
    within = "" if period is None else f" within some {0.5 * period:.2g} s"
    return f"the field of the place varies by {1e6 * size:.2g} µT an axis{within}"


def _sentence(component: Component, error: ModelError) -> str:
    found = component in error.components
    return component.sentence if found else f"it cannot be excluded that {component.sentence}"


def diagnostics(error: ModelError) -> dict[str, Any]:
    """Return as JSON types the components with parameter errors (T, rad/s, s), and the variation of the field."""
    found = error.field_variation
    return {
        "components": [_entry(component) for component in error.components],
        "field_variation": None if found is None else {"size": found[0], "period": found[1]},
    }


def _entry(component: Component) -> dict[str, Any]:
    deviation = np.sqrt(np.maximum(np.diag(component.covariance), 0.0))
    return {
        "name": component.name,
        "sentence": component.sentence,
        "size": component.size,
        "period": component.period,
        "gain": component.gain,
        "hard_iron": deviation[6:9].tolist(),
        "gyro_bias": deviation[9:12].tolist(),
        "delay": float(deviation[DELAY]),
    }
