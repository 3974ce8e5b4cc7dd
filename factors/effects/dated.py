"""Effects that are dated in the recording in which they were found, and what of them lasts beyond it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.factors.effects.term import Term

# Functions of time alone, at times of one log.
MOMENTS = (
    "hard-iron-step",
    "soft-iron-step",
    "gyro-bias-step",
    "gyro-bias-drift",
    "hard-iron-drift",
    "gain-drift",
    "local-anomaly",
)
DATED = (*MOMENTS, "tone", "clock-drift")  # which have a phase, and a beginning and an end
_JUMPS = ("hard-iron-step", "soft-iron-step", "gyro-bias-step")


class Afterwards(NamedTuple):
    """The parameters at the end of the recording in which the terms were found.

    Attributes:
        soft_iron, hard_iron, gyro_bias: as in a `Calibration`, with the jumps added.
        terms: the others.
        jumps: the terms that are now in the parameters.
    """

    soft_iron: Array
    hard_iron: Array
    gyro_bias: Array | None
    terms: tuple[Term, ...]
    jumps: tuple[Term, ...]


def lasts(term: Term) -> bool:
    """Return whether a term is a jump after which its value holds for good."""
    return term.name in _JUMPS and "until" not in term.setting


def afterwards(soft_iron: Array, hard_iron: Array, gyro_bias: Array | None, terms: Sequence[Term]) -> Afterwards:
    """Return parameters and terms with the jumps that last in the parameters.

    A jump of the soft iron adds its matrix times the field in the sensor, which is soft_iron · true field.
    """
    jumps = tuple(term for term in terms if lasts(term))
    soft, hard, bias = np.eye(3), np.zeros(3), np.zeros(3)
    for term in jumps:
        if term.name == "soft-iron-step":
            soft = soft + unvech(term.value)
        elif term.name == "hard-iron-step":
            hard = hard + term.value
        else:
            bias = bias + term.value
    after: Array = soft @ soft_iron
    return Afterwards(
        after,
        hard_iron + hard,
        None if gyro_bias is None else gyro_bias + bias,
        tuple(term for term in terms if not lasts(term)),
        jumps,
    )
