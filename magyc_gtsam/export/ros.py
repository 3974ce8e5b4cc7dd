"""ROS 2: parameters in SI units, calibrated = matrix (m − bias)."""

from __future__ import annotations

from collections.abc import Iterable

from magyc_gtsam.export.correction import Correction


def ros(c: Correction) -> list[str]:
    """Return the lines of a parameter file."""
    matrix = c.matrix if c.rotation is None else c.rotation @ c.matrix
    offset, gyro_bias = c.offset, c.gyro_bias
    lines = [
        "# ROS 2 parameters, SI units: magnetic field in tesla, angular rate in rad/s.",
        "# Magnetometer: calibrated = matrix @ (m - bias), the matrix row by row. These are the names",
        "# that magnetometer_pipeline's bias remover reads.",
        "/**:",
        "  ros__parameters:",
        *(f"    initial_mag_bias_{axis}: {_yaml([value])}" for axis, value in zip("xyz", offset, strict=True)),
        f"    initial_mag_scaling_matrix: [{_yaml(matrix.ravel())}]",
    ]
    if gyro_bias is not None:
        lines += ["    # Gyroscope: calibrated = w - bias.", f"    gyroscope_bias: [{_yaml(gyro_bias)}]"]
    return lines


def _yaml(values: Iterable[float]) -> str:
    """Return numbers for YAML 1.1, which reads 2e-06, without a decimal point, as text."""
    return ", ".join(f"{value:.12e}" for value in values)
