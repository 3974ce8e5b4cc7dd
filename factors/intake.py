"""Checks of what `NativeFactors` is given, and the return to the state before an update that fails."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import gtsam
import numpy as np

from magyc_gtsam.factors.alignment import AlignmentLimits
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import check_kind
from magyc_gtsam.factors.health import HealthLimits
from magyc_gtsam.factors.numbers import is_positive
from magyc_gtsam.factors.variables import key_name


class NotSaved:
    """What belongs to one solver in memory, and cannot be copied or pickled without it."""

    def __reduce_ex__(self, protocol: object) -> str | tuple[Any, ...]:
        """Refuse to be copied or pickled.

        Raises:
            MagycError: always.
        """
        raise MagycError(
            f"{type(self).__name__} belongs to its solver and cannot be copied or saved: save the solver's graph and "
            "values, which need no Python, and begin with a new one"
        )


def expect_problem(graph: object, values: Any) -> None:
    """Raise an error unless these are a graph and values, all of them finite."""
    check_kind("native factors: `graph`", graph, gtsam.NonlinearFactorGraph, "a gtsam.NonlinearFactorGraph")
    check_kind("native factors: `values`", values, gtsam.Values, "the gtsam.Values of the variables")
    if not np.isfinite(values.localCoordinates(values).vector()).all():
        _refuse_not_finite(values)


def _refuse_not_finite(values: gtsam.Values) -> None:
    """Raise an error that names the variables that are not finite."""
    zero = values.localCoordinates(values)
    wrong = [key_name(key) for key in list(values.keys()) if not np.isfinite(zero.at(key)).all()]
    raise MagycError(
        f"native factors: the value of {', '.join(wrong[:5])}{' and others' if len(wrong) > 5 else ''} is not finite; "
        "insert numbers, for example from the last estimate"
    )


def expect_options(
    tolerance: object, growth: Any, recent: Any, quadratic: object, alignment: object, health: object
) -> None:
    """Raise an error unless the options of `NativeFactors` are of their kinds and inside their limits."""
    if not (is_positive(tolerance) and is_positive(growth) and growth > 1):
        raise MagycError(f"native factors: tolerance {tolerance!r} must be above 0, growth {growth!r} above 1")
    if not isinstance(recent, int | np.integer) or isinstance(recent, bool) or recent < 1:
        raise MagycError(
            f"native factors: recent {recent!r:.40}; it must be a whole number of blocks, and at least 1 block must "
            "be checked"
        )
    if not isinstance(quadratic, bool | np.bool_):
        raise MagycError(f"native factors: quadratic {quadratic!r:.40}; give True or False")
    for name, limits, kind in (("alignment", alignment, AlignmentLimits), ("health", health, HealthLimits)):
        if limits is not None:
            check_kind(f"native factors: `{name}`", limits, kind, f"{kind.__name__}(), or None to switch it off")


def expect_values(keys: Iterable[int], exists: Callable[[int], bool]) -> None:
    """Raise an error unless each of these variables has a value."""
    absent = [key_name(key) for key in dict.fromkeys(keys) if not exists(key)]
    if absent:
        raise MagycError(
            f"native factors: no value for {', '.join(absent[:5])}{' and others' if len(absent) > 5 else ''}; insert "
            "one for each variable of the graph"
        )


@contextmanager
def unchanged_on_error(*objects: object) -> Iterator[Callable[[Iterable[object]], None]]:
    """Restore the attributes of objects, and the lists among them, where the block raises an error.

    The block is given a function that adds objects.
    """
    before: list[tuple[object, dict[str, Any]]] = []

    def keep(added: Iterable[object]) -> None:
        for each in added:
            attributes = vars(each).items()
            before.append(
                (each, {name: list(held) if isinstance(held, list) else held for name, held in attributes})
            )

    keep(objects)
    try:
        yield keep
    except BaseException:
        for each, attributes in before:
            vars(each).update(attributes)
        raise
