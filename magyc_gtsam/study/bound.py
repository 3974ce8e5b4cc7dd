"""The Cramér–Rao bound of a simulated recording, which no unbiased method can beat."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from magyc_gtsam.estimators.gauge import fix_scale
from magyc_gtsam.estimators.smoother.starts import parameters
from magyc_gtsam.factors.chain.chain_values import DELAY, ChainState, SensorNoise
from magyc_gtsam.factors.chain.facts import Fact, quadratic
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array
from magyc_gtsam.simulation import Simulation

_EVERY_SAMPLE = 1e-9  # rad of rotation per window: one window per sample, so that no information is lost


def cramer_rao(simulation: Simulation, facts: Sequence[Fact] = ()) -> Array:
    """Return the bound (12, 12) on the covariance of vech(soft iron, det 1), hard iron T and gyroscope bias rad/s.

    It is the inverse of the information at the truth, and of `facts`, with known delay (zero) and one node per sample.

    Raises:
        MagycError: the recording has no attitude, which gives the true directions, or has a delay.
    """
    recording, truth = simulation.recording, simulation.truth
    if recording.attitude is None or truth.gyro_bias is None or truth.field_strength is None or truth.delay:
        raise MagycError("the bound needs a simulated recording with attitude and without delay")
    samples = Preintegration(*recording.magnetometer, *recording.gyroscope, turn=_EVERY_SAMPLE)
    windows = samples.integrate(truth.gyro_bias)
    chain = FieldChain(windows, SensorNoise(truth.noise["magnetic_field"], truth.noise["angular_rate"]))
    scaled = truth.soft_iron * truth.field_strength
    body = Rotation.from_quat(recording.attitude).inv().apply(simulation.field / np.linalg.norm(simulation.field))
    state = ChainState(
        parameters(scaled, truth.hard_iron, truth.gyro_bias, 0.0),
        np.einsum("ijn,ni->jn", windows.rotation, body),
    )
    information = chain.eliminate(state, chain.unweighted()).information
    information = (information + quadratic(facts, state.parameters)[2])[:DELAY, :DELAY]
    covariance = np.linalg.inv(information).astype(np.float64)
    return fix_scale(scaled, covariance)[2]
