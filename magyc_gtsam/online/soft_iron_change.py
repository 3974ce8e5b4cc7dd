"""Test of a change of the soft iron at a step in hard iron, as caused by steel or by a sensor that is mounted anew.

After a step the past marginal keeps its information on the soft iron; a wrong soft iron would bias the hard iron of
the following windows. The change δ (6) of the soft iron at the step is tested by the likelihood ratio between the fit
with the past's information on the soft iron and the fit without it: λ is χ² with 6 degrees of freedom if the soft iron
did not change.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.estimators.smoother.fit import NEAR, Fit, descend
from magyc_gtsam.online.marginal import ContinuedChain

SOFT_IRON = slice(0, 6)
# Smallest λ of a change: in 790 refits after jumps of the hard iron alone λ was 27 at most (58 in one refused log), in
# those after a change of the soft iron by 2 % it was 35 to 87 (docs/online.md).
LIMIT = 30.0


def soft_iron_changed(fit: Fit) -> bool:
    """Return whether the windows after a step contradict the soft iron estimated before it.

    Args:
        fit: fit of a `ContinuedChain`, at its minimum.
    """
    return likelihood_ratio(fit) > LIMIT * fit.colour


def likelihood_ratio(fit: Fit) -> float:
    """Return λ at the fit's weights and noise; 0 without information on the soft iron in the past."""
    chain = fit.chain
    if not isinstance(chain, ContinuedChain) or chain.past is None or not chain.past.information[SOFT_IRON].any():
        return 0.0
    information, gradient = chain.past.information[SOFT_IRON, SOFT_IRON], chain.past.gradient[SOFT_IRON]
    # The cost of the marginal without the soft iron is relative to its own minimum.
    least = -0.5 * float(gradient @ np.linalg.solve(information, gradient))
    without = replace(chain, past=chain.past.forget(SOFT_IRON))
    free = descend(replace(fit, chain=without, reduced=without.eliminate(fit.state, fit.weights)), NEAR)
    return 2 * (fit.reduced.cost - free.reduced.cost - least)
