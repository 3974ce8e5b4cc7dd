"""The checked parameters of GTSAM's `ISAM2`."""

from __future__ import annotations

from typing import Literal

import gtsam
import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.runners.status import Method

Factorization = Literal["cholesky", "qr"]

_OPTIMIZERS = {"dogleg": gtsam.ISAM2DoglegParams, "gauss-newton": gtsam.ISAM2GaussNewtonParams}
_FACTORIZATIONS = {"cholesky": "CHOLESKY", "qr": "QR"}


def isam_parameters(
    method: Method, relinearize_threshold: float, radius: float, tolerance: float, factorization: Factorization
) -> gtsam.ISAM2Params:
    """Return the parameters of `ISAM2` for the options of `Incremental`, which documents them.

    Raises:
        MagycError: an option is invalid.
    """
    for option, value, known in (
        ("optimizer", method, _OPTIMIZERS),
        ("factorization", factorization, _FACTORIZATIONS),
    ):
        if value not in known:
            raise MagycError(f"{option} {value!r} unknown; there are {', '.join(known)}")
    if not (np.isfinite(relinearize_threshold) and relinearize_threshold >= 0):
        raise MagycError(f"relinearize_threshold: must be finite and not negative, got {relinearize_threshold}")
    for name, number in (("radius", radius), ("tolerance", tolerance)):
        if not (np.isfinite(number) and number > 0):
            raise MagycError(f"{name}: must be finite and above 0, got {number}")
    optimizer = _OPTIMIZERS[method]()
    if method == "dogleg":
        optimizer.setInitialDelta(radius)
    parameters = gtsam.ISAM2Params()
    parameters.setOptimizationParams(optimizer)
    parameters.setRelinearizeThreshold(relinearize_threshold)
    parameters.relinearizeSkip = 1
    parameters.setFactorization(_FACTORIZATIONS[factorization])
    parameters.findUnusedFactorSlots = True  # otherwise replaced factors leave empty slots behind
    return parameters
