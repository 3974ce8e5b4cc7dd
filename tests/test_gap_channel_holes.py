"""A channel that was not logged all the time: its pauses are filled, its holes left out, neither becomes a name."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, H, S, X

import magyc_gtsam as mg
from magyc_gtsam.factors import vech
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.gap import term_factor
from magyc_gtsam.gap.preparation.channel_holes import without_channel_holes
from magyc_gtsam.recording import Array
from magyc_gtsam.simulation.environment import CHANNELS


def _driven(seed: int, seconds: float = 200.0) -> mg.Recording:
    return mg.simulate("wide", seconds, seed=seed, effects=[("motor-current", 1.5)], channels=CHANNELS).recording


def _current(recording: mg.Recording) -> str:
    return next(name for name in recording.channels if "current" in name)


def _logged(recording: mg.Recording, where: np.ndarray) -> mg.Recording:
    name = _current(recording)
    channel = np.where(where, recording.channels[name], np.nan)
    return replace(recording, channels={**recording.channels, name: channel})


@pytest.mark.parametrize("seed", [41, 42])
def test_a_current_that_was_logged_late_is_all_that_is_named(seed: int) -> None:
    recording = _driven(seed)
    gap = mg.find_gap(_logged(recording, recording.time >= 75))
    assert gap.names == ("motor-current",)
    (left_out,) = gap.diagnostics["left_out"]
    assert left_out.startswith("750 rows from 0.0 to 74.9 s, in which")


def test_sparse_values_are_a_channel() -> None:
    """Every twentieth row, as a slow stream beside a fast one has it."""
    recording = _driven(44)
    sparse = _logged(recording, np.arange(len(recording.time)) % 20 == 0)
    filled, said = without_channel_holes(sparse)
    assert not said
    assert len(filled.time) == len(recording.time)
    name = _current(recording)
    assert np.corrcoef(filled.channels[name], recording.channels[name])[0, 1] > 0.9
    gap = mg.find_gap(sparse, candidates=["motor-current", "hard-iron-drift"])
    assert "motor-current" in gap.names
    # What was found can be used: taken out of the readings, and in a graph.
    assert np.isfinite(gap.calibration.apply(sparse)).all()
    term = next(term for term in gap.calibration.terms if term.name == "motor-current")
    assert np.isfinite(_information(sparse, gap.calibration, term)).all()


def test_a_hole_is_in_no_factor() -> None:
    """A value that is determined by the rows in which the current was logged alone."""
    recording = _driven(47)
    late = _logged(recording, recording.time >= 75)
    gap = mg.find_gap(late, candidates=["motor-current"])
    (term,) = gap.calibration.terms
    whole, part = (_information(each, gap.calibration, term) for each in (recording, late))
    assert np.all(np.diag(part) < 0.95 * np.diag(whole))
    assert np.all(np.diag(part) > 0.4 * np.diag(whole))


def _information(recording: mg.Recording, calibration: mg.Calibration, term: Term) -> Array:
    """(3, 3) of the term's value, in the factor of a recording."""
    keys = [S(0), H(0), B(0), X(0)]
    values = gtsam.Values()
    unit = 1e6 * float(calibration.field_strength or 0)
    assert calibration.gyro_bias is not None
    for key, value in zip(
        keys,
        (unit * vech(calibration.soft_iron), 1e6 * calibration.hard_iron, calibration.gyro_bias, term.value),
        strict=True,
    ):
        values.insert(key, value)
    linear = term_factor(*keys, recording, calibration, term).linearize(values)
    result: Array = linear.information()[-3:, -3:]
    return result


def test_a_channel_that_is_hardly_there_is_not_tested() -> None:
    recording = _driven(45, 300.0)
    gap = mg.find_gap(_logged(recording, recording.time < 100), candidates=["motor-current", "hard-iron-step"])
    assert [each.name for each in gap.untested] == ["motor-current"]
    assert "was logged in 33% of the rows only" in gap.diagnostics["left_out"][0]
    assert gap.base.diagnostics["windows"] >= 300


def test_each_circuit_is_spoken_of_by_its_name() -> None:
    """The second motor's field, beside a first that does nothing."""
    recording = _driven(46, 300.0)
    name = _current(recording)
    other = np.random.default_rng(46).normal(size=len(recording.time)).cumsum()
    channels = {key: value for key, value in recording.channels.items() if key != name}
    both = replace(recording, channels={**channels, "a_current": other, "b_current": recording.channels[name]})
    (effect,) = mg.find_gap(both, candidates=["motor-current"]).effects
    assert effect.parameters[0] == "x of a_current"
    assert effect.parameters[-1] == "z of b_current"
    assert effect.sentence.startswith("b_current: a current adds ")
    assert "a_current" not in effect.sentence
    (alone,) = mg.find_gap(recording, candidates=["motor-current"]).effects
    assert np.linalg.norm(effect.value[3:] - alone.value) < 5 * np.linalg.norm(alone.sigma)
