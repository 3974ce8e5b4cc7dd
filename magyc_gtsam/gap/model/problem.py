"""The field chain of one recording, with the terms of a model subtracted from the data.

Terms on the magnetometer are subtracted from the windows' fields, terms on the gyroscope from its samples before
integration. The chain of `factors.chain.field_chain` therefore serves the extended model unchanged; a delay is its
thirteenth parameter.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.factors.chain.chain_values import ChainState, Reduced, SensorNoise
from magyc_gtsam.factors.chain.directions import LinearisedSensor
from magyc_gtsam.factors.chain.field_chain import DELAY, FieldChain
from magyc_gtsam.factors.chain.field_windows import FieldWindows
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.chain.rate_columns import RateDerivatives
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.factors.effects.forms import FORMS, Setting
from magyc_gtsam.factors.effects.signals import Signals, channels_by_kind
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Recording

_STILL = 1e-9  # standard deviation of a constant channel relative to its largest value, from rounding
_PASSES = 20  # fixed-point iterations for gyroscope terms that read the true rate; most need three
_CLOSE = 1e-7  # rad/s, change at which the iteration has converged
_RUNAWAY = 10.0  # times the first change, beyond which the iteration diverges
_ROUNDS = 5  # of the directions and the terms of the magnetometer, which depend on each other
_AGREED = 1e-3  # rad, change of the directions below which a round is the last
_INSTANTS = 3  # of a window; five change the power of a hysteresis in BROAD 01 and 32 by 1 and 3 %
_NEARBY = 1e-8  # T, step of a numerical derivative
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
        return tuple(term for term in self.terms if term.name in FORMS and "hard_iron" in FORMS[term.name].needs)


@dataclass(frozen=True, eq=False)
class Integrated:
    """The gyroscope with terms subtracted, integrated at one bias and delay, from which a model's may differ slightly.

    Attributes:
        samples: samples with the terms subtracted.
        rate: (3, G) true rate, rad/s.
        windows: field windows at the bias and delay.
        mean_rate: (3, n) true rate, averaged over each window.
    """

    samples: Preintegration
    rate: Array
    windows: FieldWindows
    mean_rate: Array

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
    """

    recording: Recording
    samples: Preintegration
    magnetometer: Signals
    gyroscope: Signals
    rate_noise: float
    _kept: list[tuple[Hashable, Integrated]] = field(default_factory=list, init=False, repr=False)

    @classmethod
    def of(cls, recording: Recording, samples: Preintegration) -> Problem:
        """Interpolate the channels of a recording."""
        return cls(
            recording,
            samples,
            _others(recording, samples.magnetometer_time),
            _others(recording, samples.gyroscope_time),
            short_term_noise(recording).gyroscope,
        )

    @cached_property
    def over_windows(self) -> Signals:
        """The acceleration and the channels, averaged over each window."""
        at = self.magnetometer
        return Signals(
            self.mean(at.time),
            acceleration=None if at.acceleration is None else self.mean(at.acceleration),
            channels={kind: self.mean(value) for kind, value in at.channels.items()},
        )

    @cached_property
    def instants(self) -> Array:
        """The times (k, n), relative to the mean of each window, s, at which effects that are not linear are evaluated.

        A window rotates by up to 0.2 rad, in which a loop of hysteresis reverses and a reading passes a knee.
        """
        time, starts = self.samples.magnetometer_time, self.samples.starts
        ends = np.append(starts[1:], len(time)) - 1
        length = time[ends] - time[starts]
        share = (np.arange(_INSTANTS) + 0.5) / _INSTANTS - 0.5 if length.any() else np.zeros(1)
        return share[:, None] * length

    @cached_property
    def fastest(self) -> float:
        """The largest rate of turn, rad/s."""
        return float(np.sqrt((self.samples.angular_rate**2).sum(axis=1).max()))

    def mean(self, values: Array) -> Array:
        """Return the means (..., n) over the windows of values (..., M) at the magnetometer's samples."""
        count = np.diff(np.append(self.samples.starts, values.shape[-1]))
        result: Array = np.add.reduceat(values, self.samples.starts, axis=-1) / count
        return result


def _others(recording: Recording, at: Array) -> Signals:
    """Return acceleration and channels at given times.

    Rows that have gaps (`channel_holes`) or are constant carry no information and are set to 0; a kind of channel
    without another row is left out.
    """
    time = recording.time

    def interpolated(rows: Array) -> Array:
        return np.stack([np.interp(at, time[np.isfinite(r)], r[np.isfinite(r)]) for r in rows])

    acceleration = None if recording.acceleration is None else interpolated(recording.acceleration.T)
    channels = {}
    for kind, rows in channels_by_kind(recording.channels).items():
        usable = [bool(np.isfinite(r).all()) and np.std(r) > _STILL * np.max(np.abs(r)) for r in rows]
        if any(usable):
            channels[kind] = interpolated(np.where(np.array(usable)[:, None], rows, 0.0))
    return Signals(at, acceleration=acceleration, channels=channels)


def _true_rate(problem: Problem, terms: Sequence[Active], bias: Array) -> Array:
    """Return the true rate (3, G) rad/s: the reading less bias and terms of the gyroscope, by fixed-point iteration.

    Raises:
        MagycError: the terms are so large that the iteration diverges: a reading belongs to more than one rate.
    """
    measured: Array = problem.samples.angular_rate.T - bias[:, None]
    true, changes = measured, [np.inf]
    for _ in range(_PASSES if terms else 0):
        signals, before = replace(problem.gyroscope, rate=true), true
        true = measured - sum(FORMS[t.name].evaluate(signals, t.value, t.setting) for t in terms)
        changes.append(float(np.abs(true - before).max()))
        if changes[-1] < _CLOSE:
            break
        if not changes[-1] < _RUNAWAY * changes[1]:
            raise MagycError(
                f"{' and '.join(t.name for t in terms)}: with values this large, one reading corresponds to more than "
                "one rate"
            )
    return true


def _integrated(problem: Problem, model: Model) -> Integrated:
    """Integrate the gyroscope near the bias and delay of a model, with its terms.

    The result is cached: a small step, a change of the noise or a new term with value 0 needs the same integration.

    Raises:
        MagycError: the terms are so large that a reading belongs to more than one rate.
    """
    bias, delay = model.parameters[9:12], float(model.parameters[DELAY])
    terms = [t for t in model.terms if t.name in FORMS and FORMS[t.name].side == "gyroscope" and t.value.any()]
    key = tuple((t.name, tuple(sorted(t.setting.items())), t.value.tobytes()) for t in terms)
    for place, (known, integrated) in enumerate(problem._kept):
        at = integrated.windows
        moved = problem.samples.length * np.abs(bias - at.bias).max() + problem.fastest * abs(delay - at.delay)
        if known == key and moved < _NEAR:
            problem._kept.append(problem._kept.pop(place))
            return integrated
    rate = _true_rate(problem, terms, bias)
    samples = problem.samples.with_rate((rate + bias[:, None]).T) if terms else problem.samples
    windows = samples.integrate(bias, delay)
    when = problem.magnetometer.time - delay
    mean_rate = problem.mean(np.stack([np.interp(when, problem.gyroscope.time, axis) for axis in rate]))
    result = Integrated(samples, rate, windows, mean_rate)
    problem._kept[:] = [*problem._kept[1 - _KEPT :], (key, result)]
    return result


def window_signals(problem: Problem, gyroscope: Integrated, state: ChainState) -> Signals:
    """Return the signals that the forms read, averaged over each window, at the values of the model."""
    parameters, g = state
    soft = unvech(parameters[:6])
    rotation = gyroscope.windows.rotation_at(parameters[9:12], float(parameters[DELAY]))
    field = soft @ np.einsum("ijn,jn->in", rotation, g)
    field_rate = -soft @ np.einsum("ijn,jn->in", gyroscope.windows.rotation_rate, g)
    curvature = np.gradient(field_rate, gyroscope.windows.time, axis=1)
    away = problem.instants[:, None]
    within = field + away * field_rate + 0.5 * (away**2 - (away**2).mean(axis=0)) * curvature
    return replace(
        problem.over_windows,
        field=field,
        field_rate=field_rate,
        within=np.moveaxis(within, 0, -1),
        hard_iron=parameters[6:9],
        rate=gyroscope.mean_rate,
        to_sensor=rotation,
    )


def _added(terms: Sequence[Active], signals: Signals) -> Array:
    """Return the sum (3, n) T of the terms on the magnetometer's reading."""
    return sum(
        (FORMS[t.name].evaluate(signals, t.value, t.setting) for t in terms), np.zeros((3, len(signals.time)))
    )


def _bend(bent: Sequence[Active], signals: Signals) -> LinearisedSensor:
    """Return the linearisation of the non-linear terms at the field of the signals."""
    field = signals.need("field")
    more, less = (
        _added(bent, replace(signals, field=field + step, within=signals.path + step))
        for step in (_NEARBY, -_NEARBY)
    )
    return LinearisedSensor(1 + (more - less) / (2 * _NEARBY), field + signals.need("hard_iron")[:, None])


def build(
    problem: Problem, model: Model, near: tuple[ChainState, Integrated] | None = None
) -> tuple[FieldChain, ChainState, Reduced, Integrated]:
    """Build the chain of a model and optimise its directions, from those of a model near it if there is one.

    The terms of the magnetometer depend on the field of the model. Therefore the directions are optimised, the terms
    subtracted, and the directions optimised again; several times for non-linear terms, at which the reading is then
    linearised.

    Returns:
        The chain, its state, its linearisation, and the integrated gyroscope.
    """
    gyroscope = _integrated(problem, model)
    windows = gyroscope.windows
    plain = FieldChain(windows, model.noise)
    terms = [
        t for t in model.terms if t.name in FORMS and FORMS[t.name].side == "magnetometer" and t.name != "timing"
    ]
    # Directions are in the world of their integration.
    same = near is not None and near[1] is gyroscope
    state = ChainState(model.parameters, near[0].direction) if near and same else plain.start(model.parameters)
    chain_, bent = plain, model.bends
    for _ in range(_ROUNDS):
        if terms:
            signals = window_signals(problem, gyroscope, state)
            corrected = replace(windows, field=windows.field - _added(terms, signals))
            chain_ = FieldChain(corrected, model.noise, bend=_bend(bent, signals) if bent else None)
        before = state.direction
        state, reduced = chain_.settle(state, chain_.unweighted())
        if not terms or np.abs(state.direction - before).max() < _AGREED:
            break
    return chain_, state, reduced, gyroscope
