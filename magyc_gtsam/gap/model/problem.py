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
_BENT = 5  # iterations for non-linear magnetometer terms
_NEARBY = 1e-8  # T, step of a numerical derivative
_KEPT = 3  # cached integrations of one problem, for a search that alternates between models


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
    """The gyroscope with terms subtracted, integrated at one bias and delay.

    Attributes:
        samples: samples with the terms subtracted.
        rate: (3, G) true rate, rad/s.
        windows: field windows at the bias and delay.
    """

    samples: Preintegration
    rate: Array
    windows: FieldWindows

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
    _kept: dict[Hashable, Integrated] = field(default_factory=dict, init=False, repr=False)

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
    """Integrate the gyroscope with the bias, delay and terms of a model.

    The result is cached: a change of the noise or a new term with value 0 needs the same integration.

    Raises:
        MagycError: the terms are so large that a reading belongs to more than one rate.
    """
    bias, delay = model.parameters[9:12], float(model.parameters[DELAY])
    terms = [t for t in model.terms if t.name in FORMS and FORMS[t.name].side == "gyroscope" and t.value.any()]
    key = (
        bias.tobytes(),
        delay,
        *((t.name, tuple(sorted(t.setting.items())), t.value.tobytes()) for t in terms),
    )
    if key not in problem._kept:
        rate = _true_rate(problem, terms, bias)
        samples = problem.samples.with_rate((rate + bias[:, None]).T) if terms else problem.samples
        while len(problem._kept) >= _KEPT:
            del problem._kept[next(iter(problem._kept))]
        problem._kept[key] = Integrated(samples, rate, samples.integrate(bias, delay))
    return problem._kept[key]


def window_signals(problem: Problem, windows: FieldWindows, state: ChainState, rate: Array) -> Signals:
    """Return the signals that the forms read, averaged over each window, at the values of the model."""
    parameters, g = state
    soft = unvech(parameters[:6])
    rotation = windows.rotation
    at = problem.magnetometer
    gyro_time = problem.gyroscope.time
    rates = np.stack([np.interp(at.time - parameters[DELAY], gyro_time, axis) for axis in rate])
    return Signals(
        windows.time,
        field=soft @ np.einsum("ijn,jn->in", rotation, g),
        field_rate=-soft @ np.einsum("ijn,jn->in", windows.rotation_rate, g),
        hard_iron=parameters[6:9],
        rate=problem.mean(rates),
        to_sensor=rotation,
        acceleration=None if at.acceleration is None else problem.mean(at.acceleration),
        channels={kind: problem.mean(value) for kind, value in at.channels.items()},
    )


def _added(terms: Sequence[Active], signals: Signals) -> Array:
    """Return the sum (3, n) T of the terms on the magnetometer's reading."""
    return sum(
        (FORMS[t.name].evaluate(signals, t.value, t.setting) for t in terms), np.zeros((3, len(signals.time)))
    )


def _answer(bent: Sequence[Active], signals: Signals) -> Array:
    """Return the derivative (3, n) of the reading with respect to the field, which is 0 where the reading clips."""
    field = signals.need("field")
    more, less = (_added(bent, replace(signals, field=field + step)) for step in (_NEARBY, -_NEARBY))
    return 1 + (more - less) / (2 * _NEARBY)


def build(problem: Problem, model: Model) -> tuple[FieldChain, ChainState, Reduced, Integrated]:
    """Build the chain of a model and optimise its directions.

    The terms of the magnetometer depend on the field of the model. Therefore the directions are optimised, the terms
    subtracted, and the directions optimised again; several times for non-linear terms, at which the reading is then
    linearised.

    Returns:
        The chain, its state, its linearisation, and the integrated gyroscope.
    """
    gyroscope = _integrated(problem, model)
    windows, rate = gyroscope.windows, gyroscope.rate
    plain = FieldChain(windows, model.noise)
    terms = [
        t for t in model.terms if t.name in FORMS and FORMS[t.name].side == "magnetometer" and t.name != "timing"
    ]
    chain_, state = plain, plain.start(model.parameters)
    bent = model.bends
    for _ in range(_BENT if bent else 2 if terms else 1):
        if terms:
            signals = window_signals(problem, windows, state, rate)
            corrected = replace(windows, field=windows.field - _added(terms, signals))
            chain_ = FieldChain(corrected, model.noise, answer=_answer(bent, signals) if bent else None)
        state, reduced = chain_.settle(chain_.start(model.parameters), chain_.unweighted())
    return chain_, state, reduced, gyroscope
