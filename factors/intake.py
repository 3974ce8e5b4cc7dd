"""Checks of what `NativeFactors` is given, and the return to the state before an update that fails."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import gtsam

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import check_kind
from magyc_gtsam.factors.variables import key_name


def expect_problem(graph: object, values: object) -> None:
    """Raise an error unless these are a graph and values."""
    check_kind("native factors: `graph`", graph, gtsam.NonlinearFactorGraph, "a gtsam.NonlinearFactorGraph")
    check_kind("native factors: `values`", values, gtsam.Values, "the gtsam.Values of the variables")


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
