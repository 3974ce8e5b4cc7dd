"""Scoring of a blind test: open the sealed truth, judge every diagnosis, and count the confusions."""

from __future__ import annotations

import json
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from magyc_gtsam.blindtest.scenarios import Scenario
from magyc_gtsam.blindtest.sealing import MANIFEST, RESULTS, opened
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.simulation.effects import FOREIGN, NAMED

RIGHT, IN_SET, PARTIAL, EXTRA, WRONG, UNKNOWN, SILENT, REFUSED, CRASHED = OUTCOMES = (
    "right",
    "in its set",
    "partial",
    "one too many",
    "wrong",
    "unknown",
    "silent",
    "refused",
    "crashed",
)
SEVERAL, NOTHING = "several names", "nothing"
# Probability from which a real recording may have an effect without one being put in: the truth of a statement about it
# is then not known.
_POSSIBLE = 0.05
# Without a thermometer what warms is equivalent to a slow drift.
_FAIR_WITHOUT_CHANNEL = {
    "temperature-hard-iron": ("hard-iron-drift",),
    "temperature-gain": ("gain-drift",),
    "temperature-gyro": ("gyro-bias-drift",),
}
# Consequences that may be named in addition: the readings of a free-running magnetometer are half a log period old on
# average, and the ripple of a motor controller's current, which the current sensor does not follow, is a tone.
_CONSEQUENCE = {"sample-hold": ("timing",), "motor-current": ("tone",), "current-squared": ("tone",)}


@dataclass(frozen=True)
class Outcome:
    """The truth and the diagnosis of one recording.

    Attributes:
        number: number of the recording.
        scenario: the hidden effects.
        verdict: verdict of the diagnosis, "refused" or "crashed".
        named: the effects named, each with its ambiguity set.
        kind: one of `OUTCOMES`: "wrong" if a name and its set miss the truth, "one too many" if the truth is named
            again by a name whose set contains it.
        sentence: the diagnosis as a sentence.
        excess: variance of the open-loop error beyond its floor, before and after, relative to the floor's.
        heading: systematic heading error before and after, deg; None if not computed.
        seconds: processor time of the diagnosis.
        stands_out: how far the effect stands out of the noise, sigmas; None if not computed.
        probabilities: stated probabilities of each name, of "unknown" and of "nothing"; of a real recording with an
            injected effect, of those names whose truth is known.
    """

    number: str
    scenario: Scenario
    verdict: str
    named: tuple[Named, ...]
    kind: str
    sentence: str
    excess: tuple[float, float] | None
    heading: tuple[float, float] | None
    seconds: float
    stands_out: float | None = None
    probabilities: Mapping[str, float] = field(default_factory=dict)

    @property
    def said(self) -> str:
        """The names, or the kind of the outcome if no effect was named."""
        if self.verdict in (UNKNOWN, REFUSED, CRASHED) or not self.named:
            return self.kind
        return " + ".join(name for name, _ in self.named)


Named = tuple[str, tuple[str, ...]]  # a name and its ambiguity set
Already = dict[str, frozenset[str]]  # the effects present in an unchanged real recording, each with its rivals
Heading = Callable[[Scenario, dict[str, Any]], tuple[float, float] | None]
Visibility = Callable[[Scenario], float | None]


def score(
    folder: Path,
    heading: Heading = lambda *_: None,
    standing: Visibility = lambda _: None,
    progress: Callable[[float], None] = lambda _: None,
) -> list[Outcome]:
    """Return the outcomes of all diagnosed recordings, in the order of the scenarios.

    Args:
        folder: folder of the blind test.
        heading: computes the heading error before and after, as `heading.heading_errors` does.
        standing: computes how far an effect stands out, as `detectability.stands_out` does.
        progress: called with the share done.

    Raises:
        MagycError: the folder holds no blind test, or its sealed files were changed.
    """
    target = folder / MANIFEST
    if not target.exists():
        raise MagycError(f"{folder}: holds no blind test ({MANIFEST} is missing)")
    manifest = json.loads(target.read_text(encoding="utf-8"))
    pairs = []
    for number in manifest["sha256"]:
        result = folder / RESULTS / f"{number}.json"
        if result.exists():
            truth = opened(folder, number, manifest)
            pairs.append((number, _scenario(truth), json.loads(result.read_text(encoding="utf-8"))))
    already: dict[str, Already] = {}
    uncertain: dict[str, set[str]] = {}
    for _, scenario, result in pairs:
        if scenario.set == "real" and not scenario.effects:
            there = already.setdefault(scenario.motion, {})
            for name, rivals in _there(result):
                there[name] = there.get(name, frozenset()) | set(rivals)
            stated = result.get("probabilities", {})
            uncertain.setdefault(scenario.motion, set()).update(n for n, p in stated.items() if p >= _POSSIBLE)
    outcomes = []
    for done, (number, scenario, result) in enumerate(pairs):
        there = already.get(scenario.motion, {})
        if there.keys().isdisjoint(scenario.names):  # otherwise it would be found anyway
            undecided = there.keys() | uncertain.get(scenario.motion, set()) | {UNKNOWN, NOTHING}
            outcomes.append(_outcome(number, scenario, result, there, undecided, heading, standing))
        progress((done + 1) / len(pairs))
    return sorted(outcomes, key=lambda o: o.scenario.id)


def _there(result: dict[str, Any]) -> list[Named]:
    """Return the effects in an unchanged real recording: those named with their sets, and the leftover ones."""
    leftover = result.get("diagnostics", {}).get("leftover", ())
    named = [(e["name"], tuple(e["ambiguous_with"])) for e in result["effects"]]
    return [*named, *((name, ()) for name in leftover)]


def beyond(named: Sequence[Named], hidden: Container[str], already: Already) -> tuple[Named, ...]:
    """Return the names that count as a diagnosis of an injected effect, without those present anyway.

    A name that the recording yields without injection is neither right nor wrong, and neither is a set that contains
    such a name which was not given itself. An exception is a set that contains the injected effect only since its
    injection.
    """
    unsaid = already.keys() - {name for name, _ in named}

    def counts(name: str, rivals: tuple[str, ...]) -> bool:
        if name in hidden or any(r in hidden and r not in already.get(name, ()) for r in rivals):
            return True
        return name not in already and unsaid.isdisjoint(rivals)

    return tuple(n for n in named if counts(*n))


def _scenario(truth: dict[str, Any]) -> Scenario:
    values = truth["scenario"]
    values["effects"] = tuple((name, factor) for name, factor in values["effects"])
    values["withheld"] = tuple(values["withheld"])
    return Scenario(**values)


def _outcome(
    number: str,
    scenario: Scenario,
    result: dict[str, Any],
    already: Already,
    undecided: Container[str],
    heading: Heading,
    standing: Visibility,
) -> Outcome:
    named = tuple((e["name"], tuple(e["ambiguous_with"])) for e in result["effects"])
    stated: dict[str, float] = result.get("probabilities", {})
    if scenario.set == "real" and scenario.effects:
        named = beyond(named, scenario.names, already)
        stated = {n: p for n, p in stated.items() if n in scenario.names or n not in undecided}
    verdict = result["verdict"]
    excess = None
    if "before" in result:
        loops = [result[when]["open_loop"] for when in ("before", "after")]
        floor = loops[0]["floor"] ** 2
        first, last = (max(loop["rms"] ** 2 - loop["floor"] ** 2, 0.0) / floor for loop in loops)
        excess = first, last
    accepted = any(e["applied"] for e in result["effects"]) and verdict not in (UNKNOWN, REFUSED, CRASHED)
    return Outcome(
        number,
        scenario,
        verdict,
        named,
        judged(scenario, verdict, named),
        result.get("sentence", ""),
        excess,
        heading(scenario, result) if accepted else None,
        float(result["cpu_seconds"]),
        standing(scenario),
        stated,
    )


def judged(scenario: Scenario, verdict: str, named: Sequence[Named]) -> str:
    """Return the kind of an outcome; see `Outcome.kind`."""
    if verdict in (UNKNOWN, REFUSED, CRASHED):
        return verdict
    if verdict == "not enough information":
        return REFUSED
    if not named:
        return SILENT
    if scenario.set in ("none", "foreign"):
        return WRONG
    truth = list(scenario.names)
    if scenario.set == "withheld":
        # An effect whose channel is missing cannot be named, but may be called possible.
        truth += [fair for name in truth for fair in _FAIR_WITHOUT_CHANNEL.get(name, ())]
    beside = {also for name in truth for also in _CONSEQUENCE.get(name, ())} - set(truth)
    named = [n for n in named if n[0] not in beside]
    exact, extra = True, False
    remaining = list(truth)
    for name, rivals in sorted(named, key=lambda n: n[0] not in truth):
        hit = name if name in remaining else next((r for r in rivals if r in remaining), None)
        if hit is not None:
            exact &= hit == name
            remaining.remove(hit)
        elif name in truth or any(r in truth for r in rivals):
            extra = True
        else:
            return WRONG
    if extra:
        return EXTRA
    if remaining and scenario.set != "withheld":
        return PARTIAL
    return RIGHT if exact else IN_SET


def confusion(outcomes: Sequence[Outcome]) -> tuple[list[str], list[str], np.ndarray]:
    """Return rows (hidden effects), columns (diagnoses) and counts of the confusion matrix."""
    order = {name: i for i, name in enumerate((*NAMED, *FOREIGN))}

    def place(name: str) -> tuple[int, str]:
        return order.get(name, len(order)), name

    pairs = [(o.scenario.label, SEVERAL if len(o.named) > 1 and " + " in o.said else o.said) for o in outcomes]
    rows = sorted({hidden for hidden, _ in pairs}, key=place)
    last = [word for word in (SEVERAL, UNKNOWN, SILENT, REFUSED, CRASHED) if word in {said for _, said in pairs}]
    columns = [*sorted({said for _, said in pairs} - set(last), key=place), *last]
    counts = np.zeros((len(rows), len(columns)), dtype=int)
    for hidden, said in pairs:
        counts[rows.index(hidden), columns.index(said)] += 1
    return rows, columns, counts
