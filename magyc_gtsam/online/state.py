"""The state of the online smoother: checked options, samples and belief, with the operations that its parts share."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.model_error.component import Component
from magyc_gtsam.estimators.model_error.model_error import ModelError
from magyc_gtsam.estimators.smoother.clock_drift import Drift, slowed
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.known import known_of
from magyc_gtsam.estimators.smoother.marginal import BIAS, HARD_IRON, ContinuedChain, Marginal, fitted
from magyc_gtsam.estimators.smoother.options import SmootherOptions
from magyc_gtsam.estimators.smoother.search import skew_prior
from magyc_gtsam.estimators.smoother.skew_prior import SkewPrior
from magyc_gtsam.factors.chain.chain_values import DELAY, PARAMETERS, SensorNoise
from magyc_gtsam.factors.chain.facts import Fact, LinearFact
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import is_finite
from magyc_gtsam.online.buffers import SampleBuffer
from magyc_gtsam.online.engine import Change
from magyc_gtsam.recording import Array, Recording, Samples
from magyc_gtsam.recording.axes import OWN_AXES
from magyc_gtsam.storage.json_types import from_typed_json, typed_json

FIRST = 12  # windows before the first fit
LEAST_RESTARTED = 80  # fewest windows that are fitted by themselves after those before cease to fit
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
        gyroscope_axes: the gyroscope's axes along the magnetometer's x, y, z, as in `mg.read`.
        horizon: duration of the samples that are kept for refits, s.

    Raises:
        MagycError: an option is out of range.
    """

    hard_iron_drift: float = 0.0
    gyro_bias_drift: float = 0.0
    detect_changes: bool = True
    angular_rate_is: Literal["instant", "interval-mean"] = "instant"
    gyroscope_axes: str = OWN_AXES
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
            if not is_finite(value) or value < least:
                raise MagycError(f"{name}: must be a finite number of at least {least:g}, got {value!r}")
        if self.prior is None and self.hard_iron_walk:
            raise MagycError(
                "hard_iron_walk=: what may have changed since an earlier calibration; give that calibration too "
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


class Estimate(NamedTuple):
    """An estimate of the parameters, with the noise levels of the last refit.

    Attributes:
        parameters, covariance: θ (p,), p = 16 if a misalignment was decided, and (p, p) without colour.
        noise: noise levels of the last refit.
        colour: correlation factor of its residuals.
        noise_freedom: degrees of freedom from which the gyroscope's noise was estimated.
    """

    parameters: Array
    covariance: Array
    noise: SensorNoise
    colour: float
    noise_freedom: float


@dataclass
class Belief:
    """Everything except the samples that determines the future results of the smoother.

    Attributes:
        past, head: marginals of the windows whose samples were dropped, and of all windows up to the tail.
        front: marginal of all windows up to number `front_at`, if parameters walk at random.
        tail, done: numbers of the tail's first window and of the first window not yet taken.
        given_up: number of windows in the past.
        next_refit, next_search: numbers of windows at which all are fitted again, and without the estimate as a start.
        estimate: the last estimate; None before the motion determines one.
        origin: (4,) bias and delay at which the gyroscope was integrated in the last refit.
        refitted, report: θ and its sigmas (2, p), and the calibration, of the last refit.
        settled, stable: whether the head joins the past as it grows; whether the estimate has converged.
        undecided, waiting: whether the tail may contain a step; whether a refit waits for that, as it would be large.
        misfit_from: number of the first window of a tail of which most windows did not fit; None if they do.
        next_restart: windows since then at which they are fitted by themselves.
        problem, disagree: why there is no estimate, or ""; whether it is axes or units in which the sensors disagree.
        doubt: why the last refit rejected a misalignment that the data suggest.
        contradictions: of the earlier calibration by the data, at the last refit.
        unexplained: model error at the last refit; None before, and if parameters walk.
        iron_change: error by a change of the soft iron at the last step; None without a refit since.
        changes: the steps found; their `after` is not set.
        drift: drift of the clocks until the last refit.
        clock_start: first stamp of the magnetometer, s, from which a known drift is removed.
    """

    past: Marginal | None = None
    head: Marginal | None = None
    front: Marginal | None = None
    front_at: int = 0
    tail: int = 0
    done: int = 0
    given_up: int = 0
    next_refit: int = FIRST
    next_search: int = FIRST
    estimate: Estimate | None = None
    origin: Array = field(default_factory=lambda: np.zeros(4))
    refitted: Array | None = None
    report: Calibration | None = None
    settled: bool = False
    stable: bool = False
    undecided: bool = False
    waiting: bool = False
    misfit_from: int | None = None
    next_restart: int = LEAST_RESTARTED
    problem: str = ""
    disagree: bool = False
    doubt: str = ""
    contradictions: list[str] = field(default_factory=list)
    unexplained: ModelError | None = None
    iron_change: Component | None = None
    changes: list[Change] = field(default_factory=list)
    drift: Drift | None = None
    clock_start: float = np.nan

    def to_json(self) -> str:
        """Return everything as text for `from_json`."""
        return json.dumps(typed_json(vars(self), _TYPES))

    @classmethod
    def from_json(cls, text: str) -> Belief:
        """Return the belief that `to_json` described, bit for bit."""
        return cls(**from_typed_json(json.loads(text), _TYPES))


_TYPES: dict[str, Any] = {
    each.__name__: each
    for each in (Calibration, Change, Component, Drift, Estimate, Marginal, ModelError, SensorNoise)
}


class SmootherState:
    """The samples and the belief of the online smoother, and the operations on both that its parts share."""

    def __init__(self, settings: OnlineOptions) -> None:
        self.settings = settings
        interval_mean = settings.angular_rate_is == "interval-mean"
        self.buffer = SampleBuffer(settings.window, settings.turn or 0.4, interval_mean)
        self.belief = Belief()

    def append(self, magnetometer: Samples, gyroscope: Samples) -> None:
        """Take new samples, with a known clock drift removed from their stamps."""
        belief, drift = self.belief, self.settings.clock_drift
        if drift and len(magnetometer.time):
            if np.isnan(belief.clock_start):
                belief.clock_start = float(magnetometer.time[0])
            magnetometer = Samples(slowed(magnetometer.time, belief.clock_start, drift), magnetometer.value)
        self.buffer.append(magnetometer, gyroscope)

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

    def numbers(self, first: int = 0) -> Array:
        """Return the ascending numbers of the windows kept and taken, from `first` on."""
        numbers = self.buffer.numbers
        return np.unique(numbers[slice(*np.searchsorted(numbers, [first, self.belief.done]))])

    @property
    def middle(self) -> int:
        """The number of the window in the middle of those kept."""
        numbers = self.numbers()
        return int(numbers[len(numbers) // 2])

    def recording(self, stop: int | None, first: int | None = None) -> Recording:
        """Return the samples of the windows from `first` up to `stop`; None for no limit."""
        magnetometer, gyroscope = self.buffer.between(first, stop, self.delay)
        settings = self.settings
        result = Recording.from_streams(magnetometer, gyroscope, angular_rate_is=settings.angular_rate_is)
        # The buffer holds samples alone, whose rates the intake has turned.
        fresh = result.magnetic_field_stamped
        return replace(result, magnetic_field_fresh=fresh, gyroscope_axes=settings.gyroscope_axes)

    def fit_tail(self, stop: int) -> Fit:
        """Fit the tail up to window `stop`, given the head."""
        estimate = self.last
        samples = self.buffer.windows(self.belief.tail, stop, self.delay)
        windows = samples.integrate(estimate.parameters[BIAS], self.delay)
        chain = ContinuedChain(windows, estimate.noise, self.belief.head)
        return fitted(chain, estimate.parameters, self.settings.free(estimate.parameters), self.settings.reject)

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
        belief.past = belief.head = belief.front = belief.iron_change = None
        belief.estimate = belief.refitted = belief.report = belief.drift = belief.unexplained = None
        belief.next_refit = belief.next_search = FIRST
        belief.stable = belief.settled = belief.undecided = belief.waiting = False
        belief.misfit_from, belief.next_restart = None, LEAST_RESTARTED
        belief.doubt, belief.contradictions = "", []
