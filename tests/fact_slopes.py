"""The slope of a fact that depends on the directions of the chain, checked numerically."""

from dataclasses import replace

import numpy as np
import pytest

from magyc_gtsam.estimators.smoother.vertical import relinearised


def check_slope(fit, kind):
    """Compare the slope of the fact of a kind with differences in every parameter, the directions at their best."""

    def measured(parameters):
        state, reduced = fit.chain.settle(fit.state._replace(parameters=parameters), fit.weights)
        there, _ = relinearised(replace(fit, state=state, reduced=reduced))
        (found,) = (fact for fact in there.chain.facts if isinstance(fact, kind))
        return found

    centre = fit.state.parameters
    found = measured(centre)
    step = np.r_[np.full(6, 3e-8), np.full(3, 3e-8), np.full(3, 2e-5), 1e-4, np.full(3, 1e-4)]
    for k, size in enumerate(step):
        moved = np.zeros(16)
        moved[k] = size
        change = (measured(centre + moved).measured - measured(centre - moved).measured) / (2 * size)
        assert found.slope[k] * found.sigma * size == pytest.approx(change * size, rel=0.02, abs=3e-7), k
