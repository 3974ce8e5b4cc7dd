"""Clocks of the two sensors that drift apart, noticed online by the test of the batch (`estimators.clock_drift`).

It is asked at every sweep, of all that is kept; and when something is read, if all of that is fitted and the sweep
before said nothing. Where the clocks keep step it costs one solve. Where they do not, the drift is measured by some ten
fits of what is kept: at sweeps, whose number grows with the logarithm of the time; at readings until the next sweep
only. A result that it harms has not converged: nothing is given up to a summary then, no step in hard iron is looked
for, and the oldest quarter goes when an hour is full, as always.

Once something has been given up (after an hour, or a step) what comes later is not tested: what is said is the drift of
the first hour, known to about a millionth by then. Nor is it tested where parameters walk.
"""

from __future__ import annotations

import numpy as np

from magyc_gtsam.estimators.chain_fit import Fit
from magyc_gtsam.estimators.chain_search import fit_field_chain
from magyc_gtsam.estimators.clock_drift import Drift, find_drift, slowed
from magyc_gtsam.online.kept import Kept
from magyc_gtsam.recording import Array, Recording, Samples

_LEAST = 80  # windows; noise levels from fewer are too uncertain


def on_one_clock(kept: Kept, magnetometer: Samples) -> Samples:
    """With the stamps that a known drift leaves."""
    m, drift = kept.memory, kept.settings.clock_drift
    if not drift or not len(magnetometer.time):
        return magnetometer
    if np.isnan(m.clock_start):
        m.clock_start = float(magnetometer.time[0])
    return Samples(slowed(magnetometer.time, m.clock_start, drift), magnetometer.value)


def testable(kept: Kept, windows: int) -> bool:
    """Whether so many windows are all there is, and enough."""
    return kept.memory.past is None and not kept.settings.walks and windows >= _LEAST


def drift_of(kept: Kept, recording: Recording, fit: Fit, trusted: bool) -> Drift | None:
    """What the clocks did in all that is kept, as `find_drift` says; None where they keep step."""

    def refit(again: Recording, start: Array | None) -> tuple[Fit, bool]:
        fit, rival = fit_field_chain(again, **kept.settings.fit, start=start)
        return fit, kept.result(again, fit, rival).converged

    known = kept.memory.drift
    drift = find_drift(recording, fit, trusted, refit, 0.0 if known is None else known.rate)
    return None if drift is None else drift._replace(known=kept.settings.clock_drift)
