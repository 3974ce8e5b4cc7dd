"""A set of effects at its joint minimum."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from magyc_gtsam.estimators.smoother.reasons import MOST_UNEXPLAINED
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.changes import Setting
from magyc_gtsam.gap.effects import TERMS, nested
from magyc_gtsam.gap.evidence.beside import Beside
from magyc_gtsam.gap.evidence.candidates import COLOUR, Candidates
from magyc_gtsam.gap.evidence.laplace import Explained, Terms
from magyc_gtsam.gap.evidence.look import Look
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.weighing import Weighed, weigh
from magyc_gtsam.gap.model.field_variation import FieldVariation, field_variation
from magyc_gtsam.gap.model.problem import Active
from magyc_gtsam.gap.model.projector import Projector
from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.rules import RULES

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
        scales: (t,) the most probable scale of each term's values.
        beside: the marginalised set, beside which candidates are tested.
        candidates: of the tree.
    """

    names: tuple[str, ...]
    fit: Refit
    variation: FieldVariation | None
    log: float
    search: float
    misfit: float
    explained: float
    of_terms: Explained
    scales: Array
    beside: Beside
    candidates: Candidates

    @property
    def key(self) -> tuple[str, ...]:
        """Return the names, sorted."""
        return tuple(sorted(self.names))

    @cached_property
    def _look(self) -> Look:
        return Look.of(self.candidates, self.fit.twin, self.beside)

    @cached_property
    def with_sensor(self) -> FieldVariation:
        """Return what varies in the sensor's axes, in place of the field in the world's."""
        modes = None if self.variation is None else self.variation.modes  # the same, to be compared
        return field_variation(self.fit.twin, in_world=False, modes=modes)

    @property
    def in_sensor(self) -> float:
        """Return the nats of the field's variation in the sensor's axes, relative to that in the world's."""
        return 0.0 if self.variation is None else self.with_sensor.gain - self.variation.gain

    @cached_property
    def disturbed(self) -> bool:
        """Return whether the field varies by so much of its strength that only what is larger can be told beside it.

        A part of it, which has no form, then looks like any name: of 14 names in a walk past magnets 12 were false. A
        magnet that is attached by hand explains more than what else varies.
        """
        if self.variation is None:
            return False
        return self.variation.share_of(self.fit.twin) > MOST_UNEXPLAINED

    @property
    def formless(self) -> float:
        """Return the power of a name up to which what has no form may explain it.

        That is a share of the field variation's, and all of it with the correlated noise where the field is disturbed.
        """
        return self.of_field + self.of_colour[0] if self.disturbed else PRIOR.form * self.of_field

    @property
    def most(self) -> float:
        """Return the nats that no candidate beside the set exceeds: those of all that the set leaves.

        A look at the candidates takes much longer, and is of no use where these would not be enough.
        """
        return 0.5 * self.beside.square

    @property
    def more(self) -> float:
        """Return the nats of the most probable candidate beside the set, at least 0."""
        return max([0.0, *(each.log for each in self.found.values())])

    @property
    def found(self) -> dict[str, Weighed]:
        """Return the candidates, tested beside the set at the first use: a set that is given up needs none."""
        return self._look.found

    @property
    def refined(self) -> frozenset[str]:
        """Return the names whose most probable setting was refined on a finer grid."""
        return self._look.refined

    @cached_property
    def kept(self) -> list[int]:
        """Return the terms that exceed the deviation from its form of another one or of the field variation.

        If each of two terms may be the deviation of the other, the one with more evidence remains. The terms are left
        out one by one, the least evident first, since another one explains more without them.
        """
        terms = self.fit.model.terms
        result = sorted(range(len(terms)), key=lambda one: -self.of_terms.nats[one])
        while True:
            powers = self.of_terms.powers(result)
            deviating = self._deviating_field(result, powers)
            for place in reversed(range(len(result))):
                index, stronger = result[place], result[:place]
                deviations = [PRIOR.form * powers[index, j] for j in stronger]
                passed = any(one_event(terms[index], terms[other]) for other in stronger)
                if passed or index in deviating or powers[index, index] <= max([0.0, *deviations]):
                    del result[place]
                    break
            else:
                return sorted(result)

    def _deviating_field(self, among: Sequence[int], powers: Mapping[tuple[int, int], float]) -> set[int]:
        """Return the terms that may be a deviation of the field variation from its form.

        The field can explain most of what an effect does, but in place of the field the effect explains a good part.
        """
        if self.variation is None:
            return set()
        alone, noise, field = self._without_field.powers(among), self.variation.noise, self.of_field
        beside = {i for i in among if powers[i, i] <= PRIOR.form * field}
        return beside | {i for i in among if alone[i, i] / noise**2 <= PRIOR.in_place_of_field * field}

    @cached_property
    def _without_field(self) -> Explained:
        """Return what the terms explain if the field does not vary, in units of the sensors' noise."""
        terms = Terms.of(self.fit)
        information, score = terms.information(terms.beside(None))
        return Explained(information, score, terms.of_term, self.of_terms.nats)

    @cached_property
    def powers(self) -> dict[str, float]:
        """Return the power that each name explains: of the kept terms, of the field variation and coloured noise."""
        powers = self.of_terms.powers(self.kept)
        result: dict[str, float] = {}
        for index in self.kept:
            name = self.fit.model.terms[index].name
            result[name] = result.get(name, 0.0) + powers[index, index]
        if self.variation is not None:  # the effects may explain all of it
            if self.variation.evident:
                result[FIELD_VARIATION] = self.of_field
            colour, contained = self.of_colour
            if self.variation.coloured and colour > PRIOR.form_of_colour * contained:
                result[COLOUR] = 0.0
        return result

    @property
    def present(self) -> tuple[str, ...]:
        """Return the names of the kept terms, with field variation and coloured noise if these are evident, sorted."""
        return tuple(sorted(self.powers))

    @cached_property
    def left(self) -> Array:
        """Return the innovations (3n,) after the fit of parameters and terms, without the field variation."""
        twin = self.fit.twin
        result: Array = Projector(twin.base_columns)(twin.residual().reshape(1, -1))[0]
        return result

    @cached_property
    def of_field(self) -> float:
        """Return the power that the field variation explains beside the named effects and coloured noise."""
        if self.variation is None:
            return 0.0
        without, rows = float(self.left @ self.left) / self.variation.noise**2, len(self.left)
        return max(without - self.misfit * rows - self.of_colour[0], 0.0)

    @cached_property
    def of_colour(self) -> tuple[float, float]:
        """Return the power that coloured noise explains, and that it could explain of the effects' signal."""
        if self.variation is None or not self.variation.colour_columns:
            return 0.0, 0.0
        columns = self.variation.components[-self.variation.colour_columns :] / self.variation.noise
        last = self.beside.before
        value = self.beside.solution()[0][last - len(columns) : last]
        own, signal = value @ columns, columns @ self.beside.signal
        information = columns @ columns.T + np.eye(len(columns))
        return float(own @ own), float(signal @ np.linalg.solve(information, signal))

    def closer(self, index: int) -> Setting:
        """Return the setting of a term that is most probable in the set's linear model, among those near its own."""
        term = self.fit.model.terms[index]
        near = TERMS[term.name].refined(self.fit.twin, term.setting)
        if not near:
            return term.setting
        candidates = Candidates.at(self.fit.twin, term.name, near)
        without = Terms.of(self.fit).added_to(self.beside.rest(), self.scales, without=index)
        return weigh(candidates, without)[term.name].setting

    def replaceable(self, index: int) -> bool:
        """Return whether a rival of a term explains at least half of what the term does beside the others."""
        name = self.fit.model.terms[index].name
        rivals = self.candidates.only(lambda each: each in TERMS and each != name and related(each, name))
        half = 0.5 * (self.of_terms.nats[index] + PRIOR.named)
        without = Terms.of(self.fit).added_to(
            self.beside.rest(), self.scales, without=index
        )  # in its linear model
        return any(each.log + PRIOR.named > half for each in weigh(rivals, without).values())

    def key_with(self, name: str) -> tuple[str, ...]:
        """Return the key of the set with one more name."""
        return tuple(sorted((*self.names, name)))

    def names_without(self, name: str) -> tuple[str, ...]:
        """Return the names with one less."""
        at = self.names.index(name)
        return (*self.names[:at], *self.names[at + 1 :])

    def key_without(self, name: str) -> tuple[str, ...]:
        """Return the key of the set with one name less."""
        return tuple(sorted(self.names_without(name)))

    def has_one_more_than(self, other: Node) -> bool:
        """Return whether the set is another one with one more name."""
        return any(self.key_without(name) == other.key for name in self.key)

    def differs_by_one_from(self, other: Node) -> bool:
        """Return whether the set is another one with one name in place of another."""
        mine, theirs = Counter(self.names), Counter(other.names)
        return (mine - theirs).total() == 1 == (theirs - mine).total()

    def full(self, name: str) -> bool:
        """Return whether the set contains an effect as often as it may, or a special or a general case of it."""
        return self.names.count(name) >= TERMS[name].most or any(nested(name, other) for other in self.names)


def related(one: str, other: str) -> bool:
    """Return whether one effect is confused with the other according to the catalogue, or is the same."""
    return one == other or other in TERMS[one].rivals or one in TERMS[other].rivals


def one_event(one: Active | Weighed, other: Active | Weighed) -> bool:
    """Return whether two changes, each in a set or a candidate, are one event.

    So are anomalies that are one object: bumps near each other, whose field rotates meanwhile, or one at the beginning
    or the end of a stay; and a jump of the iron when the place changes, which a vehicle at rest takes for each other.
    """
    names = {one.name, other.name}
    if "local-anomaly" not in names or not names <= {"local-anomaly", "hard-iron-step"}:
        return False
    reach = RULES.span * (one.setting.get("width", 0.0) + other.setting.get("width", 0.0))
    if len(names) == 2:
        if reach:
            return False
        reach = RULES.at_once
    ends = [[part.setting[end] for end in ("time", "until") if end in part.setting] for part in (one, other)]
    return any(abs(first - second) < reach for first in ends[0] for second in ends[1])
