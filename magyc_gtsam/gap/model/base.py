"""The model without effects: the calibration alone at its minimum, and again with the noise of the sensors alone."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.preparation import preintegrate
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.factors.chain.chain_values import DELAY, PARAMETERS, SensorNoise
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.model.problem import Active, Model, Problem
from magyc_gtsam.gap.model.refit import Refit, refit
from magyc_gtsam.gap.preparation.discrete import moving
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.recording import Recording


def needs_gyroscope(recording: Recording) -> None:
    """Check that the recording has a gyroscope, from whose turns the field is predicted.

    Raises:
        MagycError: the recording has no gyroscope.
    """
    if recording.angular_rate is None:
        raise MagycError(
            f"recording {recording.name!r} has no angular rate, along whose turns the field is predicted; name the "
            "gyroscope's topic or columns"
        )


def problem_of(recording: Recording) -> Problem:
    """Return the windows of a recording that a model has to explain, with few samples while the sensor rests."""
    recording = moving(recording)
    return Problem.of(recording, preintegrate(recording, RULES.window))


def base_model(recording: Recording, calibration: Calibration | None, short_term: SensorNoise) -> Refit:
    """Fit the twelve parameters; with the delay and the terms of a calibration, if one is given."""
    delay = 0.0 if calibration is None else calibration.delay
    still = moving(recording)
    fit = fit_field_chain(still, robust=False, delay=delay)
    if not fit.converged:
        # An effect as large as the field is missing. With the field strength as noise level there is one minimum.
        field = float(np.median(np.linalg.norm(still.magnetometer.value, axis=1)))
        fit = fit_field_chain(still, robust=False, delay=delay, noise=(field, short_term.gyroscope))
    free = np.ones(PARAMETERS, dtype=bool)
    terms: tuple[Active, ...] = ()
    if calibration is not None:
        terms = tuple(
            Active(t.name, t.setting, t.value)
            for t in calibration.terms
            if t.side is not None and t.name != "tone"  # which is taken out of the readings
        )
        if delay and not any(term.name == "timing" for term in terms):
            # The delay of `calibrate` may be due to another effect, and is estimated again.
            terms = (*terms, Active("timing", {}, np.array([delay])))
    free[DELAY] = any(term.name == "timing" for term in terms)
    return refit(problem_of(recording), Model(fit.state.parameters, free, fit.chain.noise, terms), short_term)


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
