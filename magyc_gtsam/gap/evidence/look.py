"""A look at all candidates beside a set of effects."""

from __future__ import annotations

from typing import NamedTuple

from magyc_gtsam.gap.effects import TERMS, sudden
from magyc_gtsam.gap.evidence.beside import Beside
from magyc_gtsam.gap.evidence.candidates import Candidates
from magyc_gtsam.gap.evidence.neighbours import neighbours
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.weighing import Weighed, best_of, weigh
from magyc_gtsam.gap.model.twin import Twin

_FINER = 3  # rounds of refining a setting


class Look(NamedTuple):
    """What a look at all candidates shows.

    Attributes:
        found: {name: its evidence}.
        refined: names whose most probable setting was refined on a finer grid.
    """

    found: dict[str, Weighed]
    refined: frozenset[str]

    @classmethod
    def of(cls, candidates: Candidates, twin: Twin, beside: Beside) -> Look:
        """Test all candidates beside a set of effects."""
        found = weigh(candidates, beside)
        refined = [each.name for each in best_of(found, PRIOR.beam)]
        found |= {name: finer(found[name], twin, beside) for name in refined}
        # A product with another signal may be present beside its effect, and instead of a probable one: it is tested at
        # the setting of that effect, with the same penalty for the grid search.
        likely = [(each.name, each.setting, each.search) for each in best_of(found, PRIOR.beam) if each.log > 0]
        likely += [(term.name, term.setting, 0.0) for term in twin.model.terms]
        products = {f.name: (f, cost) for name, at, cost in likely for f in neighbours(name, at)}
        if products:
            made = weigh(Candidates.of(twin, (), [f for f, _ in products.values()]), beside)
            found |= {name: each.less(products[name][1]) for name, each in made.items()}
        return cls(found, frozenset(refined))


def finer(option: Weighed, twin: Twin, beside: Beside) -> Weighed:
    """Return a candidate with the cell of its most probable setting averaged over a finer grid, if it has one.

    The time of a jump is determined to a fraction of the grid's spacing; between two grid points most of its evidence
    would be missed. For an object attached and taken off, the two times are refined in turn.
    """
    for _ in range(_FINER):
        near = TERMS[option.name].refined(twin, dict(option.setting))
        if not near:
            break
        closer = Candidates.at(twin, option.name, near)
        option, before = option.with_cell(weigh(closer, beside)[option.name]), option
        if option.setting == before.setting or not sudden(option.name, option.setting):
            break
    return option
