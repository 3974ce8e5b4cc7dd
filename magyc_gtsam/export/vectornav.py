"""VectorNav: registers 23 and 84, field = C (M − B) in gauss, rate = C (G − B)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from magyc_gtsam.export.correction import GAUSS, Array, Correction, number


def vectornav(c: Correction) -> list[str]:
    """Return the lines to send to the instrument."""
    matrix = c.matrix if c.rotation is None else c.rotation @ c.matrix
    offset, gyro_bias = c.offset, c.gyro_bias
    lines = [
        "# VectorNav registers: send the lines that begin with a dollar sign; command WNV stores them.",
        "# For data recorded while these registers held their defaults; otherwise both corrections add up.",
        "# Register 23, magnetometer: field = C * (M - B), C row by row, B in gauss.",
        _register(23, matrix, offset * GAUSS),
    ]
    if gyro_bias is not None:
        lines += [
            "# Register 84, gyroscope: rate = C * (G - B), C row by row, B in rad/s.",
            _register(84, np.eye(3), gyro_bias),
        ]
    return lines


def _register(place: int, matrix: Array, offset: Array) -> str:
    values: Iterable[float] = (*matrix.ravel(), *offset)
    body = f"VNWRG,{place}," + ",".join(number(value) for value in values)
    return f"${body}*{_checksum(body):02X}"


def _checksum(body: str) -> int:
    result = 0
    for byte in body.encode("ascii"):
        result ^= byte
    return result
