"""A factor for the user's own graph with the effects that `find_gap` named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import gtsam
import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.preparation import preintegrate
from magyc_gtsam.factors.effects.factor import effect_chain_factor
from magyc_gtsam.factors.effects.forms import FORMS
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import listed_keys
from magyc_gtsam.gap.model.problem import Active, Problem
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.preparation.channel_holes import without_channel_holes
from magyc_gtsam.gap.validation import as_model
from magyc_gtsam.recording import Recording


def term_factor(
    soft_iron_key: int,
    hard_iron_key: int,
    gyro_bias_key: int,
    value_key: int | Sequence[int],
    recording: Recording,
    calibration: Calibration,
    term: Term | Sequence[Term],
    *,
    between: tuple[float, float] | None = None,
    window: float = 1.0,
    soft_iron_unit: float = 1e-6,
    field_unit: float = 1e-6,
) -> gtsam.CustomFactor:
    """Return a factor over a recording or an interval of it, on soft iron, hard iron, gyroscope bias and terms' values.

    An interval needs the whole recording: a temperature acts with a lag, and the axes of an anomaly are those of the
    first row. Therefore select it with `between` instead of cutting the recording.

    Args:
        soft_iron_key, hard_iron_key, gyro_bias_key: as in `effect_chain_factor`.
        value_key: key of the term's value; or a sequence of keys, one per term.
        recording: the whole recording.
        calibration: the result of `find_gap`, or any calibration with noise and field strength; its other terms are
            not in the factor.
        term: one or several terms of the catalogue, with values in SI units. Effects of the same data belong in one
            factor. A timing is the delay of the chain; without one the calibration's delay is fixed.
        between: start and end of the interval, s since the first row; a window that begins at the end is not in it.
        window: length of a window, s.
        soft_iron_unit, field_unit: T per unit of the keys.

    Raises:
        MagycError: a term that is not an effect on a reading, or a tone; not one key per term; a
            channel that the recording lacks; a calibration without noise or field strength, or with the gyroscope in
            other axes than the recording's; an interval of fewer than 3 windows.
    """
    terms = [term] if isinstance(term, Term) else list(term)
    own = [each for each in terms if each.name != "timing"]
    value_keys = listed_keys(value_key)
    _check(calibration, terms, own, value_keys)
    start = recording.time[0]
    recording, _ = without_channel_holes(recording)
    problem = Problem.of(recording, preintegrate(recording, window))
    model = as_model(problem, replace(calibration, terms=()))
    twin = Twin.of(problem, replace(model, terms=tuple(Active(t.name, t.setting, t.value) for t in own)))
    part = None
    if between is not None:
        begin = problem.samples.magnetometer_time[problem.samples.starts] - start
        first, last = np.searchsorted(begin, between)
        part = int(first), int(last)
    at = {"magnetometer": twin.windows, "gyroscope": twin.gyroscope}
    key_of = list(zip(terms, value_keys, strict=True))
    late = [key for each, key in key_of if each.name == "timing"]
    return effect_chain_factor(
        soft_iron_key,
        hard_iron_key,
        gyro_bias_key,
        [key for each, key in key_of if each.name != "timing"],
        problem.samples,
        [FORMS[t.name].columns(at[FORMS[t.name].side], t.setting) for t in own],
        model.noise,
        side=["gyroscope" if t.side == "gyroscope" else "magnetometer" for t in own],
        delay_key=late[0] if late else None,
        delay=calibration.delay,
        part=part,
        soft_iron_unit=soft_iron_unit,
        field_unit=field_unit,
    )


def _check(calibration: Calibration, terms: Sequence[Term], own: Sequence[Term], keys: Sequence[int]) -> None:
    for term in terms:
        if term.side is None:
            raise MagycError(f"term {term.name!r}: it changes no reading, so no factor holds it; leave it out")
        if term.name == "tone":
            raise MagycError(
                "term 'tone': the windows' means do not hold it; take it out of the readings first, by "
                "magyc_gtsam.gap.samples.tones.silenced(recording, [term]), and leave it out of the factor"
            )
    if any(term.name == "axis-order" for term in calibration.terms):
        raise MagycError(
            "calibration: its term 'axis-order' turns the gyroscope, whose rates in the recording are in other axes; "
            "turn them, and give a calibration of that recording"
        )
    if not terms:
        raise MagycError("term: at least one term is needed, got none; without one use field_chain_factor")
    if len(terms) > len(own) + 1:
        raise MagycError(f"{len(terms) - len(own)} timings: a factor has one delay")
    if len(keys) != len(terms):
        raise MagycError(f"{len(keys)} value keys for {len(terms)} terms; each term has a key of its own")
    if calibration.field_strength is None or not {"magnetic_field", "angular_rate"} <= calibration.noise.keys():
        raise MagycError(
            f"the calibration of method {calibration.method!r} lacks field strength or noise; calibrate with smoother"
        )
