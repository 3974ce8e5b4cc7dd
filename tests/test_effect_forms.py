"""Forms of non-linear effects against responses that they were not derived from, and along the path within windows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.preparation import preintegrate, short_term_noise
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.forms import FORMS
from magyc_gtsam.factors.effects.signals import Signals
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.model.problem import Problem
from magyc_gtsam.gap.model.twin import Twin


def reading(x: Array) -> Signals:
    """Signals whose field along x is given, in T."""
    field = np.zeros((3, len(x)))
    field[0] = x
    return Signals(np.arange(len(x)), field=field, hard_iron=np.zeros(3))


def left(wanted: Array, *known: Array) -> float:
    """Share of the square of a response that a sum of known ones does not explain."""
    columns = np.stack(known, axis=1)
    value, *_ = np.linalg.lstsq(columns, wanted, rcond=None)
    return float(((wanted - columns @ value) ** 2).sum() / (wanted**2).sum())


@pytest.mark.parametrize(
    "core",
    [np.tanh, lambda u: 1 / np.tanh(3 * u + 1e-9) - 1 / (3 * u + 1e-9), lambda u: 1 - np.exp(-u), np.arctan],
)
def test_a_core_saturates_as_one_knee(core: Callable[[Array], Array]) -> None:
    """Hyperbolic tangent, Langevin's function, an exponential and an arc tangent, from 80 % of the full scale on."""
    x = np.linspace(0, 60e-6, 800)
    full, level = 57e-6, 45e-6
    loss = x - np.minimum(x, level) - (full - level) * core(np.clip(x - level, 0, None) / (full - level))
    tried = [
        FORMS["saturation"].columns(reading(x), {"level": at * 60e-6, "fall": (1 - at) * 60e-6 * share})[0, 0]
        for at in np.linspace(0.6, 0.95, 36)
        for share in (0.25, 0.5, 0.75, 1.0)
    ]
    assert min(left(loss, each, x) for each in tried) < 4e-4


def test_a_loop_remembers_where_it_turned_back() -> None:
    """The pieces of a loop, one by one, and small loops inside large ones that leave no trace (return-point memory)."""
    random = np.random.default_rng(0)
    x = 1e-6 * np.cumsum(random.standard_normal(300))
    width = 8e-6
    loop = FORMS["hysteresis"].columns(reading(x), {"coercive": width})[0, 0]
    state, wanted = np.zeros(8), []
    limits = width * (np.arange(8) + 0.5) / 8
    for change in np.diff(x, prepend=x[0]):
        state = np.clip(state + change, -limits, limits)
        wanted.append(state.mean() / width)
    np.testing.assert_allclose(loop, wanted, atol=1e-12)
    up = np.linspace(-30e-6, 30e-6, 61)
    there = np.concatenate([up, up[-2:20:-1], up[21:]])  # back to the middle, and up again
    z = FORMS["hysteresis"].columns(reading(there), {"coercive": width})[0, 0]
    assert z[-1] == pytest.approx(z[60], abs=1e-12)


@pytest.mark.parametrize(
    ("name", "setting"), [("saturation", {"level": 40e-6}), ("hysteresis", {"coercive": 8e-6}), ("cubic", {})]
)
def test_a_window_is_no_point_of_the_path(name: str, setting: dict[str, float]) -> None:
    """The mean response over a window, in which the field moves by 10 µT, is that of its samples within 5 %."""
    recording = mg.simulate("wide", 60, seed=2, rate=50).recording
    noise = short_term_noise(recording)
    twin = base_model(recording, None, noise).twin
    fine = Twin.of(Problem.of(recording, preintegrate(recording, window=1e-9)), twin.model)
    within = twin.columns(name, setting).window
    wanted = twin.problem.mean(fine.columns(name, setting).window)
    centre = FORMS[name].columns(replace(twin.windows, within=None), setting)
    off, coarse = (np.sqrt(((each - wanted) ** 2).mean()) for each in (within, centre))
    assert off < 0.05 * wanted.std()
    assert off < 0.7 * coarse
