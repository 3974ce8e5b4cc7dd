"""A set of effects at its joint minimum."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.beside import Beside
from magyc_gtsam.gap.evidence.laplace import Explained
from magyc_gtsam.gap.evidence.weighing import Weighed
from magyc_gtsam.gap.model.field_variation import FieldVariation
from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.model.variants import Projector

FIELD_VARIATION = "field-variation"


@dataclass(frozen=True, eq=False)
class Node:
    """A set of effects at its joint minimum.

    Attributes:
        names: of the set, in the order in which they were added.
        fit: of the model with them.
        variation: of the field, if it is in the set.
        log: log evidence of the set with its prior odds, relative to no effect, nats.
        search: nats by which the grid searches reduce `log`.
        misfit: mean square of the residual, in its noise.
        explained: power that the set explains.
        of_terms: what each of its terms explains.
        beside: the marginalised set, beside which candidates are tested.
        found: the candidates tested beside it.
        moving: nats of a variation like that of the field, but in the sensor's axes: of an unknown effect.
        refined: names whose most probable setting was refined on a finer grid.
    """

    names: tuple[str, ...]
    fit: Refit
    variation: FieldVariation | None
    log: float
    search: float
    misfit: float
    explained: float
    of_terms: Explained
    beside: Beside
    found: dict[str, Weighed] = field(default_factory=dict)
    moving: list[float] = field(default_factory=list)
    refined: set[str] = field(default_factory=set)

    @property
    def key(self) -> tuple[str, ...]:
        """Return the names, sorted."""
        return tuple(sorted(self.names))

    @cached_property
    def left(self) -> Array:
        """Return the innovations (3n,) after the fit of parameters and terms, without the field variation."""
        twin = self.fit.twin
        result: Array = Projector(twin.base_columns, twin.base_score_bias)(twin.residual().reshape(1, -1))[0]
        return result

    @property
    def named(self) -> float:
        """Return the power that its named effects explain."""
        return max(self.explained - self._varying, 0.0) if self.names else 0.0

    @cached_property
    def of_field(self) -> float:
        """Return the power that the field variation explains beside the named effects and coloured noise."""
        return max(self._varying - self.of_colour[0], 0.0)

    @cached_property
    def _varying(self) -> float:
        """Return the power of the field variation with coloured noise."""
        if self.variation is None:
            return 0.0
        without, rows = float(self.left @ self.left) / self.variation.noise**2, len(self.left)
        return max(without - self.misfit * rows, 0.0)

    @cached_property
    def of_colour(self) -> tuple[float, float]:
        """Return the power that coloured noise explains, and that it could explain of the effects' signal."""
        if self.variation is None or not self.variation.colour_columns:
            return 0.0, 0.0
        columns = self.variation.components[-self.variation.colour_columns :] / self.variation.noise
        last = self.beside.before
        value = self.beside.solution()[0][last - len(columns) : last]
        own, signal = value @ columns, columns @ self.beside.signal()
        information = columns @ columns.T + np.eye(len(columns))
        return float(own @ own), float(signal @ np.linalg.solve(information, signal))

    def key_with(self, name: str) -> tuple[str, ...]:
        """Return the key of the set with one more name."""
        return tuple(sorted((*self.names, name)))

    def full(self, name: str) -> bool:
        """Return whether the set contains an effect as often as it may."""
        return self.names.count(name) >= TERMS[name].most


def related(one: str, other: str) -> bool:
    """Return whether one effect is confused with the other according to the catalogue, or is the same."""
    return one == other or other in TERMS[one].rivals or one in TERMS[other].rivals
