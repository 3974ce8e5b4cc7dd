"""The entry point of methods that iterate over all samples at once; that of the algebraic fits is in `ellipsoid`."""

from __future__ import annotations

import inspect
from collections.abc import Callable

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.ellipsoid.magnetometer_only import (
    Ellipsoid,
    fitting,
    normalised_field,
    to_calibration,
)
from magyc_gtsam.recording import Recording


def iterative(method: str, fit: Callable[..., Ellipsoid]) -> Callable[..., Calibration]:
    """Return the entry point of a method that iterates over all samples at once.

    Args:
        method: name in the registry.
        fit: samples (n, 3) without units, and the keywords `tolerance` and `max_iterations` with defaults → ellipsoid.
    """
    defaults = inspect.signature(fit).parameters

    def calibrate(
        recording: Recording,
        *,
        field_strength: float | None = None,
        tolerance: float = defaults["tolerance"].default,
        max_iterations: int = defaults["max_iterations"].default,
        progress: Callable[[float], None] | None = None,
    ) -> Calibration:
        """Calibrate the magnetometer by an iterated ellipsoid fit.

        Args:
            recording: with a magnetometer.
            field_strength: T, strength of the true field; sets the scale of the soft iron. None: det = 1.
            tolerance, max_iterations: of the fit.
            progress: called with the share done, 0 to 1.

        Raises:
            MagycError: samples that no ellipsoid explains.
        """
        options = {"tolerance": tolerance, "max_iterations": max_iterations}
        samples = normalised_field(recording)
        with fitting(method):
            ellipsoid = fit(samples.value, **options)
        if progress:
            progress(1.0)
        return to_calibration(
            recording, samples, ellipsoid, method=method, field_strength=field_strength, configuration=options
        )

    return calibrate
