"""The fit of the model without effects, whose noise is that of the sensors from sample to sample."""

from __future__ import annotations

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.model.problem import Model, Problem
from magyc_gtsam.gap.model.refit import Refit, refit


class TooSmoothError(MagycError):
    """The noise from sample to sample is so much smaller than the misfit that the innovations have no covariance."""


def root(problem: Problem, model: Model) -> Refit:
    """Fit a model without effects.

    Raises:
        TooSmoothError: there is no fit, which without a term that may be out of range is due to the noise.
    """
    try:
        return refit(problem, model, None)
    except MagycError as error:
        raise TooSmoothError(str(error)) from error
