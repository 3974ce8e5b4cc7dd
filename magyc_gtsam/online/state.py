"""The state of the online smoother: checked options, samples and belief, with the operations that its parts share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.model_error.component import Component
from magyc_gtsam.estimators.model_error.model_error import ModelError, model_error
from magyc_gtsam.estimators.smoother.fit import NEAR, Fit, begin, descend
from magyc_gtsam.estimators.smoother.known import known_of
from magyc_gtsam.estimators.smoother.noise_levels import adapt
from magyc_gtsam.estimators.smoother.options import SmootherOptions
from magyc_gtsam.estimators.smoother.search import skew_prior
from magyc_gtsam.estimators.smoother.skew import SkewPriorFact, skew_of, widened
from magyc_gtsam.estimators.smoother.skew_prior import SkewPrior
from magyc_gtsam.estimators.smoother.smoother import calibration_of
from magyc_gtsam.factors.chain.facts import Fact, LinearFact
from magyc_gtsam.factors.chain.field_chain import DELAY, PARAMETERS
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.online.belief import FIRST, Belief, Estimate
from magyc_gtsam.online.buffers import SampleBuffer
from magyc_gtsam.online.marginal import BIAS, HARD_IRON, ContinuedChain
from magyc_gtsam.recording import Array, Recording

_OF_BATCH = ("noise", "robust", "delay", "window", "turn", "misalignment", "field")


@dataclass(frozen=True)
class OnlineOptions:
    """The options of `OnlineSmoother`, which documents them."""

    field_strength: float | None
    noise: tuple[float, float] | None
    robust: bool | None
    delay: float | None
    window: float
    turn: float | None
    clock_drift: float
    hard_iron_drift: float
    gyro_bias_drift: float
    detect_changes: bool
    angular_rate_is: Literal["instant", "interval-mean"]
    horizon: float
    prior: Calibration | Mapping[str, Any] | None
    hard_iron_walk: float
    misalignment: float | Literal["auto"]
    field: Any

    def __post_init__(self) -> None:
        _ = self.options
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

    @property
    def options(self) -> SmootherOptions:
        """The options as those of the batch method, checked."""
        return SmootherOptions(
            **self.fit, field_strength=self.field_strength, clock_drift=self.clock_drift, **self.known
        )

    @property
    def fit(self) -> dict[str, Any]:
        """The options that a fit of the batch method takes."""
        return {name: getattr(self, name) for name in _OF_BATCH}

    @property
    def known(self) -> dict[str, Any]:
        """The prior knowledge as options of the batch method."""
        return {} if self.prior is None else {"prior": self.prior, "hard_iron_walk": self.hard_iron_walk}

    @property
    def reject(self) -> bool:
        """Whether disturbed windows are downweighted."""
        return self.robust is not False

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
    def known(self) -> dict[str, Any]:
        """The prior knowledge as options of the batch method.

        It is empty once the hard iron has changed, or once it is contained in the past.
        """
        applies = self.belief.past is None and not self.belief.changes
        return self.settings.known if applies else {}

    def facts(self, size: int = PARAMETERS) -> tuple[Fact, ...]:
        """Return the prior knowledge as facts about θ (size,)."""
        if not self.known:
            return ()
        known = known_of(self.settings.options)
        return known.facts if known.skew is None or size == PARAMETERS else (*known.facts, known.skew)

    @property
    def skew(self) -> tuple[SkewPrior | None, LinearFact | None]:
        """The prior of a misalignment, and the fact of an earlier calibration about it; None for each if absent.

        The fact is omitted once it is contained in the past.
        """
        known = known_of(self.settings.options)
        return skew_prior(self.settings.options, known), known.skew if self.known else None

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
        belief.doubt = ""

    def result(
        self,
        recording: Recording,
        fit: Fit,
        rival: Fit | None = None,
        first: int = 0,
        refitted: Estimate | None = None,
        change: Component | None = None,
    ) -> Calibration:
        """Return the calibration of a fit.

        Args:
            recording: the samples of the fit.
            fit, rival: the fit and a close rival.
            first: number of its first window.
            refitted: the last refit, whose noise levels hold if the fit is that of a tail.
            change: error by a change of the iron that the newest windows do not exclude.
        """
        colour = None if refitted is None else refitted.colour
        unexplained = None if refitted is None else self.belief.unexplained
        if self.settings.walks and refitted is not None:  # the random walk covers what the model does not explain
            unexplained = ModelError(np.zeros_like(refitted.covariance))
        if refitted is not None:
            fit = replace(self.with_misalignment(fit), noise_freedom=refitted.noise_freedom)
        if change is not None:
            unexplained = (model_error(fit, self.buffer) if unexplained is None else unexplained).beside(change)
        result = calibration_of(
            recording, fit, rival, self.settings.options, colour, unexplained=unexplained, samples=self.buffer
        )
        windows = self.belief.given_up + int(np.searchsorted(self.numbers(), first)) + len(fit.chain.windows)
        return replace(result, diagnostics={**result.diagnostics, "windows": windows})


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
