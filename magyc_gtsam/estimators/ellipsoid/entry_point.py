"""The entry point of methods that fit an ellipsoid to all samples at once and have no options in T."""

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
        fit: samples (n, 3) without units, and keywords with defaults → ellipsoid; the keyword `progress`, where it has
            one, is a function of the share done.
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
        with fitting(method):
            ellipsoid = fit(samples.value, **options, **({"progress": progress} if reports else {}))
        if progress:
            progress(1.0)
        configuration = {name: list(v) if isinstance(v, tuple) else v for name, v in options.items()}
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
