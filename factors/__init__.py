"""GTSAM factors for magnetometer and gyroscope calibration, and their numeric core.

`chain/` and `effects/` need only numpy and scipy; most of the other modules build GTSAM factors. Names are imported at
first use, so that the core works where GTSAM has no wheels.

Every factor takes its keys as separate arguments, before the data, in one order, named after their variables:

    attitude_key (or …direction_key), soft_iron_key, hard_iron_key, gyro_bias_key, value_key

and by name where a key is optional: gyro_bias_key, field_key, mounting_key, delay_key; a quantity without a key is
held. `factor.keys()` has the same order. An attitude is a `Pose3`, `Rot3`, `NavState`, `Pose2` or `Rot2`, a gyroscope
bias a 3-vector, `Point3` or `imuBias.ConstantBias`; `variables.py` lists the accepted types.
"""

from __future__ import annotations

from typing import Any

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.lazy import attribute

_PUBLIC = {
    "AlignmentLimits": "alignment",
    "Health": "health",
    "HealthLimits": "health",
    "KERNELS": "kernels",
    "CompressedGyroDerivative": "gyro_derivative",
    "FieldChain": "chain.field_chain",
    "FieldLink": "field_link",
    "FieldWindows": "chain.preintegration",
    "KeyframeBuffer": "keyframe_buffer",
    "KeyframeField": "keyframe_field",
    "NativeFactors": "native",
    "NonFiniteError": "guard",
    "GyroscopeTrack": "chain.gyroscope_track",
    "Preintegration": "chain.preintegration",
    "SensorNoise": "chain.chain_values",
    "calibration_prior": "priors",
    "custom_factor": "guard",
    "determinant_prior": "priors",
    "delay_prior": "priors",
    "effect_chain_factor": "effects.factor",
    "effect_magnetometer_factor": "effects.factor",
    "field_chain_factor": "field_chain",
    "field_link_factor": "field_link",
    "gyro_bias_walk": "priors",
    "gyro_derivative_factor": "gyro_derivative",
    "hard_iron_walk": "priors",
    "keyframe_field_factor": "keyframe_factor",
    "magnetometer_factor": "pose",
    "mounting_prior": "priors",
    "native_factor": "delivered",
    "norm_prior": "priors",
    "preintegrate": "field_link",
    "robust_noise": "robust",
    "scaled_magnetometer_factor": "pose",
    "soft_iron_walk": "priors",
    "sphere_factor": "sphere",
    "unvech": "chain.vech",
    "vech": "chain.vech",
    "world_field_prior": "priors",
}

__all__ = ["MagycError", *_PUBLIC]


def __getattr__(name: str) -> Any:
    return attribute(__name__, _PUBLIC, name)


def __dir__() -> list[str]:
    return sorted(__all__)
