"""The values that `find_gap` returns. Terminal, page and tests read the same numbers from them."""

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
    "named", "ambiguous", "possible", "explained", "significant", "rejected", "not enough information"
]


@dataclass(frozen=True)
class Doubt:
    """The cause why a gap's calibration must not be used, and the remedy; at most 30 words together."""

    cause: str
    action: str

    @property
    def sentence(self) -> str:
        """Return cause and action in one sentence."""
        return f"{self.cause}: {self.action}"


@dataclass(frozen=True, eq=False)
class Effect:
    """An effect that was found and named.

    Attributes:
        name: the row of the catalogue, e.g. "timing".
        label: the name in words, e.g. "magnetometer delay".
        value, sigma: (k,) estimate and standard deviation in `unit`, one per parameter; of an effect that is corrected
            the deviation includes the model error.
        parameters: (k,) name of each parameter, e.g. ("x", "y", "z").
        unit: unit of the values: "ms", "µT", "µT/A", "mrad", ….
        setting: parameters found by a grid search: {"time": 41.5} s, {"frequency": 2.1} Hz, …; empty for most effects.
        ambiguous_with: names of rival effects that this motion cannot distinguish from it.
        statistic: Wald statistic of the values beside the other effects.
        applied: whether `gap.calibration` corrects the effect.
        sentence: one line for a navigator.
        probability: posterior probability that the effect is present, from the evidence of all sets of effects. It is
            at most 0.995, because the true cause may be outside all sets.
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
    applied: bool
    sentence: str
    probability: float = 1.0


@dataclass(frozen=True)
class Untested:
    """A candidate that could not be tested, and the reason."""

    name: str
    label: str
    reason: str


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One candidate and its evidence beside the model without effects.

    Attributes:
        name: name in the catalogue, or of a generic family (`generic` is then True).
        label: the name in words.
        generic: True for a family without physical meaning, which shows WHERE something is missing.
        evidence: gain in log evidence, nats, averaged over values and settings; beside the varying field of the
            place, if there is one.
        significant: whether that exceeds the odds against one more effect, 3.4 nats; of an effect on the noise, what
            noise alone reaches in one of a hundred recordings, and whether it has the form of the effect.
        parameters: number of parameters.
        expected, sigma: (k,) estimate and standard deviation if the effect were added, in `unit`.
        unit: unit of the values; empty for a generic family.
        setting: the best grid point.
        power: probability of finding the smallest value that matters, of the parameter that the motion determines
            least, averaged over the settings; NaN of a generic family and of an effect on the noise.
        matters: the smallest value that matters, in `unit`; NaN of the same.
        probability: posterior probability that the effect is present; NaN of a generic family.
        status: "named", "ambiguous" (a rival of a named effect), "possible" (a probability of 5 % or more, too little
            to be named), "explained" (significant, but improbable beside what was named), "significant" (but nothing
            was named), "rejected" (not significant, although it would have been found), "not enough information" (it
            would not have been found).
        sentence: the status in words.
    """

    name: str
    label: str
    generic: bool
    evidence: float
    significant: bool
    parameters: int
    expected: Array
    sigma: Array
    unit: str
    setting: Mapping[str, float]
    power: float
    matters: float
    probability: float
    status: Status
    sentence: str


@dataclass(frozen=True)
class Moved:
    """A parameter of the base model, before and after the effects were added."""

    name: str
    before: float
    after: float
    sigma: float
    unit: str

    @property
    def sigmas(self) -> float:
        """Return the change in standard deviations, (after − before) / sigma."""
        return (self.after - self.before) / self.sigma if self.sigma > 0 else 0.0


@dataclass(frozen=True)
class Assumption:
    """One assumption of the user's simulator, compared with the data.

    Attributes:
        what: the assumption, e.g. "magnetometer noise per sample", "hard iron x", "magnetometer delay".
        simulated, measured: the two values in `unit`; NaN if one of the recordings lacks the channel.
        sigma: standard deviation of the difference, in `unit`.
        rejected: whether the difference is significant (family-wise 1 %), or only one recording has the effect.
        sentence: the result in words.
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
        """Return whether both recordings could show it."""
        return math.isfinite(self.measured)


@dataclass(frozen=True)
class Manoeuvre:
    """A motion that would distinguish rival effects, or show an effect that this motion cannot show.

    Attributes:
        separates: names of those effects.
        motion: the motion, in words for the helmsman.
        sentence: both in one sentence.
    """

    separates: tuple[str, ...]
    motion: str
    sentence: str


@dataclass(frozen=True, eq=False, repr=False)
class Gap:
    """The result of `find_gap`.

    Attributes:
        verdict: "none" (nothing probable), "closed" (effects were named and added, and nothing significant is left;
            or a given calibration did not fit and was fitted again), "unknown" (something outside the catalogue is
            missing; nothing was changed), "open" (effects were named, but not or not fully corrected), "not enough
            information" (the motion does not determine the twelve parameters, or there is no noise to measure a misfit
            against; nothing was tested or changed).
        sentence: the verdict, for a navigator.
        effects: the effects found: those corrected beforehand, of the model, of single samples, and a varying field.
        untested: candidates whose channel is missing.
        hypotheses: every candidate and generic family with its evidence beside the model without effects, strongest
            first.
        before, after: metrics of the base model and of the final one (the same object if nothing was added).
        moved: parameters of the base model that the effects moved, largest change first; for a given calibration, the
            parameters that the data contradict.
        calibration: the calibration with the effects as `terms`; the base calibration if nothing was added. If there is
            a `doubt`, it is not `trusted` and is not exported.
        base: the twelve-parameter calibration with which the search began (with the order of the axes, if that was
            corrected first).
        assumptions: assumptions of the user's simulator, if one was given.
        next_manoeuvre: the motion that would tell more; None if there is nothing to distinguish.
        doubt: why the calibration must not be used, and the remedy; None if it may be used.
        probabilities: posterior probability of every name, of "field-variation" (the field of the place varies), of
            "unknown" (something outside the catalogue, at least 0.005) and of "nothing"; empty if nothing was tested.
        diagnostics: details of the run: "windows", "seconds", "leftover", "left_out" (faults of sensors), …
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
        """Return the names of the effects found."""
        return tuple(effect.name for effect in self.effects)

    def plot(self) -> Any:
        """Draw the prediction before and after, and where the gap is, as a matplotlib figure."""
        return _notebook().plot_gap(self)

    def __repr__(self) -> str:
        return f"Gap({self.verdict!r}, {list(self.names)})"

    def _repr_html_(self) -> str:
        text: str = _notebook().html_of(self)
        return text


def _notebook() -> Any:
    """Return the module that draws; it is in a higher layer and is imported on demand."""
    return importlib.import_module("magyc_gtsam.report.notebook")


@dataclass(frozen=True)
class Isolability:
    """One row of the isolability table: how well a motion shows one effect.

    Attributes:
        name, label: the effect.
        smallest: the value that would be found with probability 0.9 if it were the least determined of the effect's, in
            `unit`; infinite if the effect needs a channel that is absent, or the motion does not determine it.
        unit: unit of `smallest` and `matters`.
        matters: the smallest value that matters, in `unit`.
        left: share of the effect's signature that the base parameters cannot absorb, 0 to 1.
        nameable: whether an effect of size `matters` would be found and distinguished from all rivals.
        confused_with: {name: share of the cases} of names given instead of its own, or beside it, in most cases at the
            larger of `smallest` and `matters`.
        sentence: the result in words.
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
