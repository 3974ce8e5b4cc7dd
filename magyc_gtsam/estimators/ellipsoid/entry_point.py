"""The entry point of methods that fit an ellipsoid to the samples of the magnetometer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.ellipsoid.magnetometer_only import (
    Ellipsoid,
    fitting,
    normalised_field,
    to_calibration,
)
from magyc_gtsam.recording import Recording


def entry_point(method: str, fit: Callable[..., Ellipsoid]) -> Callable[..., Calibration]:
    """Return the entry point of a method, whose options are the keywords of its fit.

    Args:
        method: name in the registry.
        fit: samples (n, 3) without units, and keywords with defaults → ellipsoid. Where it has them, the keyword
            `progress` is a function of the share done, and `noise` the sigma of a sample, in the unit of the samples.
    """
    defaults = dict(fit.__kwdefaults__ or {})
    reports = "progress" in defaults
    defaults.pop("progress", None)

    def calibrate(
        recording: Recording,
        *,
        field_strength: float | None = None,
        progress: Callable[[float], None] | None = None,
        **chosen: Any,
    ) -> Calibration:
        """Calibrate the magnetometer by an ellipsoid fit.

        Args:
            recording: with a magnetometer.
            field_strength: T, strength of the true field; sets the scale of the soft iron. None: det = 1.
            progress: called with the share done, 0 to 1.
            chosen: the keywords of the fit.

        Raises:
            MagycError: samples that no ellipsoid explains.
        """
        options = defaults | chosen
        samples = normalised_field(recording)
        noise = options.get("noise")  # (magnetometer T, gyroscope rad/s)
        own = options if noise is None else options | {"noise": noise[0] / samples.unit}
        with fitting(method):
            ellipsoid = fit(samples.value, **own, **({"progress": progress} if reports else {}))
        if progress:
            progress(1.0)
        told = {name: value for name, value in options.items() if value is not None}
        configuration = {name: list(value) if isinstance(value, tuple) else value for name, value in told.items()}
        return to_calibration(
            recording,
            samples,
            ellipsoid,
            method=method,
            field_strength=field_strength,
            configuration=configuration,
        )

    # The registry reads the options of a method here.
    calibrate.__kwdefaults__ = {"field_strength": None, "progress": None, **defaults}
    return calibrate
