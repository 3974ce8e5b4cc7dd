"""What `find_gap` named as a factor of a graph: whole, in stretches, several at once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, H, S, X

import magyc_gtsam as mg
from magyc_gtsam.factors.chain.vech import vech
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.gap import term_factor
from magyc_gtsam.runners.batch import optimize
from magyc_gtsam.runners.incremental import Incremental


@pytest.mark.parametrize("name", ["motor-current", "temperature-gyro"])
def test_what_gap_named_is_a_factor(name: str) -> None:
    """Two stretches of the log share it, and give the value that the search gave, one after the other on iSAM2."""
    simulation = mg.simulate("wide", duration=120, seed=2, effects=[(name, 3.0)])
    found = mg.find_gap(simulation.recording, candidates=[name]).calibration
    (term,) = found.terms
    truth, strength = simulation.truth, found.field_strength
    assert strength is not None
    initial = gtsam.Values()
    initial.insert(S(0), vech(truth.soft_iron) * strength * 1e6)
    initial.insert(H(0), gtsam.Point3(*(truth.hard_iron * 1e6)))
    initial.insert(B(0), gtsam.Point3(0, 0, 0))
    initial.insert(X(0), np.zeros(3))
    runner = Incremental()
    for first in (0, 100):
        stretch = simulation.recording.between(first, first + 100)
        graph = gtsam.NonlinearFactorGraph()
        graph.push_back(term_factor(S(0), H(0), B(0), X(0), stretch, found, term))
        result = runner.update(graph, initial if first == 0 else gtsam.Values())
        assert result.updated, result.message
    value = runner.values.atVector(X(0))
    assert np.all(np.abs(value - term.value) < 1.5 * term.sigma)


def deviations(
    recording: mg.Recording, found: mg.Calibration, length: float
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """What a graph of stretches of this length finds of all terms: its difference, in sigmas, and its sigmas."""
    terms = found.terms
    keys = [S(0), H(0), B(0), *(X(i) for i in range(len(terms)))]
    graph, initial = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for start in np.arange(0, recording.duration, length):
        graph.push_back(term_factor(*keys[:3], keys[3:], recording, found, terms, between=(start, start + length)))
    assert found.field_strength is not None
    assert found.gyro_bias is not None
    initial.insert(S(0), vech(found.soft_iron) * found.field_strength * 1e6)
    initial.insert(H(0), gtsam.Point3(*(found.hard_iron * 1e6)))
    initial.insert(B(0), gtsam.Point3(*found.gyro_bias))
    for i, term in enumerate(terms):
        initial.insert(X(i), np.zeros(len(term.value)))
    result = optimize(graph, initial)
    assert result.converged, result.message
    marginals = gtsam.Marginals(graph, result.values)
    return (
        [(result.values.atVector(X(i)) - term.value) / term.sigma for i, term in enumerate(terms)],
        [np.sqrt(np.diag(marginals.marginalCovariance(X(i)))) / term.sigma for i, term in enumerate(terms)],
    )


@pytest.mark.parametrize("name", ["temperature-hard-iron", "temperature-gyro", "local-anomaly"])
def test_stretches_of_a_minute_share_what_was_found_in_the_whole(name: str) -> None:
    """What acts late, once, or over the whole recording: the value is the one of the whole but for the links lost."""
    recording = mg.simulate("wide", duration=240, seed=2, effects=[(name, 2.0)]).recording
    found = mg.find_gap(recording, candidates=[name]).calibration
    assert [term.name for term in found.terms] == [name]
    (difference,), (sigma,) = deviations(recording, found, 60.0)
    assert np.all(np.abs(difference) < 0.7)
    assert np.all(np.abs(sigma - 1) < 0.1)


def test_two_effects_of_one_recording_are_one_factor() -> None:
    effects = [("motor-current", 2.0), ("misalignment", 2.0)]
    recording = mg.simulate("wide", duration=180, seed=2, effects=effects, channels=["current"]).recording
    found = mg.find_gap(recording, candidates=["motor-current", "misalignment"]).calibration
    assert {term.name for term in found.terms} == {"motor-current", "misalignment"}
    for length in (180.0, 90.0):
        differences, sigmas = deviations(recording, found, length)
        for difference, sigma in zip(differences, sigmas, strict=True):
            assert np.all(np.abs(difference) < 1.0)
            assert np.all(np.abs(sigma - 1) < 0.1)  # a term's own has the model error beside the noise


def test_a_timing_beside_another_effect_is_the_delay_of_their_factor() -> None:
    effects = [("motor-current", 2.0), ("timing", 4.0)]
    recording = mg.simulate("wide", duration=120, rate=20, seed=2, effects=effects).recording
    found = mg.find_gap(recording, candidates=["motor-current", "timing"]).calibration
    assert {term.name for term in found.terms} == {"motor-current", "timing"}
    differences, _ = deviations(recording, found, 200.0)
    assert np.all(np.abs(np.concatenate(differences)) < 0.1)


def test_the_lines_of_the_page_take_what_the_tutorial_names() -> None:
    """A timing alone was refused, which is what `find_gap` names in the tutorial's recording."""
    page = (Path(__file__).parents[1] / "docs" / "slam_measured.md").read_text(encoding="utf-8")
    lines = page.split("## Effects beyond soft and hard iron")[1].split("```python\n")[1].split("```")[0]
    recording = mg.simulate("dive", effects=["timing"], seed=1).recording
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    known: dict[str, Any] = {"recording": recording, "graph": graph, "values": values}
    exec(lines, known)
    (term,) = known["found"].terms
    assert term.name == "timing"
    result = optimize(graph, values)
    assert result.converged, result.message
    value = result.values.atVector(known["E"](0))
    assert np.abs(value - term.value) < term.sigma
    one, _ = deviations(recording.between(0, 120), known["found"], 200.0)
    other, _ = deviations(recording.between(0, 120), known["found"], 60.0)
    assert np.abs(one[0] - other[0]) < 1.0


def test_what_is_no_variable_of_a_factor_is_refused() -> None:
    recording = mg.simulate("wide", duration=60, seed=2).recording
    cal = mg.Calibration(np.eye(3), np.zeros(3), np.zeros(3), field_strength=5e-5)
    keys = (S(0), H(0), B(0), X(0))
    tone = Term("tone", np.ones(6) * 1e-7, np.eye(6), {"frequency": 1.5})
    with pytest.raises(mg.MagycError, match=r"silenced\(recording"):
        term_factor(*keys, recording, cal, tone)
    step = Term("hard-iron-step", np.zeros(3), np.eye(3), {"time": 20.0})
    with pytest.raises(mg.MagycError, match="1 value keys for 2 terms"):
        term_factor(*keys, recording, cal, [step, step])
    with pytest.raises(mg.MagycError, match="lacks field strength or noise"):
        term_factor(*keys, recording, cal, step)
    with pytest.raises(mg.MagycError, match="at least 3"):
        term_factor(
            *keys,
            recording,
            replace(cal, noise={"magnetic_field": 1e-6, "angular_rate": 5e-3}),
            step,
            between=(58, 59),
        )


def test_a_gyroscope_in_other_axes_is_refused() -> None:
    """Its rates would be integrated as if they were in the magnetometer's axes."""
    recording = mg.simulate("wide", duration=60, seed=2).recording
    base = mg.calibrate(recording)
    term = Term("hard-iron-drift", np.full(3, 1e-7), np.eye(3) * 1e-16)
    turned = replace(base, terms=(Term("axis-order", np.eye(3)[[1, 0, 2]].ravel() * 1.0, np.zeros((9, 9))), term))
    with pytest.raises(mg.MagycError, match="'axis-order' turns the gyroscope"):
        term_factor(S(0), H(0), B(0), X(0), recording, turned, term)
