"""What `find_gap` returns: values only, so that terminal, page and tests read the same numbers."""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.gap.outcome.agreement import Metrics
from magyc_gtsam.recording import Array

Verdict = Literal["none", "closed", "unknown", "open", "not enough information"]
Status = Literal[
    "named", "ambiguous", "vetoed", "slight", "explained", "significant", "rejected", "not enough information"
]


@dataclass(frozen=True)
class Doubt:
    """Why a gap's calibration must not be used, and what to do, together of at most 30 words."""

    cause: str
    action: str

    @property
    def sentence(self) -> str:
        """Both."""
        return f"{self.cause}: {self.action}"


@dataclass(frozen=True, eq=False)
class Effect:
    """An effect that was found and named.

    Attributes:
        name: the row of the catalogue, e.g. "timing".
        label: the same in words, e.g. "magnetometer delay".
        value, sigma: (k,) in `unit`, one per parameter.
        parameters: (k,) what each value is, e.g. ("x", "y", "z").
        unit: of the values as shown: "ms", "µT", "µT/A", "mrad", ….
        setting: what was searched over: {"time": 41.5} s, {"frequency": 2.1} Hz, …; empty for most.
        ambiguous_with: names of rivals that this motion cannot tell from it.
        statistic, threshold: evidence when it was added: twice the gain in log-likelihood, and its 1 % level.
        applied: whether `gap.calibration` corrects it.
        sentence: one line that a navigator understands.
        probability: that it is there, by the evidence of all sets of effects; 0.985 at most, for what none of them
            holds. The name is given by score tests, and not corrected where it and what it may be instead are
            improbable.
    """

    name: str
    label: str
    value: Array
    sigma: Array
    parameters: tuple[str, ...]
    unit: str
    setting: Mapping[str, float]
    ambiguous_with: tuple[str, ...]
    statistic: float
    threshold: float
    applied: bool
    sentence: str
    probability: float = 1.0


@dataclass(frozen=True)
class Untested:
    """A candidate that could not be tested, and why."""

    name: str
    label: str
    reason: str


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One candidate and its evidence against the base model.

    Attributes:
        name: of the catalogue, or of a generic family (`generic` is then True).
        label: the same in words.
        generic: a family without physical meaning that says WHERE something is missing.
        statistic: twice the gain in log-likelihood, at the best grid point.
        threshold: its family-wise 1 % level, by the bootstrap of the twin.
        significant: whether it passes; an effect on the noise must be of its form as well.
        parameters: number of parameters.
        expected, sigma: (k,) the values to expect if it were added, in `unit`.
        unit: of them; empty for a generic family.
        setting: the best grid point.
        power: probability of finding the smallest effect that matters, `matters` in `unit`.
        held_out_gain: gain in log-likelihood on data it was not fitted to, nats; NaN where it was not tried.
        status: "named", "ambiguous" (a rival of a named effect), "vetoed" (no held-out gain, or its channel
            explains no more than it would at other times), "slight" (significant, but too small to be named),
            "explained" (significant until what was named, or is slight, is in the model), "significant" (and nothing
            was named), "rejected" (not significant although it would have been found), "not enough information"
            (would not have been found).
        sentence: the status in words.
    """

    name: str
    label: str
    generic: bool
    statistic: float
    threshold: float
    significant: bool
    parameters: int
    expected: Array
    sigma: Array
    unit: str
    setting: Mapping[str, float]
    power: float
    matters: float
    held_out_gain: float
    status: Status
    sentence: str


@dataclass(frozen=True)
class Moved:
    """A parameter of the base model and where the added effects moved it; `sigmas` by how many of its sigmas."""

    name: str
    before: float
    after: float
    sigma: float
    unit: str

    @property
    def sigmas(self) -> float:
        """(after − before) / sigma."""
        return (self.after - self.before) / self.sigma if self.sigma > 0 else 0.0


@dataclass(frozen=True)
class Assumption:
    """One assumption of the user's simulator against the data.

    Attributes:
        what: e.g. "magnetometer noise", "hard iron x", "timing".
        simulated, measured, sigma: in `unit`; sigma of the difference. NaN where one of the two recordings lacks the
            channel, and nothing was compared.
        rejected: whether the difference is significant (family-wise 1 %), or the effect was found in one alone.
        sentence: in words.
    """

    what: str
    simulated: float
    measured: float
    sigma: float
    unit: str
    rejected: bool
    sentence: str

    @property
    def compared(self) -> bool:
        """Whether both recordings could show it."""
        return math.isfinite(self.measured)


@dataclass(frozen=True)
class Manoeuvre:
    """The motion that would tell rivals apart, or find what this motion could not.

    `separates` are the names it is for, `motion` the words for the helmsman, `sentence` both.
    """

    separates: tuple[str, ...]
    motion: str
    sentence: str


@dataclass(frozen=True, eq=False, repr=False)
class Gap:
    """The result of `find_gap`.

    Attributes:
        verdict: "none" (nothing significant), "closed" (named, added, nothing significant left; or a calibration
            that was given did not fit, and was fitted anew), "unknown" (something is missing that is not in the
            catalogue; nothing was changed), "open" (named, but not or not wholly corrected), "not enough information"
            (the motion does not determine the twelve parameters, or there is no noise to measure a misfit against;
            nothing was tested or changed).
        sentence: the verdict, for a navigator.
        effects: what was found, in the order of adding.
        untested: candidates whose channel is missing.
        hypotheses: every candidate and generic family with its evidence against the base model, strongest
            first.
        before, after: metrics of the base model and of the final one (the same object where nothing was added).
        moved: parameters of the base model that the effects moved, most first; of a calibration that was given,
            those which the data contradict.
        calibration: with the effects as `terms`; the base calibration where nothing was added. Where `doubt` says
            that it must not be used, it is not `trusted`, and is not exported.
        base: the twelve-parameter calibration the search began with (and the order of the axes, where that was
            settled before).
        assumptions: of the user's simulator, where one was given.
        next_manoeuvre: None where there is nothing to tell apart.
        doubt: why the calibration must not be used, and what to do; None where it may be.
        probabilities: of every name, of "field-variation" (the field of the place varies), of "unknown" (something that
            is in no catalogue, and at least 0.015) and of "nothing"; empty where nothing was tested.
        diagnostics: about the run: "windows", "draws", "seconds", "leftover", "left_out" (faults of sensors), …
    """

    verdict: Verdict
    sentence: str
    effects: tuple[Effect, ...]
    untested: tuple[Untested, ...]
    hypotheses: tuple[Hypothesis, ...]
    before: Metrics
    after: Metrics
    moved: tuple[Moved, ...]
    calibration: Calibration
    base: Calibration
    assumptions: tuple[Assumption, ...] = ()
    next_manoeuvre: Manoeuvre | None = None
    doubt: Doubt | None = None
    probabilities: Mapping[str, float] = field(default_factory=dict)
    diagnostics: Mapping[str, Any] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects found."""
        return tuple(effect.name for effect in self.effects)

    def plot(self) -> Any:
        """The prediction before and after, and where the gap is, as a matplotlib figure."""
        return _notebook().plot_gap(self)

    def __repr__(self) -> str:
        return f"Gap({self.verdict!r}, {list(self.names)})"

    def _repr_html_(self) -> str:
        text: str = _notebook().html_of(self)
        return text


def _notebook() -> Any:
    """What draws, which lies above this module and is imported where it is asked for."""
    return importlib.import_module("magyc_gtsam.report.notebook")


@dataclass(frozen=True)
class Isolability:
    """One row of the isolability table: what a motion could tell about one effect.

    Attributes:
        name, label: the effect.
        smallest: the strength (length of the vector of values) that would be found with probability 0.9, in `unit`;
            infinite if it needs a channel that is absent, or the motion determines none of its values.
        unit: of it.
        matters: the smallest strength that matters, in `unit`.
        left: share of the effect's signature that the base parameters cannot absorb, 0 to 1.
        nameable: whether `matters` would be found and told from all rivals.
        confused_with: names that it gets instead of its own, or beside it, in most cases at the larger of
            `smallest` and `matters`, with the share of the cases.
        sentence: in words.
    """

    name: str
    label: str
    smallest: float
    unit: str
    matters: float
    left: float
    nameable: bool
    confused_with: Mapping[str, float]
    sentence: str
