"""Neighbours of a named effect: its products with other signals, which no effect of the catalogue covers.

An effect of form c(t) may be the mean of c(t) s(t), the next order of an expansion in a signal s: a temperature
dependent sensitivity resembles a temperature dependent hard iron, a lag that grows with the rate of turn resembles a
constant lag. A named effect must explain the data clearly better than each product alone, and no product may be
significant beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.changes import Setting
from magyc_gtsam.factors.effects.forms import FORMS
from magyc_gtsam.factors.effects.signals import Signals
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.generic import Family
from magyc_gtsam.gap.model.columns import Columns
from magyc_gtsam.gap.model.twin import Twin

Product = Callable[[Array, Signals], Array]


def neighbours(name: str, setting: Setting) -> list[Family]:
    """Return the products of an effect at a setting, as families."""
    term = TERMS.get(name)
    if term is None:
        return []
    names = [(f"{name}×{by}", by) for by in term.products]
    return [Family(n, label_of(n), partial(_columns, name, setting, by)) for n, by in names]


def product_of(name: str) -> str | None:
    """Return the effect whose neighbour a family is; None for other families."""
    effect = name.partition("×")[0]
    return effect if effect in TERMS and effect != name else None


def label_of(name: str) -> str:
    """Return the name of a neighbour in words."""
    effect, _, by = name.partition("×")
    return f"{TERMS[effect].label}, times {_PRODUCTS[by][0]}"


def _columns(name: str, setting: Setting, by: str, twin: Twin) -> Columns:
    form, times = FORMS[name], _PRODUCTS[by][1]
    if form.side == "gyroscope":
        return twin.on_gyroscope(times(form.columns(twin.gyroscope, setting), twin.gyroscope))
    return Columns(times(form.columns(twin.windows, setting), twin.windows), None)


def _normalised(signal: Array) -> Array:
    return signal / max(float(np.sqrt((signal**2).mean())), 1e-12)


def _times(signal: Callable[[Signals], Array]) -> Product:
    """Return the product with a signal of all axes, or with that of each axis."""
    return lambda columns, signals: columns * _normalised(signal(signals))


def _field(columns: Array, signals: Signals) -> Array:
    """Multiply by a full matrix on the field, as a soft iron."""
    unit = _normalised(signals.need("field"))
    result: Array = (columns[:, None] * unit[None, :, None]).reshape(-1, *columns.shape[1:])
    return result


_PRODUCTS: Mapping[str, tuple[str, Product]] = MappingProxyType(
    {
        # A gain of each axis acts on the sensor's reading, which includes the hard iron, or on the field.
        "reading": ("the reading", _times(lambda s: s.need("field") + s.need("hard_iron")[:, None])),
        "gain": ("the field, axis by axis", _times(lambda s: s.need("field"))),
        "field": ("the field", _field),
        "speed": ("the speed of turn", _times(lambda s: np.linalg.norm(s.need("rate"), axis=0))),
        "speed²": ("the square of the speed of turn", _times(lambda s: (s.need("rate") ** 2).sum(axis=0))),
        # As a scale factor of each axis of the gyroscope.
        "rate": ("the rate of turn, axis by axis", _times(lambda s: s.need("rate"))),
    }
)
