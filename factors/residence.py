"""The solver in which the quadratics of a `NativeFactors` have their slots, and what others changed in it."""

from __future__ import annotations

import gtsam

from magyc_gtsam.factors.delivered import Delivered
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.solver import Solver, View


class Residence:
    """Remembers the solver of the last update, since a slot is a place in one solver's graph.

    Attributes:
        batch: the factors of the last batch, whose slots are those of the graph that `solve` returned.
    """

    def __init__(self) -> None:
        self.batch: list[Delivered] = []
        self._solver: Solver | None = None
        self._state: tuple[int, int, int] | None = None

    def expect(self, solver: Solver | None, *, settling: bool = False) -> None:
        """Raise an error unless this is the solver of the last update; None for a batch.

        Args:
            solver: what an update or `settle` was given.
            settling: whether it was `settle`, which needs an update before.

        Raises:
            MagycError: another solver, values in place of a solver, a batch after updates, or a batch that no solver
                was given.
        """
        if isinstance(solver, gtsam.Values):
            raise MagycError(
                "native factors: the solver is a Values; update an ISAM2 or a smoother, or call solve"
            )
        if settling and self.batch:
            raise MagycError(
                "native factors: the solver was given no update after solve; update it with the graph and values that "
                "solve returned"
            )
        if self._solver is None or solver is self._solver:
            return
        if solver is None:
            raise MagycError(
                "native factors: a batch after updates of a solver, whose quadratics would be lost; solve it with a "
                "NativeFactors of its own"
            )
        raise MagycError(
            "native factors: another solver than in the updates before (a copy too); give each solver a NativeFactors "
            "of its own"
        )

    def changed(self, view: View) -> bool:
        """Whether variables may have left the solver since `note`; always in solvers that drop them by themselves."""
        return view.state is None or view.state != self._state

    def note(self, solver: Solver) -> None:
        """Remember the solver and its state after an update."""
        self._solver, self._state, self.batch = solver, View(solver).state, []

    def entered(
        self, solver: Solver, graph: gtsam.NonlinearFactorGraph, delivered: list[Delivered]
    ) -> tuple[gtsam.NonlinearFactorGraph, list[Delivered]]:
        """Return the factors of an update and what the solver holds before; after a batch its graph may be among them.

        The quadratics of the batch then are Python factors again, since they get other slots in the solver.

        Raises:
            MagycError: as `expect`.
        """
        self.expect(solver)
        if not self.batch:
            return graph, delivered
        factors = {id(each.native): each.factor for each in self.batch}
        result = gtsam.NonlinearFactorGraph()
        for i in range(graph.size()):
            if graph.exists(i):
                factor = graph.at(i)
                result.push_back(factors.get(id(factor), factor))
        return result, []


def present(view: View, delivered: list[Delivered]) -> list[Delivered]:
    """Return those factors whose variables exist, and whose slot in iSAM2 still has their quadratic."""
    found = [each for each in delivered if all(map(view.exists, each.factor.keys()))]
    if not isinstance(view.solver, gtsam.ISAM2):
        return found
    held = view.solver.getFactorsUnsafe()
    return [
        each
        for each in found
        if each.slot < held.size() and held.exists(each.slot) and held.at(each.slot) is each.native
    ]
