"""Drift between the clocks of the two sensors: not an effect of the catalogue, but detected and reported."""

from __future__ import annotations

from magyc_gtsam.estimators.smoother.clock_drift import drift_is_significant
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.factors.chain.chain_values import DELAY
from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.result import Doubt

CLOCK_DRIFT = "clock-drift"
APART = "the delay grows with time: the clocks of the two sensors drift apart; `calibrate` says by how much"
APART_IN_BRIEF = Doubt("the clocks of the two sensors drift apart", "run `mg.calibrate`, which follows the drift")


def drift_apart(current: Refit) -> bool:
    """Return whether the delay of a model grows with time, by the test of `smoother`."""
    twin = current.twin
    if not twin.model.free[DELAY]:
        return False
    return drift_is_significant(
        Fit(twin.chain, twin.state, twin.chain.unweighted(), twin.reduced, twin.model.free)
    )
