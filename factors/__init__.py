"""GTSAM factors for magnetometer and gyroscope calibration; needs gtsam, numpy and,
for the field chain's banded elimination, scipy.

Every gyroscope-bias key may hold a 3-vector, a `Point3` or an `imuBias.ConstantBias`.
"""

from magyc_gtsam.factors.effect_factor import effect_chain_factor, effect_magnetometer_factor
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.field_chain import FieldChain, Noise
from magyc_gtsam.factors.field_chain_factor import field_chain_factor
from magyc_gtsam.factors.field_link import FieldLink, field_link_factor, preintegrate
from magyc_gtsam.factors.guard import NonFiniteError, custom_factor
from magyc_gtsam.factors.gyro_derivative import CompressedGyroDerivative, gyro_derivative_factor
from magyc_gtsam.factors.keyframe_buffer import KeyframeBuffer
from magyc_gtsam.factors.keyframe_field import KeyframeField, keyframe_field_factor
from magyc_gtsam.factors.native import NativeFactors, calibration_prior, native_factor
from magyc_gtsam.factors.pose import magnetometer_factor, scaled_magnetometer_factor, world_field_prior
from magyc_gtsam.factors.preintegration import FieldWindows, Preintegration
from magyc_gtsam.factors.random_walk import gyro_bias_walk, hard_iron_walk, soft_iron_walk
from magyc_gtsam.factors.robust import KERNELS, robust_noise
from magyc_gtsam.factors.soft_iron import determinant_prior, norm_prior, unvech, vech
from magyc_gtsam.factors.sphere import sphere_factor

__all__ = [
    "KERNELS",
    "CompressedGyroDerivative",
    "FieldChain",
    "FieldLink",
    "FieldWindows",
    "KeyframeBuffer",
    "KeyframeField",
    "MagycError",
    "NativeFactors",
    "Noise",
    "NonFiniteError",
    "Preintegration",
    "calibration_prior",
    "custom_factor",
    "determinant_prior",
    "effect_chain_factor",
    "effect_magnetometer_factor",
    "field_chain_factor",
    "field_link_factor",
    "gyro_bias_walk",
    "gyro_derivative_factor",
    "hard_iron_walk",
    "keyframe_field_factor",
    "magnetometer_factor",
    "native_factor",
    "norm_prior",
    "preintegrate",
    "robust_noise",
    "scaled_magnetometer_factor",
    "soft_iron_walk",
    "sphere_factor",
    "unvech",
    "vech",
    "world_field_prior",
]
