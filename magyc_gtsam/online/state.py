"""The state of the online smoother: checked options, samples and belief, with the operations that its parts share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.model_error.component import Component
from magyc_gtsam.estimators.model_error.model_error import ModelError, model_error
from magyc_gtsam.estimators.smoother.fit import NEAR, Fit, begin, descend
from magyc_gtsam.estimators.smoother.known import known_of
from magyc_gtsam.estimators.smoother.noise_levels import adapt
from magyc_gtsam.estimators.smoother.options import SmootherOptions
from magyc_gtsam.estimators.smoother.preparation import preintegrate, short_term_noise
from magyc_gtsam.estimators.smoother.search import (
    fit_field_chain,
    refit_field_chain,
    shortened,
    skew_prior,
    with_skew,
)
from magyc_gtsam.estimators.smoother.skew import SkewPriorFact, skew_of, widened
from magyc_gtsam.estimators.smoother.skew_prior import SkewPrior
from magyc_gtsam.estimators.smoother.smoother import calibration_of
from magyc_gtsam.factors.chain.chain_values import DELAY, PARAMETERS
from magyc_gtsam.factors.chain.facts import Fact, LinearFact
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.online.belief import FIRST, Belief, Estimate
from magyc_gtsam.online.buffers import SampleBuffer
from magyc_gtsam.online.marginal import BIAS, HARD_IRON, ContinuedChain
from magyc_gtsam.recording import Array, Recording

_NOISE_WINDOWS = 60  # fewest windows after a step for which noise levels are estimated
# Options of the batch method that need the whole recording, or channels that no stream has.
_NOT_ONLINE = ("gyroscope_scale", "soft_iron_walk", "heading", "declination")


@dataclass(frozen=True, kw_only=True)
class OnlineOptions(SmootherOptions):
    """The options of the online smoother: those of `SmootherOptions` that a stream allows, and its own.

    A known `clock_drift` counts from the first sample of the magnetometer, a `prior` is used until a step in hard iron
    is found, the dip of `field` is not used, because the vertical is unknown, and a `misalignment` is estimated at
    every refit and when a result is read.

    Attributes:
        hard_iron_drift, gyro_bias_drift: random walk of the hard iron, T per √h, and of the gyroscope bias, rad/s per
            √h, while it runs.
        detect_changes: whether to look for steps in hard iron.
        angular_rate_is: as in `Recording`.
        horizon: duration of the samples that are kept for refits, s.

    Raises:
        MagycError: an option is out of range.
    """

    hard_iron_drift: float = 0.0
    gyro_bias_drift: float = 0.0
    detect_changes: bool = True
    angular_rate_is: Literal["instant", "interval-mean"] = "instant"
    horizon: float = 3600.0

    def __post_init__(self) -> None:
        if self.angular_rate_is not in ("instant", "interval-mean"):
            raise MagycError(
                f"angular_rate_is: must be 'instant' or 'interval-mean', got {self.angular_rate_is!r}"
            )
        for name, least in (
            ("hard_iron_drift", 0.0),
            ("gyro_bias_drift", 0.0),
            ("hard_iron_walk", 0.0),
            ("horizon", 120.0),
        ):
            value = getattr(self, name)
            if isinstance(value, (bool, str)) or not least <= value < np.inf:
                raise MagycError(f"{name}: must be a finite number of at least {least:g}, got {value!r}")
        if self.prior is None and self.hard_iron_walk:
            raise MagycError(
                "hard_iron_walk: what may have changed since an earlier calibration; give that calibration too "
                "(prior=), or hard_iron_drift for a hard iron that changes all the time"
            )
        super().__post_init__()

    @classmethod
    def names(cls) -> frozenset[str]:
        """Return the names of the options that may be given."""
        return frozenset(cls.__dataclass_fields__.keys() - set(_NOT_ONLINE))

    @property
    def without_prior(self) -> OnlineOptions:
        """The options without the earlier calibration."""
        return replace(self, prior=None, hard_iron_walk=0.0)

    def free(self, parameters: Array) -> np.ndarray:
        """Return (p,) bool: the estimated parameters of θ (p,); a misalignment is held between two refits."""
        free = np.arange(len(parameters)) < PARAMETERS
        free[DELAY] = self.delay is None
        return free

    @property
    def walks(self) -> tuple[tuple[slice, float], ...]:
        """The parameters that walk at random, and by how much per √h."""
        every = ((HARD_IRON, self.hard_iron_drift), (BIAS, self.gyro_bias_drift))
        return tuple((rows, walk) for rows, walk in every if walk)


class SmootherState:
    """The samples and the belief of the online smoother, and the operations on both that its parts share."""

    def __init__(self, settings: OnlineOptions) -> None:
        self.settings = settings
        interval_mean = settings.angular_rate_is == "interval-mean"
        self.buffer = SampleBuffer(settings.window, settings.turn or 0.4, interval_mean)
        self.belief = Belief()

    @property
    def last(self) -> Estimate:
        """The last estimate, which must exist."""
        assert self.belief.estimate is not None
        return self.belief.estimate

    @property
    def delay(self) -> float:
        """The magnetometer's lag as far as it is known, s."""
        estimate = self.belief.estimate
        return float(self.settings.delay or 0.0) if estimate is None else float(estimate.parameters[DELAY])

    @property
    def prior_applies(self) -> bool:
        """Whether the earlier calibration applies: the hard iron has not changed, and the past does not contain it."""
        return self.settings.prior is not None and self.belief.past is None and not self.belief.changes

    @property
    def fit_options(self) -> SmootherOptions:
        """The options of a fit of all samples kept, as by the batch method."""
        return self.settings if self.prior_applies else self.settings.without_prior

    def facts(self, size: int = PARAMETERS) -> tuple[Fact, ...]:
        """Return the prior knowledge as facts about θ (size,)."""
        if not self.prior_applies:
            return ()
        known = known_of(self.settings)
        return known.facts if known.skew is None or size == PARAMETERS else (*known.facts, known.skew)

    @property
    def skew(self) -> tuple[SkewPrior | None, LinearFact | None]:
        """The prior of a misalignment, and the fact of an earlier calibration about it; None for each if absent.

        The fact is omitted once it is contained in the past.
        """
        known = known_of(self.settings)
        return skew_prior(self.settings, known), known.skew if self.prior_applies else None

    def with_misalignment(self, fit: Fit) -> Fit:
        """Return a continued fit with the misalignment from all windows."""
        prior, _ = self.skew
        if prior is None or fit.skew is not None or not isinstance(fit.chain, ContinuedChain):
            return fit
        wide = widened(fit, prior)
        widening = replace(fit, noise_freedom=self.last.noise_freedom).widening
        skew = skew_of(wide, prior, self.last.colour * widening)
        if skew.decided and self.belief.doubt:
            skew = replace(skew.undecided(), doubt=self.belief.doubt)
        return replace(fit, skew=skew)

    def numbers(self, first: int = 0) -> Array:
        """Return the ascending numbers of the windows kept and taken, from `first` on."""
        numbers = self.buffer.numbers
        return np.unique(numbers[slice(*np.searchsorted(numbers, [first, self.belief.done]))])

    def recording(self, stop: int | None, first: int | None = None) -> Recording:
        """Return the samples of the windows from `first` up to `stop`; None for no limit."""
        magnetometer, gyroscope = self.buffer.between(first, stop, self.delay)
        return Recording.from_streams(magnetometer, gyroscope, angular_rate_is=self.settings.angular_rate_is)

    def fit_tail(self, stop: int) -> Fit:
        """Fit the tail up to window `stop`, given the head."""
        estimate = self.last
        samples = self.buffer.windows(self.belief.tail, stop, self.delay)
        windows = samples.integrate(estimate.parameters[BIAS], self.delay)
        chain = ContinuedChain(windows, estimate.noise, self.belief.head)
        fit = begin(chain, estimate.parameters, self.settings.free(estimate.parameters))
        return adapt(descend(fit, NEAR), self.settings.reject, None)

    def close(self) -> None:
        """Move the head to the past, and drop its samples."""
        belief = self.belief
        belief.given_up += int(np.searchsorted(self.numbers(), belief.tail))
        belief.past = belief.head
        self.buffer.keep_from(belief.tail, self.delay)

    def begin_at(self, number: int) -> None:
        """Drop everything before a window, as if the log began with it."""
        belief, buffer = self.belief, self.buffer
        belief.given_up += int(np.searchsorted(self.numbers(), number))
        last = buffer.magnetometer.time[int(np.searchsorted(buffer.numbers, belief.done)) - 1]
        buffer.begin_at(number, self.settings.window)
        belief.done = int(buffer.numbers[np.searchsorted(buffer.magnetometer.time, last)])
        belief.past = belief.head = belief.front = None
        belief.estimate = belief.refitted = belief.report = belief.drift = belief.unexplained = None
        belief.next_refit = belief.next_search = FIRST
        belief.stable = belief.settled = belief.undecided = belief.waiting = False
        belief.doubt, belief.contradictions = "", []

    def result(
        self,
        recording: Recording,
        fit: Fit,
        first: int = 0,
        refitted: Estimate | None = None,
        change: Component | None = None,
        doubts: Sequence[str] = (),
    ) -> Calibration:
        """Return the calibration of a fit.

        Args:
            recording: the samples of the fit.
            fit: the fit.
            first: number of its first window.
            refitted: the last refit, whose noise levels hold if the fit is that of a tail.
            change: error by a change of the iron that the newest windows do not exclude.
            doubts: reasons for distrust known before.
        """
        colour = None if refitted is None else refitted.colour
        unexplained = None if refitted is None else self.belief.unexplained
        if self.settings.walks and refitted is not None:  # the random walk covers what the model does not explain
            unexplained = ModelError(np.zeros_like(refitted.covariance))
        if refitted is not None:
            fit = replace(self.with_misalignment(fit), noise_freedom=refitted.noise_freedom)
        if change is not None:
            unexplained = (model_error(fit, self.buffer) if unexplained is None else unexplained).beside(change)
        options = self.settings.without_prior if self.belief.changes else self.settings
        result = calibration_of(
            recording, fit, options, colour, doubts, unexplained=unexplained, samples=self.buffer
        )
        windows = self.belief.given_up + int(np.searchsorted(self.numbers(), first)) + len(fit.chain.windows)
        configuration = dict(self.settings.configuration)
        return replace(result, diagnostics={**result.diagnostics, "windows": windows}, configuration=configuration)


def continued(fit: Fit) -> ContinuedChain:
    """Return the chain of a fit as a `ContinuedChain`, without the prior of a misalignment, which is not a fact."""
    chain = fit.chain
    facts = tuple(fact for fact in chain.facts if not isinstance(fact, SkewPriorFact))
    if isinstance(chain, ContinuedChain):
        return replace(chain, facts=facts)
    return ContinuedChain(chain.windows, chain.noise, facts=facts)


def observable(calibration: Calibration) -> bool:
    """Return whether the motion determined the calibration."""
    return calibration.observability is not None and calibration.observability.observable


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
