"""What the online smoother reports of a fit: the calibration, its misalignment, and a drift of the clocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.calibration.noted import as_mounted
from magyc_gtsam.estimators.model_error.component import Component
from magyc_gtsam.estimators.model_error.model_error import ModelError, model_error
from magyc_gtsam.estimators.smoother.clock_drift import Drift, find_drift
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.marginal import ContinuedChain
from magyc_gtsam.estimators.smoother.reasons import disturbed_end
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.estimators.smoother.skew import skew_of, widened
from magyc_gtsam.estimators.smoother.smoother import calibration_of
from magyc_gtsam.online.state import Estimate, SmootherState
from magyc_gtsam.recording import Array, Recording

LEAST_STABLE = 80  # fewest windows for noise levels that are certain enough to look for steps and clock drift


def report_of(
    online: SmootherState,
    recording: Recording,
    fit: Fit,
    first: int = 0,
    refitted: Estimate | None = None,
    change: Component | None = None,
    doubts: Sequence[str] = (),
) -> Calibration:
    """Return the calibration of a fit.

    Args:
        online: the state of the smoother.
        recording: the samples of the fit.
        fit: the fit.
        first: number of its first window.
        refitted: the last refit, whose noise levels hold if the fit is that of a tail.
        change: error by a change of the iron that the newest windows do not exclude.
        doubts: reasons for distrust known before.
    """
    colour = None if refitted is None else refitted.colour
    unexplained = None if refitted is None else online.belief.unexplained
    if online.settings.walks and refitted is not None:  # the random walk covers what the model does not explain
        unexplained = ModelError(np.zeros_like(refitted.covariance))
    if refitted is not None:
        fit = replace(with_misalignment(online, fit), noise_freedom=refitted.noise_freedom)
    since = _iron_change(online, fit)
    for each in (change, since):
        if each is not None:
            unexplained = (model_error(fit, online.buffer) if unexplained is None else unexplained).beside(each)
    options = online.settings.without_prior if online.belief.changes else online.settings
    result = calibration_of(
        recording, fit, options, colour, doubts, unexplained=unexplained, samples=online.buffer
    )
    windows = online.belief.given_up + int(np.searchsorted(online.numbers(), first)) + len(fit.chain.windows)
    configuration = dict(online.settings.configuration)
    result = replace(result, diagnostics={**result.diagnostics, "windows": windows}, configuration=configuration)
    return as_mounted(result, recording)


def _iron_change(online: SmootherState, fit: Fit) -> Component | None:
    """Return the error by a change of the soft iron at the last step, if a fit goes on from what was before it."""
    continues = isinstance(fit.chain, ContinuedChain) and fit.chain.past is not None
    return online.belief.iron_change if continues else None


def with_doubt(calibration: Calibration, fit: Fit) -> Calibration:
    """Return the calibration of a reading, not trusted if the newest windows of its fit, that of a tail, are disturbed.

    Refits go on from theirs without this doubt: a step is looked for only after one that was trusted. A fit of all
    windows is not doubted, since `recent_change` covers what it would find: docs/online_measured.md has the figures.
    """
    doubt = disturbed_end(fit) if calibration.trusted else ""
    return replace(calibration, converged=False, message=doubt) if doubt else calibration


def with_misalignment(online: SmootherState, fit: Fit) -> Fit:
    """Return a continued fit with the misalignment from all windows."""
    prior, _ = online.skew
    if prior is None or fit.skew is not None or not isinstance(fit.chain, ContinuedChain):
        return fit
    wide = widened(fit, prior)
    widening = replace(fit, noise_freedom=online.last.noise_freedom).widening
    skew = skew_of(wide, prior, online.last.colour * widening)
    if skew.decided and online.belief.doubt:
        skew = replace(skew.undecided(), doubt=online.belief.doubt)
    return replace(fit, skew=skew)


def observable(calibration: Calibration) -> bool:
    """Return whether the motion determined the calibration."""
    return calibration.observability is not None and calibration.observability.observable


def testable(online: SmootherState, windows: int) -> bool:
    """Return whether the windows kept are the whole log and enough to test for clock drift."""
    return online.belief.past is None and not online.settings.walks and windows >= LEAST_STABLE


def drift_of(online: SmootherState, recording: Recording, fit: Fit, trusted: bool) -> Drift | None:
    """Return how the sensors' clocks drift apart in all windows kept, from `find_drift`; None if they do not.

    The test runs at every refit, and when a result is read if the last refit found no drift. It costs one solve without
    a drift, otherwise some ten fits. With a harmful drift the result has not converged: nothing is marginalised, and
    steps in hard iron are not looked for. Once windows have been marginalised (after an hour, or a step), and if
    parameters walk, later windows are not tested.
    """

    def fit_again(again: Recording, start: Array | None) -> tuple[Fit, Callable[[], bool]]:
        fit = fit_field_chain(again, online.fit_options, start=start, brief=True)
        return fit, lambda: report_of(online, again, fit).converged

    known = online.belief.drift
    drift = find_drift(recording, fit, trusted, fit_again, 0.0 if known is None else known.rate)
    return None if drift is None else drift._replace(known=online.settings.clock_drift)
