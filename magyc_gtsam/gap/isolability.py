"""Effects that can be named with a motion, their smallest strength, and the effects they would be confused with.

The strength is of the value that the motion determines least, as in a result's `Hypothesis.power`. Values of that
length and of random directions, with the noise of the sensors, are weighed like a recording's; an effect is confused
with the names that often explain nearly as much, or more.
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.one_thread import one_thread
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.effects.term import EffectTerm
from magyc_gtsam.gap.evidence.beside import Beside
from magyc_gtsam.gap.evidence.candidates import Candidates
from magyc_gtsam.gap.evidence.detectable import ENOUGH, found_from
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.weighing import Weighed, information_of, nats_by_scale, weigh
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.result import Isolability
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.noise_isolability import noise_isolability
from magyc_gtsam.recording import Recording

_TRIALS = 60  # of naming an effect
_AS_GOOD = 3.0  # nats: a twentieth of the probability


@one_thread
def isolability(recording: Recording) -> tuple[Isolability, ...]:
    """Return the table for a motion.

    Args:
        recording: of the motion, real or simulated, with its noise.

    Raises:
        MagycError: the motion or the data do not allow a calibration.
    """
    noise = short_term_noise(recording)
    twin = base_model(recording, None, noise).twin
    candidates, beside = Candidates.of(twin, tuple(TERMS), ()), Beside.of_model(twin)
    trials, weighed = _Trials.of(candidates, beside), weigh(candidates, beside)
    random = np.random.default_rng(0)
    terms = tuple(
        _row(term, trials, weighed[name], twin, random) if name in weighed else _absent(term, term.missing(twin))
        for name, term in TERMS.items()
    )
    return (*terms, *noise_isolability(recording, noise.magnetometer))


class _Trials(NamedTuple):
    """Candidates beside the model without effects.

    Attributes:
        candidates: the effects.
        beside: the model.
        reach: (N, m) of the candidates' columns.
        spectra: eigenvalues (B, k) and eigenvectors (B, k, k) of the information, for each batch of candidates.
    """

    candidates: Candidates
    beside: Beside
    reach: Array
    spectra: list[tuple[Array, Array]]

    @classmethod
    def of(cls, candidates: Candidates, beside: Beside) -> _Trials:
        reach = beside.see(candidates.columns, np.zeros(len(candidates.columns))).reach
        every = (np.linalg.eigh(information_of(batch, beside.noise, reach)) for batch in candidates.batches)
        return cls(candidates, beside, reach, [(np.maximum(value, 0.0), vector) for value, vector in every])

    def weighed(self, innovations: Array) -> dict[str, Array]:
        """Return {name: nats (trials,)} of innovations (trials, 3n)."""
        seen = self.beside.see(innovations, np.zeros(len(innovations))).reach
        score = self.candidates.columns @ innovations.T - self.reach @ seen.T
        result: dict[str, Array] = {}
        for batch, (value, vector) in zip(self.candidates.batches, self.spectra, strict=True):
            each = nats_by_scale(batch.names, value, np.einsum("bki,bkt->bit", vector, score[batch.rows]))
            for i, name in enumerate(batch.names):
                own = np.logaddexp.reduce(each[i], axis=0) + batch.prior[i] - np.log(len(PRIOR.scales))
                result[name] = np.logaddexp(result[name], own) if name in result else own
        return result


def _row(
    term: EffectTerm, trials: _Trials, weighed: Weighed, twin: Twin, random: np.random.Generator
) -> Isolability:
    batches = trials.candidates.batches
    every = ((b.rows[i], b.settings[i]) for b in batches for i in b.places.get(term.name, ()))
    ordered = sorted(every, key=lambda one: one[0][0])  # as in the effect's grid
    rows, setting = ordered[len(ordered) // 2]
    columns, reach = trials.candidates.columns[rows], trials.reach[rows]
    gram = columns @ columns.T
    left = np.maximum(np.diag(gram - reach @ reach.T), 0.0) / np.maximum(np.diag(gram), 1e-300)
    smallest = found_from(term.name, weighed.everywhere)
    confused: dict[str, float] = {}
    if np.isfinite(smallest):
        values = random.standard_normal((_TRIALS, len(rows)))
        values /= np.linalg.norm(values, axis=1)[:, None]
        confused = _confused(term.name, trials, max(smallest, 1.0) * values @ columns, random)
    matters = term.matters * term.scale / float(np.median(term.deviations(twin, setting)))
    words = (
        f"from {smallest * matters:.2g} {term.unit} on" if np.isfinite(smallest) else "not found at any strength"
    )
    if smallest > 1:
        words += f", where {matters:.2g} would matter"
    if confused:
        words += f", as {' or '.join((term.name, *confused))}, which this motion can hardly tell apart"
    nameable = smallest <= 1 and not confused
    return Isolability(
        term.name,
        term.label,
        smallest * matters,
        term.unit,
        matters,
        float(np.sqrt(left.mean())),
        nameable,
        confused,
        words if nameable else f"{words}; {term.motion}",
    )


def _confused(name: str, trials: _Trials, signatures: Array, random: np.random.Generator) -> dict[str, float]:
    """Return the other names that explain an effect nearly as well as the best, with their share of the trials.

    Only names above `RULES.confused` are returned, the most frequent first.

    Args:
        name: of the effect.
        trials: the effects.
        signatures: (trials, 3n) of the effect, whitened.
        random: source of the noise.
    """
    nats = trials.weighed(signatures + random.standard_normal(signatures.shape))
    best = np.max(list(nats.values()), axis=0)
    seen = best > ENOUGH
    as_good = {other: int((seen & (each > best - _AS_GOOD)).sum()) for other, each in nats.items()}
    # A general case with the values of the special one is not named.
    others = [other for other in nats if other != name and name not in TERMS[other].contains]
    often, count = Counter({other: as_good[other] for other in others}), int(seen.sum())
    return {other: times / count for other, times in often.most_common() if times > RULES.confused * count}


def _absent(term: EffectTerm, missing: tuple[str, ...]) -> Isolability:
    return Isolability(
        term.name,
        term.label,
        float("inf"),
        term.unit.replace("per unit", "per deviation"),
        term.matters * term.scale,
        0.0,
        False,
        {},
        f"cannot be tested without {' and '.join(missing) or 'more data'}",
    )
