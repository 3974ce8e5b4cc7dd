"""The gap workflow's channels: what agrees by chance is no name, what hardly moves the iron leaves it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.gap.refit import unmoved
from magyc_gtsam.recording import Array

_DEPTH = "depth"


def _wandering(seed: int, count: int) -> Array:
    """(count,) a slow signal of unit deviation that comes of nothing here."""
    steps = np.random.default_rng(seed).standard_normal(count)
    walk = np.cumsum(steps - steps.mean())
    result: Array = (walk - walk.mean()) / walk.std()
    return result


def _in_a_room(seed: int, depth: Array | None = None) -> mg.Recording:
    """A room whose field grows by 2 % along a way that a wandering vehicle takes; `depth` may be another way."""
    simulation = mg.simulate("wide", seed=seed)
    recording, iron = simulation.recording, simulation.truth.hard_iron
    way = _wandering(100 + seed, len(recording.time))
    field = iron + (recording.magnetic_field - iron) * (1 + 0.02 * way[:, None])
    return replace(recording, magnetic_field=field, channels={_DEPTH: way if depth is None else depth})


def _standing(recording: mg.Recording) -> str:
    """Of the gradient among the hypotheses of a search for nothing else."""
    gap = mg.find_gap(recording, candidates=["field-gradient"])
    return next(h.status for h in gap.hypotheses if h.name == "field-gradient")


def test_a_channel_that_agrees_by_chance_is_no_name() -> None:
    """Of ways that have nothing to do with the field some explain much of it, and are vetoed."""
    assert _standing(_in_a_room(1)) == "named"
    others = [_standing(_in_a_room(1, _wandering(200 + k, 6000))) for k in range(16)]
    assert others.count("vetoed") >= 2
    assert not {"named", "explained"}.intersection(others)


def test_what_hardly_moves_the_iron_leaves_it() -> None:
    """By 0.1 sigma it stays, terms and bias are the new ones; by one sigma all is new."""
    before = mg.calibrate(mg.simulate("wide", seed=1).recording)
    for share, stays in ((0.1, True), (1.0, False)):
        after = replace(
            before,
            soft_iron=before.soft_iron + share * before.sigma["soft_iron"],
            hard_iron=before.hard_iron + share * before.sigma["hard_iron"],
            gyro_bias=before.gyro_bias + 1e-3,
        )
        result = unmoved(before, after)
        expected = before if stays else after
        np.testing.assert_array_equal(result.soft_iron, expected.soft_iron)
        np.testing.assert_array_equal(result.hard_iron, expected.hard_iron)
        np.testing.assert_array_equal(result.gyro_bias, after.gyro_bias)
