"""Whitened columns of every hypothesis: of the catalogue's effects at all their settings, and of generic families.

A candidate's amplitudes are a ~ N(0, s² D), with D the squares of the smallest values that matter (for the deviation of
its channel), and s a scale on a grid of octaves. Columns are multiplied by √D, so that only s varies.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.changes import Setting, per_axis
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.effects.iron import irregular_drifts
from magyc_gtsam.gap.evidence.generic import Family, families
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.model.columns import Columns, together
from magyc_gtsam.gap.model.field_variation import CORRELATION, fewest, waves
from magyc_gtsam.gap.model.problem import Active, Model
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.rules import RULES

Part = tuple[np.ndarray, str, Setting, float]  # places of columns, name, setting, and its log prior
Stack = tuple[Array, Array, list[Part]]
COURSE, COLOUR, DRIFT = "time:sensor", "coloured-noise", "hard-iron-drift"
_DRIFTS = (DRIFT, "gain-drift", "gyro-bias-drift")
_IRREGULAR = (DRIFT, "gyro-bias-drift")  # a gain changes as slowly as a temperature
_AT_ONCE = 100_000  # numbers processed at once, so that they stay in the processor's cache


@dataclass(frozen=True, eq=False)
class Batch:
    """Candidates with equally many columns: places (B, k), Gram matrices (B, k, k), names, settings and log priors."""

    rows: np.ndarray
    gram: Array
    names: tuple[str, ...]
    settings: tuple[Setting, ...]
    prior: Array

    @cached_property
    def places(self) -> dict[str, np.ndarray]:
        """Return {name: the places (s,) of its settings in the batch}."""
        result: dict[str, list[int]] = {}
        for place, name in enumerate(self.names):
            result.setdefault(name, []).append(place)
        return {name: np.array(places) for name, places in result.items()}

    def only(self, kept: Sequence[int]) -> Batch:
        """Return some of the candidates."""
        names, settings = tuple(self.names[i] for i in kept), tuple(self.settings[i] for i in kept)
        return Batch(self.rows[kept], self.gram[kept], names, settings, self.prior[kept])


@dataclass(frozen=True, eq=False)
class Candidates:
    """The candidates: columns (N, 3n) in units of what matters, their score bias (N,), and batches that use them."""

    columns: Array
    score_bias: Array
    batches: tuple[Batch, ...]

    @classmethod
    def of(cls, twin: Twin, names: Sequence[str], among: Iterable[Family] | None = None) -> Candidates:
        """Prepare the effects `names`, with coloured noise, and families (None: all that the recording allows)."""
        every = families(twin) if among is None else among
        courses = [_courses(twin, COLOUR in names)] if among is None else []
        return cls._of_parts(twin, [*_of_names(twin, names), *_of_families(twin, every), *courses])

    @classmethod
    def at(cls, twin: Twin, name: str, settings: Sequence[Setting]) -> Candidates:
        """Prepare one effect at some settings."""
        return cls._of_parts(twin, [_at_settings(twin, name, settings)])

    @classmethod
    def _of_parts(cls, twin: Twin, stacks: Sequence[Stack]) -> Candidates:
        """Build the candidates from whitened columns."""
        groups: dict[int, list[Part]] = {}
        first = 0
        for rows, _, parts in stacks:
            for part, name, setting, prior in parts:
                groups.setdefault(len(part), []).append((part + first, name, setting, prior))
            first += len(rows)
        if len(stacks) == 1:
            columns, score_bias, _ = stacks[0]  # many megabytes, which are not copied
        else:
            columns = np.concatenate([np.zeros((0, 3 * twin.n)), *(rows for rows, _, _ in stacks)])
            score_bias = np.concatenate([np.zeros(0), *(biases for _, biases, _ in stacks)])
        return cls(columns, score_bias, tuple(_batches(columns, groups)))

    def only(self, wanted: Callable[[str], bool]) -> Candidates:
        """Return the candidates of wanted names."""
        batches = []
        for batch in self.batches:
            kept = [i for i, name in enumerate(batch.names) if wanted(name)]
            if kept:
                batches.append(batch.only(kept))
        used = np.unique(np.concatenate([np.zeros(0, dtype=int), *(batch.rows.ravel() for batch in batches)]))
        batches = [replace(batch, rows=np.searchsorted(used, batch.rows)) for batch in batches]
        return Candidates(self.columns[used], self.score_bias[used], tuple(batches))


def _gram(columns: Array, places: np.ndarray) -> Array:
    """Return the Gram matrices (B, k, k) of columns (N, 3n) at places (B, k)."""
    count, width = places.shape
    result = np.empty((count, width, width))
    some = max(_AT_ONCE // max(width * columns.shape[1], 1), 1)
    for first in range(0, count, some):
        at = places[first : first + some].ravel()
        in_a_row = bool((np.diff(at) == 1).all())  # no copy is needed
        own = (columns[at[0] : at[-1] + 1] if in_a_row else columns[at]).reshape(-1, width, columns.shape[1])
        np.matmul(own, own.swapaxes(1, 2), out=result[first : first + some])
    return result


def _batches(columns: Array, groups: Mapping[int, Sequence[Part]]) -> Iterator[Batch]:
    for many in groups.values():
        rows = np.array([part for part, _, _, _ in many])
        yield Batch(
            rows,
            _gram(columns, rows),
            tuple(name for _, name, _, _ in many),
            tuple(setting for _, _, setting, _ in many),
            np.array([prior for _, _, _, prior in many]),
        )


def _of_names(twin: Twin, names: Sequence[str]) -> Iterator[Stack]:
    for name in (name for name in names if name in TERMS and not TERMS[name].missing(twin)):
        settings = TERMS[name].settings(twin)
        if settings:
            yield _at_settings(twin, name, settings)


def with_each_drift(model: Model, twin: Twin) -> tuple[list[Model], int]:
    """Return a model with each number of modes of its first irregular drift, ascending, and the place of the present.

    It is alone without a drift.
    """
    result: list[Model] = []
    for index, term in enumerate(model.terms):
        if term.name in _IRREGULAR and term.setting["order"]:
            fewer = 0
            for setting in irregular_drifts(twin):
                fewer += setting["order"] < term.setting["order"]
                terms = list(model.terms)
                terms[index] = Active(term.name, setting, np.zeros(3 * int(setting["order"])))
                result.append(model if setting == term.setting else replace(model, terms=tuple(terms)))
            return result or [model], max(min(fewer, len(result) - 1), 0)
    return [model], 0


def _at_settings(twin: Twin, name: str, settings: Sequence[Setting]) -> Stack:
    """Return the columns of an effect at some settings, which are equally probable."""
    made = [twin.columns(name, setting) for setting in settings]
    ends = np.cumsum([len(part.window) for part in made])
    places = np.split(np.arange(ends[-1]), ends[:-1])
    unit = np.concatenate(
        [what_matters(twin, name, s, len(p.window)) for s, p in zip(settings, made, strict=True)]
    )
    rows = np.empty((ends[-1], 3 * twin.n))
    some = max(_AT_ONCE * len(made) // rows.size, 1)
    for first in range(0, len(made), some):
        own = slice(places[first][0], ends[min(first + some, len(made)) - 1])
        np.multiply(twin.whiten(together(made[first : first + some])), unit[own, None], out=rows[own])
    score_bias = np.concatenate([part.bias for part in made])
    prior = -float(np.log(len(settings)))
    parts: list[Part] = [(place, name, setting, prior) for place, setting in zip(places, settings, strict=True)]
    return rows, score_bias * unit, parts


def what_matters(twin: Twin, name: str, setting: Setting, count: int) -> Array:
    """Return the smallest value that matters for each value (count,), SI; divided by k for mode k of a random walk."""
    term = TERMS[name]
    return np.broadcast_to(term.matters / term.deviations(twin, setting), (count,)) / modes(name, count)


def modes(name: str, count: int) -> Array:
    """Return the number of the mode of each value (count,) of a drift, three to a mode; 1 for any other effect."""
    return np.repeat(np.arange(1.0, count // 3 + 1), 3) if name in _DRIFTS else np.ones(count)


def _of_families(twin: Twin, among: Iterable[Family]) -> Iterator[Stack]:
    spacing = float(np.median(np.diff(twin.time)))
    for family in among:
        made = family.columns(twin)
        if made.link is None:
            size, matters = float(np.sqrt((made.window**2).mean())), PRIOR.profile_field
        else:
            size, matters = float(np.sqrt((made.link**2).mean())) / spacing, PRIOR.profile_rate
        unit = matters / max(size, 1e-300)
        rows = twin.whiten(made) * unit
        cut = [np.arange(first, first + width) for width in family.parts for first in range(0, len(rows), width)]
        cut = [part[part < len(rows)] for part in cut]
        whole = float(np.log(PRIOR.whole)) if cut else 0.0
        parts: list[Part] = [(np.arange(len(rows)), family.name, {}, whole)]
        share = float(np.log((1 - PRIOR.whole) / max(len(cut), 1)))
        parts += [(part, family.name, {"first": float(part[0])}, share) for part in cut]
        yield rows, made.bias * unit, parts


def _courses(twin: Twin, coloured: bool) -> Stack:
    """Return functions of time of the hard iron in the sensor's axes, with the spectra of the field variation.

    The fast ones are coloured noise, if that is a candidate; the others are an unknown effect. Beside coloured noise
    the fast ones are a part of it.
    """
    profiles, shapes = waves(twin.time, fewest(twin))
    fast = np.array(CORRELATION) <= RULES.longest_colour
    if twin.problem.colour is not None:
        shapes, fast = shapes[~fast], fast[~fast]
    rows = twin.whiten(Columns(per_axis(profiles), None)) * PRIOR.profile_field
    columns = np.concatenate([rows * np.repeat(shape, 3)[:, None] for shape in shapes])
    places = np.arange(len(columns)).reshape(len(shapes), -1)
    noise = (fast & coloured).tolist()
    parts: list[Part] = [
        (place, COLOUR if of_noise else COURSE, {"first": float(k)}, -float(np.log(noise.count(of_noise))))
        for k, (place, of_noise) in enumerate(zip(places, noise, strict=True))
    ]
    return columns, np.zeros(len(columns)), parts
