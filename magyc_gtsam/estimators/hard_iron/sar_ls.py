"""SAR-LS: the hard iron by linear least squares on a field that rotates with the gyroscope.

G. Troni and L. L. Whitcomb, "Field sensor bias calibration with angular-rate sensors: theory and experimental
evaluation with application to magnetometer calibration", IEEE/ASME Trans. Mechatronics 24(4), 2019, section
IV-A. The model is ṁ = −ω × (m − h), and the estimate is the h that minimises Σ ‖ṁ + ω × (m − h)‖². The published
equations were not available; the following is derived from that model.

Here the model is integrated over a short window instead of differentiated, ΔR (m' − h) = m − h with ΔR the
gyroscope's rotation from the window's end to its start. To first order in the window this is the paper's
residual times the window's length; it needs no numerical derivative of noisy samples, and no small angles.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.hard_iron.turning import to_calibration, turning_field, windows
from magyc_gtsam.recording import Recording


def calibrate_sar_ls(
    recording: Recording,
    *,
    progress: Callable[[float], None] | None = None,
    field_strength: float | None = None,
    window: float = 1.0,
) -> Calibration:
    """Calibrate with SAR-LS: hard iron only, soft iron a multiple of the identity, gyroscope without bias.

    Args:
        recording: with a gyroscope.
        progress: called with the share done.
        field_strength: T, scales the soft iron; default det 1.
        window: s, over which the field's change is compared with the rotation.

    Raises:
        MagycError: no gyroscope, a window that is not positive, or too short a recording.
    """
    turning = turning_field(recording)
    system = windows(turning, window)
    hard_iron = np.linalg.solve(system.normal, np.einsum("nij,ni->j", system.design, system.change))
    if progress:
        progress(1.0)
    return to_calibration(
        recording,
        hard_iron,
        float(np.linalg.norm(turning.field - hard_iron, axis=1).mean()),
        system.covariance(hard_iron),
        method="sar-ls",
        field_strength=field_strength,
        diagnostics={
            "windows": len(system.design),
            "residual": float(np.sqrt(np.mean(system.left(hard_iron) ** 2))),
        },
        configuration={"window": window},
    )
