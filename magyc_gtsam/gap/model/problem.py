"""One recording in windows, and a model of it: the gyroscope is integrated with the model's terms subtracted."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.factors.chain.chain_values import DELAY, SensorNoise
from magyc_gtsam.factors.chain.field_windows import FieldWindows
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.chain.rate_columns import RateDerivatives
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.changes import Setting
from magyc_gtsam.factors.effects.forms import FORMS
from magyc_gtsam.factors.effects.signals import Signals, channels_by_kind
from magyc_gtsam.factors.effects.turning import Turning
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.model.colour import ColouredNoise
from magyc_gtsam.gap.model.rests import rate_at_rest
from magyc_gtsam.gap.model.track import Track
from magyc_gtsam.recording import Recording

_STILL = 1e-9  # standard deviation of a constant channel relative to its largest value, from rounding
_PASSES = 20  # fixed-point iterations for gyroscope terms that read the true rate; most need three
_CLOSE = 1e-7  # rad/s, change at which the iteration has converged
_RUNAWAY = 10.0  # times the first change, beyond which the iteration diverges
_INSTANTS = 3  # of a window; of a hysteresis in BROAD 01 and 32 five leave 1 and 3 % less
_KEPT = 4  # cached integrations of one problem, for a search that alternates between models
# rad by which a change of bias and delay may turn the field within a window, up to which the first-order derivatives
# of an integration replace a new one: the error is half its square, where the noise of a window is milliradians
_NEAR = 1e-3


@dataclass(frozen=True, eq=False)
class Active:
    """A term in the model.

    Attributes:
        name: of the catalogue.
        setting: of the grid search.
        value: (k,) in SI units.
        prior: prior standard deviation of the value, as `EffectTerm.prior`; None for the catalogue's.
    """

    name: str
    setting: Setting
    value: Array
    prior: float | None = None


@dataclass(frozen=True, eq=False)
class Model:
    """A calibration model.

    Attributes:
        parameters: θ (13,) of the field chain.
        free: (13,) bool, parameters that are estimated.
        noise: of the sensors.
        terms: effects beyond θ.
    """

    parameters: Array
    free: np.ndarray
    noise: SensorNoise
    terms: tuple[Active, ...] = ()

    @property
    def estimated(self) -> tuple[Active, ...]:
        """Return the terms with regressors of their own; a timing is a parameter of the chain instead."""
        return tuple(term for term in self.terms if term.name != "timing")

    @property
    def bends(self) -> tuple[Active, ...]:
        """Return the non-linear terms of the magnetometer, whose form depends on its reading."""
        return tuple(term for term in self.terms if "hard_iron" in FORMS[term.name].needs)

    def on(self, side: str) -> tuple[Active, ...]:
        """Return the terms on a sensor's reading, "magnetometer" or "gyroscope"."""
        return tuple(term for term in self.estimated if FORMS[term.name].side == side)


@dataclass(frozen=True, eq=False)
class Integrated:
    """The gyroscope with terms subtracted, integrated at one bias and delay, from which a model's may differ slightly.

    Attributes:
        samples: samples with the terms subtracted.
        rate: (3, G) true rate, rad/s.
        windows: field windows at the bias and delay.
        mean_rate: (3, n) true rate, averaged over each window.
        turning: the true rate at the samples, and the windows.
    """

    samples: Preintegration
    rate: Array
    windows: FieldWindows
    mean_rate: Array
    turning: Turning

    @cached_property
    def errors(self) -> RateDerivatives:
        """Return the derivatives with respect to further errors of the rate."""
        return RateDerivatives.of(self.samples, self.rate, self.windows.delay)


@dataclass(frozen=True, eq=False)
class Problem:
    """One recording, divided into windows, with all channels interpolated to the samples of the sensors.

    Attributes:
        recording: the data.
        samples: samples of both sensors, in windows.
        magnetometer, gyroscope: acceleration and channels at each sensor's samples.
        rate_noise: short-term noise of the gyroscope, rad/s per sample. A missing effect raises the model's noise
            level, but not this one.
        colour: of the magnetometer's noise; None if it is white.
    """

    recording: Recording
    samples: Preintegration
    magnetometer: Signals
    gyroscope: Signals
    rate_noise: float
    colour: ColouredNoise | None = None
    _kept: list[tuple[Hashable, Integrated]] = field(default_factory=list, init=False, repr=False)
    _tracks: dict[bytes, Track] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def of(cls, recording: Recording, samples: Preintegration) -> Problem:
        """Interpolate the channels of a recording."""
        return cls(
            recording,
            samples,
            _others(recording, samples, samples.magnetometer_time),
            _others(recording, samples, samples.gyroscope_time),
            short_term_noise(recording).gyroscope,
        )

    @cached_property
    def over_windows(self) -> Signals:
        """The acceleration and the channels, averaged over each window."""
        at = self.magnetometer
        return Signals(
            self.mean(at.time),
            span=self._span,
            acceleration=None if at.acceleration is None else self.mean(at.acceleration),
            channels={kind: self.mean(value) for kind, value in at.channels.items()},
        )

    @cached_property
    def instants(self) -> Array:
        """The times (k, n), relative to the mean of each window, s, at which effects that are not linear are evaluated.

        A window rotates by up to 0.2 rad, in which a loop of hysteresis reverses and a reading passes a knee.
        """
        length = self._length
        share = (np.arange(_INSTANTS) + 0.5) / _INSTANTS - 0.5 if length.any() else np.zeros(1)
        return share[:, None] * length

    @property
    def _ends(self) -> np.ndarray:
        return np.append(self.samples.starts[1:], len(self.samples.magnetometer_time)) - 1

    @property
    def _length(self) -> Array:
        """The time (n,) from the first sample of each window to its last one, s."""
        result: Array = (
            self.samples.magnetometer_time[self._ends] - self.samples.magnetometer_time[self.samples.starts]
        )
        return result

    @property
    def _span(self) -> Array:
        """The length (n,) of each window, s: that with one interval between samples more."""
        intervals = self._ends - self.samples.starts
        result: Array = self._length * (intervals + 1) / np.maximum(intervals, 1)
        return result

    @cached_property
    def rate_at_rest(self) -> Array | None:
        """The gyroscope's mean (3,), rad/s, over the rests; None without one."""
        return rate_at_rest(self.recording)

    def track(self, bias: Array) -> Track:
        """Return the turns by the rate beyond that at rest; without a rest, beyond a bias (3,) rad/s, the last kept."""
        bias = bias if self.rate_at_rest is None else self.rate_at_rest
        if bias.tobytes() not in self._tracks:
            self._tracks.clear()
            self._tracks[bias.tobytes()] = Track.of(self.samples.gyroscope_time, self.samples.angular_rate - bias)
        return self._tracks[bias.tobytes()]

    @cached_property
    def fastest(self) -> float:
        """The largest rate of turn, rad/s."""
        return float(np.sqrt((self.samples.angular_rate**2).sum(axis=1).max()))

    def mean(self, values: Array) -> Array:
        """Return the means (..., n) over the windows of values (..., M) at the magnetometer's samples."""
        return _over_windows(self.samples, values)


def _over_windows(samples: Preintegration, values: Array) -> Array:
    count = np.diff(np.append(samples.starts, values.shape[-1]))
    result: Array = np.add.reduceat(values, samples.starts, axis=-1) / count
    return result


def _others(recording: Recording, samples: Preintegration, at: Array) -> Signals:
    """Return acceleration and channels at given times.

    Rows that have gaps (`channel_holes`), or are constant over the windows, carry no information and are set to 0; a
    kind of channel without another row is left out.
    """
    time = recording.time

    def interpolated(rows: Array, at: Array) -> Array:
        return np.stack([np.interp(at, time[np.isfinite(r)], r[np.isfinite(r)]) for r in rows])

    acceleration = None if recording.acceleration is None else interpolated(recording.acceleration.T, at)
    channels = {}
    for kind, rows in channels_by_kind(recording.channels).items():
        rows = np.where(np.isfinite(rows).all(axis=1, keepdims=True), rows, 0.0)
        means = _over_windows(samples, interpolated(rows, samples.magnetometer_time))
        still = means.std(axis=1, keepdims=True) <= _STILL * np.abs(rows).max(axis=1, keepdims=True)
        if not still.all():
            channels[kind] = interpolated(np.where(still, 0.0, rows), at)
    return Signals(at, acceleration=acceleration, channels=channels)


def added_by(terms: Sequence[Active], signals: Signals) -> Array:
    """Return the sum (3, n) of what terms add to a sensor's reading, SI."""
    each = (FORMS[term.name].evaluate(signals, term.value, term.setting) for term in terms)
    return sum(each, np.zeros((3, len(signals.time))))


def _true_rate(problem: Problem, terms: Sequence[Active], bias: Array) -> Array:
    """Return the true rate (3, G) rad/s: the reading less bias and terms of the gyroscope, by fixed-point iteration.

    Raises:
        MagycError: the terms are so large that the iteration diverges: a reading belongs to more than one rate.
    """
    measured: Array = problem.samples.angular_rate.T - bias[:, None]
    following, others = (
        [t for t in terms if ("rate" in FORMS[t.name].needs) == follows] for follows in (True, False)
    )

    def added(by: Sequence[Active], rate: Array) -> Array:
        return added_by(by, replace(problem.gyroscope, rate=rate))

    measured = measured - added(others, measured)
    true, changes = measured, [np.inf]
    for _ in range(_PASSES if following else 0):
        before = true
        true = measured - added(following, true)
        changes.append(float(np.abs(true - before).max()))
        if changes[-1] < _CLOSE:
            break
        if not changes[-1] < _RUNAWAY * changes[1]:
            raise MagycError(
                f"{' and '.join(t.name for t in following)}: with values this large, one reading corresponds to more "
                "than one rate"
            )
    return true


def integrated(problem: Problem, model: Model) -> Integrated:
    """Integrate the gyroscope near the bias and delay of a model, with its terms.

    The result is cached: a small step, a change of the noise or a new term with value 0 needs the same integration.

    Raises:
        MagycError: the terms are so large that a reading belongs to more than one rate.
    """
    bias, delay = model.parameters[9:12], float(model.parameters[DELAY])
    terms = [term for term in model.on("gyroscope") if term.value.any()]
    key = tuple((t.name, tuple(sorted(t.setting.items())), t.value.tobytes()) for t in terms)
    for place, (known, kept) in enumerate(problem._kept):
        at = kept.windows
        moved = problem.samples.length * np.abs(bias - at.bias).max() + problem.fastest * abs(delay - at.delay)
        if known == key and moved < _NEAR:
            problem._kept.append(problem._kept.pop(place))
            return kept
    rate = _true_rate(problem, terms, bias)
    samples = problem.samples.with_rate((rate + bias[:, None]).T) if terms else problem.samples
    windows = samples.integrate(bias, delay)
    when = problem.magnetometer.time - delay
    mean_rate = problem.mean(np.stack([np.interp(when, problem.gyroscope.time, axis) for axis in rate]))
    turning = Turning(problem.gyroscope.time, rate, when, partial(_over_windows, problem.samples))
    result = Integrated(samples, rate, windows, mean_rate, turning)
    problem._kept[:] = [*problem._kept[1 - _KEPT :], (key, result)]
    return result
