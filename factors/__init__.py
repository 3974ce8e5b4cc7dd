"""GTSAM factors for magnetometer and gyroscope calibration; needs gtsam, numpy and,
for the field chain's banded elimination, scipy.

Every gyroscope-bias key may hold a 3-vector, a `Point3` or an `imuBias.ConstantBias`.
"""

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.field_chain import FieldChain, Noise
from magyc_gtsam.factors.field_chain_factor import field_chain_factor
from magyc_gtsam.factors.field_link import FieldLink, field_link_factor, preintegrate
from magyc_gtsam.factors.guard import NonFiniteError, custom_factor
from magyc_gtsam.factors.gyro_derivative import CompressedGyroDerivative, gyro_derivative_factor
from magyc_gtsam.factors.preintegration import FieldWindows, Preintegration
from magyc_gtsam.factors.robust import KERNELS, robust_noise
from magyc_gtsam.factors.soft_iron import determinant_prior, norm_prior, unvech, vech
from magyc_gtsam.factors.sphere import sphere_factor

__all__ = [
    "KERNELS",
    "CompressedGyroDerivative",
    "FieldChain",
    "FieldLink",
    "FieldWindows",
    "MagycError",
    "Noise",
    "NonFiniteError",
    "Preintegration",
    "custom_factor",
    "determinant_prior",
    "field_chain_factor",
    "field_link_factor",
    "gyro_derivative_factor",
    "norm_prior",
    "preintegrate",
    "robust_noise",
    "sphere_factor",
    "unvech",
    "vech",
]
