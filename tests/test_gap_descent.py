"""Where the descent of a model ends that does not explain the data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.model import descent
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.model.problem import Active
from magyc_gtsam.gap.model.refit import refit, with_term
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.study.faults.catalogue import FAULTS
from magyc_gtsam.study.faults.signals import record


def test_a_stalled_descent_does_not_try_longer_steps_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Delays that do not change, of clocks that drift apart: steps that raise the cost by what rounding allows."""
    fault = FAULTS["clock-drift"]
    recording = record("moderate", 0, fault, fault.strong, "clock-drift").recording("log")
    noise = short_term_noise(recording)
    base = base_model(recording, None, noise)
    tried: list[tuple[int, float]] = []

    def advance(twin: Twin, steps: Iterator[Array], rounding: float) -> tuple[Twin | None, int]:
        ahead, failed = advanced(twin, steps, rounding)
        tried.append((failed, np.inf if ahead is None else descent._cost(ahead) - descent._cost(twin)))
        return ahead, failed

    advanced = descent._advance
    monkeypatch.setattr(descent, "_advance", advance)
    model = with_term(replace(base.model, noise=noise), Active("axis-delays", {}, np.zeros(3)))
    fit = refit(base.twin.problem, model, None)
    assert not fit.converged
    stalled = [place for place, (failed, rise) in enumerate(tried) if failed and rise >= 0]
    assert stalled
    assert all(failed == 0 for failed, _ in tried[stalled[0] + 1 :])


def test_the_parameters_follow_a_bent_term_only_while_that_helps(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = record("moderate", 0).recording("log")
    base = base_model(recording, None, short_term_noise(recording))
    count = len(base.twin.columns("cubic", {}).window)
    twin = Twin.of(base.twin.problem, with_term(base.model, Active("cubic", {}, np.zeros(count))))
    step = np.zeros(len(twin.base_columns))
    step[-count:] = 0.5e-6 / np.abs(twin.columns("cubic", {}).window).max()  # half a microtesla
    followed: list[Twin] = []

    def follow(ahead: Twin) -> Twin:
        followed.append(ahead)
        return ahead

    monkeypatch.setattr(descent, "_followed", follow)
    assert descent._advance(twin, [step], 0.5) == (None, 1)
    assert len(followed) == 1


def test_a_step_that_leads_out_of_range_is_not_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is too long, and a damped one is tried; it ended `find_gap` with an error about a term."""
    recording = record("moderate", 0).recording("log")
    base = base_model(recording, None, short_term_noise(recording))

    def out_of_range(twin: Twin) -> Array:
        raise MagycError("the innovations of the model have no finite covariance: a term is out of range")

    monkeypatch.setattr(Twin, "parameter_columns", property(out_of_range))
    assert descent._followed(base.twin) is None
