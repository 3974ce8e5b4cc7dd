"""The field chain of one recording, with the terms of a model subtracted from the data.

Terms on the magnetometer are subtracted from the windows' fields, terms on the gyroscope from its samples before
integration. The chain of `factors.chain.field_chain` therefore serves the extended model unchanged; a delay is its
thirteenth parameter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.chain.chain_values import DELAY, ChainState, Reduced
from magyc_gtsam.factors.chain.directions import LinearisedSensor
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.turning import world_of
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.factors.effects.forms import FORMS
from magyc_gtsam.factors.effects.signals import CHANNELS, Signals
from magyc_gtsam.gap.model.problem import Active, Integrated, Model, Problem, added_by, integrated

_ROUNDS = 5  # of the directions and the terms of the magnetometer, which depend on each other
_AGREED = 1e-3  # rad, change of the directions below which a round is the last
_LOGGED = {"time", *CHANNELS}  # signals that do not depend on the model
_NEARBY = 1e-8  # T, step of a numerical derivative


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
        turning=gyroscope.turning,
        to_sensor=to_sensor_of(gyroscope, state),
        soft_iron=soft,
    )


def to_sensor_of(gyroscope: Integrated, state: ChainState) -> Array:
    """Return the rotation (3, 3, n) from the world, in which the field has one direction, to the sensor."""
    parameters, g = state
    rotation = gyroscope.windows.rotation_at(parameters[9:12], float(parameters[DELAY]))
    return np.einsum("ijn,kjn->ikn", rotation, world_of(gyroscope.windows, parameters[9:12], g))


def _bend(bent: Sequence[Active], signals: Signals) -> LinearisedSensor:
    """Return the linearisation of the non-linear terms at the field of the signals."""
    field = signals.need("field")
    more, less = (
        added_by(bent, replace(signals, field=field + step, within=signals.path + step))
        for step in (_NEARBY, -_NEARBY)
    )
    return LinearisedSensor(1 + (more - less) / (2 * _NEARBY), field + signals.need("hard_iron")[:, None])


def build(
    problem: Problem, model: Model, near: tuple[ChainState, Integrated] | None = None
) -> tuple[FieldChain, ChainState, Reduced, Integrated]:
    """Build the chain of a model and optimise its directions, from those of a model near it if there is one.

    Terms of the magnetometer that depend on the field of the model are subtracted with the directions so far, the
    directions optimised, and both again; several times for non-linear terms, at which the reading is then linearised.
    Those of the time or of channels alone are the same for all directions.

    Returns:
        The chain, its state, its linearisation, and the integrated gyroscope.
    """
    gyroscope = integrated(problem, model)
    windows = gyroscope.windows
    plain = FieldChain(windows, model.noise)
    terms = model.on("magnetometer")
    fixed, moving = (
        [t for t in terms if (set(FORMS[t.name].needs) <= _LOGGED) == logged] for logged in (True, False)
    )
    field = windows.field - added_by(fixed, problem.over_windows) if fixed else windows.field
    # Directions are in the world of their integration.
    same = near is not None and near[1] is gyroscope
    state = ChainState(model.parameters, near[0].direction) if near and same else plain.start(model.parameters)
    chain_, bent = FieldChain(replace(windows, field=field), model.noise) if fixed else plain, model.bends
    for _ in range(_ROUNDS):
        if moving:
            signals = window_signals(problem, gyroscope, state)
            corrected = replace(windows, field=field - added_by(moving, signals))
            chain_ = FieldChain(corrected, model.noise, bend=_bend(bent, signals) if bent else None)
        before = state.direction
        state = chain_.settled(state, chain_.unweighted())
        if not terms or np.abs(state.direction - before).max() < _AGREED:
            break
    return chain_, state, chain_.eliminate(state, chain_.unweighted()), gyroscope
