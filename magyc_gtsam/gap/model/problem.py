"""The data of one recording with the terms of a model taken out of them: a field chain again.

Terms on the magnetometer are subtracted from the windows' fields, terms on the gyroscope from its samples before
they are integrated, so that the chain of `factors.field_chain` serves the extended model unchanged; a delay is its
own thirteenth parameter.
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

_STILL = 1e-9  # of a channel's largest value: less is rounding
_PASSES = 20  # for gyroscope terms that read the true rate; most need three
_CLOSE = 1e-7  # rad/s
_RUNAWAY = 10.0  # times the first change, beyond which the passes do not come to an end
_BENT = 5  # passes for magnetometer terms that bend the reading
_NEARBY = 1e-8  # T
_KEPT = 3  # integrations of one problem, of a search that goes to and fro between its models


@dataclass(frozen=True, eq=False)
class Active:
    """A term in the model: its name, setting and value (k,) in SI units.

    prior: deviation with which the value is held to 0, as `EffectTerm.prior`; None is the catalogue's.
    """

    name: str
    setting: Setting
    value: Array
    prior: float | None = None


@dataclass(frozen=True, eq=False)
class Model:
    """θ (13,) of the field chain, which of them are free, the noise, and the terms beyond."""

    parameters: Array
    free: np.ndarray
    noise: SensorNoise
    terms: tuple[Active, ...] = ()

    @property
    def estimated(self) -> tuple[Active, ...]:
        """The terms whose values have regressors of their own; a timing is a parameter of the chain."""
        return tuple(term for term in self.terms if term.name != "timing")

    @property
    def bends(self) -> tuple[Active, ...]:
        """The terms that read what the magnetometer reads, and so bend it."""
        return tuple(term for term in self.terms if term.name in FORMS and "hard_iron" in FORMS[term.name].needs)


@dataclass(frozen=True, eq=False)
class Integrated:
    """The gyroscope without some terms, integrated at one bias and delay.

    Attributes:
        samples: with the terms taken out.
        rate: (3, G) rad/s, the true rate.
        windows: at the bias and delay.
    """

    samples: Preintegration
    rate: Array
    windows: FieldWindows

    @cached_property
    def errors(self) -> RateDerivatives:
        """What further errors of the rate do."""
        return RateDerivatives.of(self.samples, self.rate, self.windows.delay)


@dataclass(frozen=True, eq=False)
class Problem:
    """One recording, cut into windows, with everything interpolated to where the forms read it.

    Attributes:
        recording: the data.
        samples: of both sensors, in windows.
        magnetometer, gyroscope: acceleration and channels at each sensor's samples.
        rate_noise: rad/s per sample, of the gyroscope itself: what else is missing raises the model's, not this.
    """

    recording: Recording
    samples: Preintegration
    magnetometer: Signals
    gyroscope: Signals
    rate_noise: float
    _kept: dict[Hashable, Integrated] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def of(cls, recording: Recording, samples: Preintegration) -> Problem:
        """Interpolate what the recording has."""
        return cls(
            recording,
            samples,
            _others(recording, samples.magnetometer_time),
            _others(recording, samples.gyroscope_time),
            short_term_noise(recording).gyroscope,
        )

    def mean(self, values: Array) -> Array:
        """Means over the windows of values (..., M) at the magnetometer's samples: (..., n)."""
        count = np.diff(np.append(self.samples.starts, values.shape[-1]))
        result: Array = np.add.reduceat(values, self.samples.starts, axis=-1) / count
        return result


def _others(recording: Recording, at: Array) -> Signals:
    """Acceleration and channels at given times.

    Rows not known throughout (`channel_holes`), or that stand still, tell nothing and are 0; a kind of which all
    are so is left out.
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
    """(3, G) rad/s, the rate that the sensor would have read less its bias and the gyroscope's terms.

    Raises:
        MagycError: terms so large that a reading belongs to no one rate, so that the passes run away.
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
                f"{' and '.join(t.name for t in terms)}: as large as this, a reading belongs to more than one rate"
            )
    return true


def _integrated(problem: Problem, model: Model) -> Integrated:
    """The gyroscope integrated as a model has it; kept, for a change of the noise or a new term at 0 asks the same.

    Raises:
        MagycError: terms so large that a reading belongs to no one rate.
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
    """What the forms read, window by window, as the model has it."""
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
    """(3, n) T that terms add to the magnetometer's reading."""
    return sum(
        (FORMS[t.name].evaluate(signals, t.value, t.setting) for t in terms), np.zeros((3, len(signals.time)))
    )


def _answer(bent: Sequence[Active], signals: Signals) -> Array:
    """(3, n) by how much of the field's change the reading changes: what is clipped tells nothing of the iron."""
    field = signals.need("field")
    more, less = (_added(bent, replace(signals, field=field + step)) for step in (_NEARBY, -_NEARBY))
    return 1 + (more - less) / (2 * _NEARBY)


def build(problem: Problem, model: Model) -> tuple[FieldChain, ChainState, Reduced, Integrated]:
    """The chain of a model, settled, and the gyroscope that it is of.

    The magnetometer's terms read the field as the model has it, so that the chain is settled, corrected and
    settled again; and again where they clip or bend the reading, which is then linearised as it is bent.
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
