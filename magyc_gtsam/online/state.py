"""The state of the online smoother: the latest samples, what is known from all others, and how that is written down."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.model_error.component import Component
from magyc_gtsam.estimators.model_error.model_error import ModelError
from magyc_gtsam.estimators.smoother.clock_drift import Drift
from magyc_gtsam.estimators.smoother.fit import NEAR, Fit, adapt, begin, descend
from magyc_gtsam.estimators.smoother.known import known_of
from magyc_gtsam.estimators.smoother.search import skew_prior
from magyc_gtsam.estimators.smoother.skew import HeldSkew, SkewPrior, skew_of, widened
from magyc_gtsam.estimators.smoother.smoother import calibration_of
from magyc_gtsam.factors.chain.facts import Fact, LinearFact
from magyc_gtsam.factors.chain.field_chain import DELAY, PARAMETERS, SensorNoise
from magyc_gtsam.online.buffers import SampleBuffer
from magyc_gtsam.online.engine import Change
from magyc_gtsam.online.marginal import BIAS, ContinuedChain, Marginal
from magyc_gtsam.online.options import OnlineOptions
from magyc_gtsam.recording import Array, Recording

FIRST = 12  # windows before the first fit
_COUNTS = ("front_at", "tail", "done", "given_up", "next_refit", "next_search", "settled", "stable", "undecided")


class Estimate(NamedTuple):
    """θ (p,), p = 16 where a skew was decided, its covariance (p, p) without colour; of the last refit the noise
    levels, the colour of the residuals, and the degrees of freedom from which the gyroscope's noise was estimated."""

    parameters: Array
    covariance: Array
    noise: SensorNoise
    colour: float
    noise_freedom: float


@dataclass
class Belief:
    """All that decides the future of the smoother, but for the samples.

    Attributes:
        past, head: marginals of the windows given up, and of all windows up to the tail.
        front: where parameters walk, the marginal of all windows up to number `front_at`, walked until then.
        tail, done: numbers of the tail's first window and of the first window not yet taken.
        given_up: windows in the past.
        next_refit, next_search: windows kept at which everything is fitted afresh, from several starts.
        estimate: what the last fit said; None before the motion determined anything.
        origin: (4,) bias and delay at which the gyroscope was integrated in the last refit.
        refitted: θ and its sigmas (2, p) at the last refit.
        report: the result of the last refit.
        settled: the head joins the past as it grows.
        stable: converged.
        undecided: something happened in the tail that may yet turn out to be a step.
        problem: why there is no estimate.
        doubt: why the last refit did not believe a skew that the data ask for.
        unexplained: what the model does not explain, by the last refit; None before, and where parameters walk.
        changes: steps found; their `after` is left open.
        drift: what the clocks did until the last refit.
        clock_start: s, the magnetometer's first stamp, from which a drift that is known is taken out.
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
    problem: str = ""
    doubt: str = ""
    unexplained: ModelError | None = None
    changes: list[Change] = field(default_factory=list)
    drift: Drift | None = None
    clock_start: float = np.nan

    def to_arrays(self) -> dict[str, Array]:
        """Everything, for `from_arrays`."""
        result: dict[str, Array] = {"counts": np.array([int(getattr(self, name)) for name in _COUNTS])}
        result["origin"] = self.origin
        words = [self.problem, self.doubt, _data(self.report), _of_error(self.unexplained)]
        result["words"] = np.array(json.dumps(words))
        for name, marginal in (("past", self.past), ("head", self.head), ("front", self.front)):
            if marginal is not None:
                result |= {f"{name}/{k}": v for k, v in marginal._asdict().items()}
        if self.estimate is not None:
            result["estimate"] = np.vstack([self.estimate.parameters, self.estimate.covariance])
            result["levels"] = np.array([*self.estimate.noise, self.estimate.colour, self.estimate.noise_freedom])
        if self.refitted is not None:
            result["refitted"] = self.refitted
        if self.drift is not None:
            rate, sigma, moved, delay, known = self.drift
            result["drift"] = np.array([rate, sigma, moved, *delay, known])
        result["clock_start"] = np.array(self.clock_start)
        rows = [[c.time, c.time_sigma, *c.step, *c.step_sigma] for c in self.changes]
        result["changes"] = np.array(rows).reshape(-1, 8)
        result["before"] = np.array(json.dumps([_data(c.before) for c in self.changes]))
        return result

    @classmethod
    def from_arrays(cls, state: Mapping[str, Array]) -> Belief:
        """The inverse of `to_arrays`, bit for bit."""
        counts = dict(zip(_COUNTS, (int(v) for v in state["counts"]), strict=True))
        problem, doubt, report, unexplained = json.loads(str(state["words"]))
        result = cls(
            **counts | {name: bool(counts[name]) for name in ("settled", "stable", "undecided")},  # type: ignore[arg-type]
            problem=problem,
            doubt=doubt,
            report=_calibration(report),
            unexplained=_error(unexplained),
            origin=state["origin"],
            refitted=state.get("refitted"),
            clock_start=float(state["clock_start"]),
        )
        if "drift" in state:
            rate, sigma, moved, first, last, known = state["drift"].tolist()
            result.drift = Drift(rate, sigma, moved, (first, last), known)
        for name in ("past", "head", "front"):
            if f"{name}/parameters" in state:
                setattr(result, name, Marginal(*(state[f"{name}/{k}"] for k in Marginal._fields)))
        if "estimate" in state:
            magnetometer, gyroscope, *rest = (float(v) for v in state["levels"])
            result.estimate = Estimate(
                state["estimate"][0].copy(),
                state["estimate"][1:].copy(),
                SensorNoise(magnetometer, gyroscope),
                *rest,
            )
        before = json.loads(str(state["before"]))
        for row, data in zip(state["changes"], before, strict=True):
            result.changes.append(
                Change(float(row[0]), float(row[1]), row[2:5].copy(), row[5:8].copy(), _calibration(data), None)
            )
        return result


def _of_error(error: ModelError | None) -> dict[str, object] | None:
    if error is None:
        return None
    kinds = {"components": error.components, "possible": error.possible}
    stored = {
        name: [{**vars(c), "covariance": c.covariance.tolist()} for c in group] for name, group in kinds.items()
    }
    return {"covariance": error.covariance.tolist(), **stored}


def _error(data: dict[str, Any] | None) -> ModelError | None:
    if data is None:
        return None
    kinds = (
        tuple(Component(**c | {"covariance": np.array(c["covariance"])}) for c in data[name])
        for name in ("components", "possible")
    )
    return ModelError(np.array(data["covariance"]), *kinds)


def _data(calibration: Calibration | None) -> dict[str, object] | None:
    return None if calibration is None else calibration.to_dict()


def _calibration(data: dict[str, object] | None) -> Calibration | None:
    return None if data is None else Calibration.from_dict(data)


class SmootherState:
    """Samples and memory, and the operations on both that all parts of the smoother share."""

    def __init__(self, settings: OnlineOptions) -> None:
        self.settings = settings
        interval_mean = settings.angular_rate_is == "interval-mean"
        self.buffer = SampleBuffer(settings.window, settings.turn or 0.4, interval_mean)
        self.belief = Belief()

    @property
    def last(self) -> Estimate:
        """What the last fit said; there is one."""
        assert self.belief.estimate is not None
        return self.belief.estimate

    @property
    def delay(self) -> float:
        """s, by which the magnetometer lags as far as is known."""
        estimate = self.belief.estimate
        return float(self.settings.delay or 0.0) if estimate is None else float(estimate.parameters[DELAY])

    @property
    def known(self) -> dict[str, Any]:
        """What is known beforehand, as the batch method takes it: no more once the hard iron has changed, or where it
        is in what was marginalised."""
        given = self.belief.past is None and not self.belief.changes
        return self.settings.known if given else {}

    def facts(self, size: int = PARAMETERS) -> tuple[Fact, ...]:
        """The same as facts about θ (size,)."""
        if not self.known:
            return ()
        known = known_of(self.settings.options)
        return known.facts if known.skew is None or size == PARAMETERS else (*known.facts, known.skew)

    @property
    def skew(self) -> tuple[SkewPrior | None, LinearFact | None]:
        """What is believed of a skew, None where there is none; and what an earlier calibration says of it, as long as
        that is in nothing that was marginalised."""
        known = known_of(self.settings.options)
        return skew_prior(self.settings.options, known), known.skew if self.known else None

    def asked(self, fit: Fit) -> Fit:
        """A continued fit, with what all windows say of a skew."""
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
        """Ascending, of the windows kept and taken, from `first` on."""
        numbers = self.buffer.numbers
        return np.unique(numbers[slice(*np.searchsorted(numbers, [first, self.belief.done]))])

    def recording(self, stop: int | None, first: int | None = None) -> Recording:
        """The samples of the windows from `first` up to `stop`; None: of all."""
        magnetometer, gyroscope = self.buffer.between(first, stop, self.delay)
        return Recording.from_streams(magnetometer, gyroscope, angular_rate_is=self.settings.angular_rate_is)

    def fit_tail(self, stop: int) -> Fit:
        """The tail up to window `stop` at its minimum, given the head."""
        estimate = self.last
        samples = self.buffer.windows(self.belief.tail, stop, self.delay)
        windows = samples.integrate(estimate.parameters[BIAS], self.delay)
        chain = ContinuedChain(windows, estimate.noise, self.belief.head)
        fit = begin(chain, estimate.parameters, self.settings.free(estimate.parameters))
        return adapt(descend(fit, NEAR), self.settings.reject, None)

    def close(self) -> None:
        """The head joins the past."""
        m = self.belief
        m.given_up += int(np.searchsorted(self.numbers(), m.tail))
        m.past = m.head
        self.buffer.keep_from(m.tail, self.delay)

    def begin_at(self, number: int) -> None:
        """As if the log began with this window."""
        m, buffer = self.belief, self.buffer
        m.given_up += int(np.searchsorted(self.numbers(), number))
        last = buffer.magnetometer.time[int(np.searchsorted(buffer.numbers, m.done)) - 1]
        buffer.begin_at(number, self.settings.window)
        m.done = int(buffer.numbers[np.searchsorted(buffer.magnetometer.time, last)])
        m.past = m.head = m.front = m.estimate = m.refitted = m.report = m.drift = m.unexplained = None
        m.next_refit = m.next_search = FIRST
        m.stable = m.settled = m.undecided = False
        m.doubt = ""

    def result(
        self,
        recording: Recording,
        fit: Fit,
        rival: Fit | None = None,
        first: int = 0,
        refitted: Estimate | None = None,
    ) -> Calibration:
        """Of a fit of the windows from `first` on; where that is the end of a refit (`refitted`), its noise levels
        are."""
        colour = None if refitted is None else refitted.colour
        unexplained = None if refitted is None else self.belief.unexplained
        if self.settings.walks and refitted is not None:  # the walk stands for what the model does not explain
            unexplained = ModelError(np.zeros_like(refitted.covariance))
        if refitted is not None:
            fit = replace(self.asked(fit), noise_freedom=refitted.noise_freedom)
        result = calibration_of(
            recording, fit, rival, self.settings.options, colour, unexplained=unexplained, samples=self.buffer
        )
        windows = self.belief.given_up + int(np.searchsorted(self.numbers(), first)) + len(fit.chain.windows)
        return replace(result, diagnostics={**result.diagnostics, "windows": windows})


def continued(fit: Fit) -> ContinuedChain:
    """The chain of a fit, as one that may have a past; without the prior of a skew, which is no fact."""
    chain = fit.chain
    facts = tuple(fact for fact in chain.facts if not isinstance(fact, HeldSkew))
    if isinstance(chain, ContinuedChain):
        return replace(chain, facts=facts)
    return ContinuedChain(chain.windows, chain.noise, facts=facts)


def observable(calibration: Calibration) -> bool:
    """Whether the motion determined it."""
    return calibration.observability is not None and calibration.observability.observable
