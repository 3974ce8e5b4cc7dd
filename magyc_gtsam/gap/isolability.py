"""Which effects could be named with a motion, at what strength, and what they would be confused with."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.stats import ncx2

from magyc_gtsam.estimators.chain_search import short_term_noise
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.effects.term import EffectTerm
from magyc_gtsam.gap.find import base_model
from magyc_gtsam.gap.noise_isolability import noise_isolability
from magyc_gtsam.gap.result import Isolability
from magyc_gtsam.gap.score import Score, Variant, scan
from magyc_gtsam.gap.twin import Twin
from magyc_gtsam.recording import Recording

_POWER = 0.9
_SHARED = 0.8  # share of a signature from which it passes for another
_FEW = 12  # settings of a rival that are compared


def isolability(recording: Recording) -> tuple[Isolability, ...]:
    """The table for a motion: a recording of it, real or simulated, at the noise that it has.

    Raises:
        MagycError: the motion or the data do not allow a calibration at all.
    """
    noise = short_term_noise(recording)
    twin = base_model(recording, None, noise).twin
    scores, _, _ = scan(twin, tuple(TERMS), np.random.default_rng(0))
    named = {s.name: s for s in scores if not s.generic}
    terms = tuple(
        _row(term, named[name], named, twin) if name in named else _absent(term, term.missing(twin))
        for name, term in TERMS.items()
    )
    return (*terms, *noise_isolability(recording, noise.magnetometer))


def _row(term: EffectTerm, score: Score, named: dict[str, Score], twin: Twin) -> Isolability:
    typical = score.variants[len(score.variants) // 2]
    deviations = term.deviations(twin, typical.setting)
    shown = term.scale / float(np.median(deviations))
    rank = max(len(typical.unit), 1)
    needed = brentq(lambda size: ncx2.sf(score.threshold, rank, size) - _POWER, 1e-6, 50 * score.threshold + 1e3)
    # Of the parameters, the one in the middle: the weakest may be none that the motion touches.
    sigma = float(np.median(deviations * np.sqrt((typical.back**2).sum(axis=1))))
    smallest = float(np.sqrt(needed)) * sigma
    confused = {
        other.name: share
        for other in named.values()
        if other.name != term.name and (share := _overlap(typical, other)) > _SHARED
    }
    nameable = smallest <= term.matters and not confused
    words = f"from {smallest * shown:.2g} {term.unit} on"
    if confused:
        words += f", as {' or '.join((term.name, *confused))}, which this motion cannot tell apart; {term.motion}"
    elif not nameable:
        words += f", where {term.matters * shown:.2g} would matter; {term.motion}"
    return Isolability(
        term.name,
        term.label,
        smallest * shown,
        term.unit,
        term.matters * shown,
        typical.left,
        nameable,
        dict(sorted(confused.items(), key=lambda pair: -pair[1])),
        words,
    )


def _overlap(one: Variant, other: Score) -> float:
    """Largest share of a signature that a rival's columns hold, over a few of the rival's settings."""
    if not len(one.unit):
        return 1.0
    stride = max(len(other.variants) // _FEW, 1)
    few = other.variants[::stride]
    return max(float((one.unit @ v.unit.T * (one.unit @ v.unit.T)).sum()) / len(one.unit) for v in few)


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
