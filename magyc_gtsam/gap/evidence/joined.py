"""Two changes of one kind that may be one: until one time and from another one on, or with the other sign between.

They are one if both have the same value. The field beside steel, where a vehicle stays in the middle of a log, is first
taken for the field of the place, and that of both ends for another one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations

from magyc_gtsam.gap.model.problem import Model
from magyc_gtsam.gap.model.refit import without_term


def joined(model: Model, duration: float) -> Iterator[tuple[str, Model]]:
    """Yield (name, model) with two changes as one, present for at most half of the duration, s."""
    for one, other in permutations(model.terms, 2):
        if one.name != other.name or (one.setting.keys(), other.setting.keys()) != ({"until"}, {"time"}):
            continue
        first, last = one.setting["until"], other.setting["time"]
        inside = last - first < 0.5 * duration
        setting = {"time": first, "until": last} if inside else {"time": last, "until": first}
        both = replace(one, setting=setting, value=-one.value if inside else one.value)
        less = without_term(model, model.terms.index(other))
        yield one.name, replace(less, terms=tuple(both if term is one else term for term in less.terms))
