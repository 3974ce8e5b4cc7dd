"""GTSAM factors for magnetometer and gyroscope calibration; needs gtsam and numpy only.

Every gyroscope-bias key may hold a 3-vector, a `Point3` or an `imuBias.ConstantBias`.
"""

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.field_link import FieldLink, field_link_factor, preintegrate
from magyc_gtsam.factors.guard import NonFiniteError, custom_factor
from magyc_gtsam.factors.gyro_derivative import CompressedGyroDerivative, gyro_derivative_factor
from magyc_gtsam.factors.robust import KERNELS, robust_noise
from magyc_gtsam.factors.soft_iron import determinant_prior, norm_prior, unvech, vech
from magyc_gtsam.factors.sphere import sphere_factor

__all__ = [
    "KERNELS",
    "CompressedGyroDerivative",
    "FieldLink",
    "MagycError",
    "NonFiniteError",
    "custom_factor",
    "determinant_prior",
    "field_link_factor",
    "gyro_derivative_factor",
    "norm_prior",
    "preintegrate",
    "robust_noise",
    "sphere_factor",
    "unvech",
    "vech",
]
