"""One file per published method, one registry."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Recording


@dataclass(frozen=True)
class Method:
    """An entry of the registry.

    Attributes:
        summary: what it is, in one sentence.
        paper: where it was published.
        needs: what the recording must hold beside the magnetic field.
        function: "module:function" that takes (recording, *, progress, **options) and returns a Calibration.
    """

    summary: str
    paper: str
    needs: tuple[str, ...]
    function: str


_METHODS = {
    "smoother": Method(
        "maximum likelihood: field directions chained by the gyroscope and eliminated; robust, with covariance",
        "this project, after MAGYC and Autocal",
        ("angular_rate",),
        "magyc_gtsam.estimators.smoother:calibrate_smoother",
    ),
    "magyc-bfg": Method(
        "batch factor graph on the derivative residual of one-second windows, single state",
        "Rodríguez-Martínez and Troni, MAGYC, section III-C",
        ("angular_rate",),
        "magyc_gtsam.estimators.magyc_bfg:calibrate_magyc_bfg",
    ),
}


def methods() -> Mapping[str, Method]:
    """{name: what it is, its paper, what it needs}."""
    return dict(_METHODS)


def calibrate(
    recording: Recording,
    method: str = "smoother",
    field_strength: float | None = None,
    noise: tuple[float, float] | None = None,
    robust: bool | None = None,
    progress: Callable[[float], None] | None = None,
    **options: Any,
) -> Calibration:
    """Calibrate a recording.

    Args:
        recording: validated data.
        method: a name in `methods()`.
        field_strength: T, strength of the true field; sets the scale of the soft iron. None: det = 1.
        noise: (magnetometer T, gyroscope rad/s) per sample; None lets the method estimate it.
        robust: reject disturbed data; None is the method's default.
        progress: called with the share done, 0 to 1.
        options: the method's own.

    Raises:
        MagycError: unknown method or option, or data that the method cannot use.
    """
    if method not in _METHODS:
        raise MagycError(f"method: {method!r} is none of {', '.join(_METHODS)}")
    if field_strength is not None and not 1e-6 < field_strength < 1e-3:
        raise MagycError(f"field_strength: {field_strength:g} T is no field of the Earth (20e-6 to 70e-6 T)")
    module, name = _METHODS[method].function.split(":")
    function = getattr(importlib.import_module(module), name)
    shared = {"field_strength": field_strength, "noise": noise, "robust": robust}
    given = {k: v for k, v in shared.items() if v is not None} | options
    allowed = function.__kwdefaults__ or {}
    unknown = sorted(given.keys() - allowed.keys())
    if unknown:
        raise MagycError(
            f"method {method!r} has no option {', '.join(map(repr, unknown))}; it has {', '.join(sorted(allowed))}"
        )
    result: Calibration = function(recording, progress=progress, **given)
    return result
