"""Fit of all samples kept, as the batch method does it."""

from __future__ import annotations

from magyc_gtsam.estimators.smoother.fit import Fit, begin
from magyc_gtsam.estimators.smoother.options import SmootherOptions
from magyc_gtsam.estimators.smoother.preparation import preintegrate, short_term_noise
from magyc_gtsam.estimators.smoother.search import fit_field_chain, refit_field_chain, shortened, with_skew
from magyc_gtsam.factors.chain.chain_values import PARAMETERS
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.online.marginal import BIAS, ContinuedChain
from magyc_gtsam.online.state import SmootherState
from magyc_gtsam.recording import Array, Recording

_NOISE_WINDOWS = 60  # fewest windows after a step for which noise levels are estimated


def fit_batch(recording: Recording, start: Array | None, options: SmootherOptions) -> tuple[Fit, Preintegration]:
    """Return the fit and the windows, from `start` (13,) or without a start.

    Raises:
        MagycError: the axes of the sensors disagree, or there are too few data.
    """
    fit = fit_field_chain(recording, options, start=start)
    samples = preintegrate(recording, options.window, options.turn)
    if len(samples.starts) != len(fit.chain.windows):  # windows are shorter in disturbed stretches
        samples = preintegrate(recording, shortened(options.window), options.turn)
    return fit, samples


def fit_samples(online: SmootherState, recording: Recording, search: bool) -> tuple[Fit, Preintegration]:
    """Fit all samples kept, from the estimate or, for a search, without a start; return the fit and the windows."""
    belief, settings = online.belief, online.settings
    if belief.past is None:
        start = None if search or belief.estimate is None else belief.estimate.parameters
        return fit_batch(recording, start, online.fit_options)
    parameters, noise = online.last.parameters[:PARAMETERS], online.last.noise
    samples = online.buffer.windows(int(online.buffer.numbers[0]), belief.done, online.delay)
    fewer = len(samples.starts) < _NOISE_WINDOWS or settings.noise is not None
    short_term = None if fewer else short_term_noise(recording)
    windows = samples.integrate(parameters[BIAS], online.delay)
    initial = begin(
        ContinuedChain(windows, short_term or noise, belief.past), parameters, settings.free(parameters)
    )

    def refitted(fit: Fit) -> Fit:
        return refit_field_chain(samples, fit, settings.reject, short_term)

    fit, (prior, known) = refitted(initial), online.skew
    return fit if prior is None else with_skew(fit, refitted, prior, known), samples
