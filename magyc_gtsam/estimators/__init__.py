"""The registry of calibration methods, and `calibrate`; each published method is in its own file."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.calibration.noted import as_mounted, noted, options_among
from magyc_gtsam.estimators.gauge import check_field_strength, check_noise, doubt_strength
from magyc_gtsam.estimators.method import Method, methods_from_outside
from magyc_gtsam.factors.chain.facts import strength_of
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.lazy import requires_gtsam
from magyc_gtsam.factors.one_thread import one_thread
from magyc_gtsam.kept_memory import keep_freed_memory
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.expected import expect_progress, expect_recording
from magyc_gtsam.recording.fingerprint import fingerprint, first_shared
from magyc_gtsam.recording.held import with_chance_repeats
from magyc_gtsam.sensor_faults.usable import without_faults

_METHODS = {
    "smoother": Method(
        "maximum likelihood: field directions chained by the gyroscope and eliminated; robust, with covariance",
        "this project, after MAGYC and Autocal",
        ("angular_rate",),
        "magyc_gtsam.estimators.smoother.smoother:calibrate_smoother",
        "magyc_gtsam.estimators.smoother.options:SmootherOptions",
    ),
    "magyc-bfg": Method(
        "batch factor graph on the derivative residual of one-second windows, single state",
        "Rodríguez-Martínez and Troni, MAGYC, section III-C",
        ("angular_rate",),
        "magyc_gtsam.estimators.magyc.magyc_bfg:calibrate_magyc_bfg",
    ),
    "magyc-ifg": Method(
        "incremental factor graph (iSAM2 with Dogleg) on the same residual, one window at a time",
        "Rodríguez-Martínez and Troni, MAGYC, section III-C",
        ("angular_rate",),
        "magyc_gtsam.estimators.magyc.magyc_ifg:calibrate_magyc_ifg",
        "magyc_gtsam.estimators.magyc.options:IncrementalOptions",
    ),
    "magfactor3": Method(
        "least squares on GTSAM's MagFactor3: known attitude, unknown hard iron and one scale for all axes",
        "GTSAM, MagFactor3; compared in MAGYC, section IV",
        ("attitude",),
        "magyc_gtsam.estimators.hard_iron.magfactor3:calibrate_magfactor3",
    ),
    "sar-ls": Method(
        "least squares on a field that turns with the gyroscope: hard iron only",
        "Troni and Whitcomb 2019, section IV-A",
        ("angular_rate",),
        "magyc_gtsam.estimators.hard_iron.sar_ls:calibrate_sar_ls",
    ),
    "sar-kf": Method(
        "Kalman filter on a field that turns with the gyroscope: hard iron only",
        "Troni and Whitcomb 2019, section IV-B",
        ("angular_rate",),
        "magyc_gtsam.estimators.hard_iron.sar_kf:calibrate_sar_kf",
    ),
    "ellipsoid": Method(
        "algebraic least-squares ellipsoid fit; one outlier can spoil it",
        "Foster and Elkaim 2008",
        (),
        "magyc_gtsam.estimators.ellipsoid.ellipsoid:calibrate_ellipsoid",
    ),
    "kok-schon": Method(
        "algebraic least-squares ellipsoid fit as a semidefinite program; its result is always an ellipsoid",
        "Kok and Schön 2016, section V",
        (),
        "magyc_gtsam.estimators.ellipsoid.kok_schon:calibrate_kok_schon",
    ),
    "l1-ellipsoid": Method(
        "algebraic L1 ellipsoid fit as a semidefinite program; robust to outliers",
        "Calafiore 2002; Autocal, section II-C",
        (),
        "magyc_gtsam.estimators.ellipsoid.l1_ellipsoid:calibrate_l1_ellipsoid",
    ),
    "autocal": Method(
        "robust geometric ellipsoid fit from an L1 start, with covariance",
        "Hong, Kang and Kim, Autocal, 2020",
        (),
        "magyc_gtsam.estimators.autocal.autocal:calibrate_autocal",
    ),
    "twostep": Method(
        "ellipsoid by centred least squares, then Gauss–Newton on the centre's information; with covariance",
        "Alonso and Shuster 2002",
        (),
        "magyc_gtsam.estimators.ellipsoid.twostep:calibrate_twostep",
    ),
    "crassidis": Method(
        "ellipsoid by an extended Kalman filter, sample by sample; with covariance",
        "Crassidis, Lai and Harman 2005",
        (),
        "magyc_gtsam.estimators.ellipsoid.crassidis:calibrate_crassidis",
    ),
    "dorveaux": Method(
        "ellipsoid moved to the sphere by repeated linear least squares",
        "Dorveaux, Vissière, Martin and Petit 2009",
        (),
        "magyc_gtsam.estimators.ellipsoid.dorveaux:calibrate_dorveaux",
    ),
    "vasconcelos": Method(
        "maximum-likelihood ellipsoid by Newton's method, from an algebraic start",
        "Vasconcelos, Elkaim, Silvestre, Oliveira and Cardeira 2011",
        (),
        "magyc_gtsam.estimators.ellipsoid.vasconcelos:calibrate_vasconcelos",
    ),
    "ali-pso": Method(
        "ellipsoid by particle swarm, seeded",
        "Ali, Siddharth, Syed and El-Sheimy 2012",
        (),
        "magyc_gtsam.estimators.ellipsoid.ali_pso:calibrate_ali_pso",
    ),
    "wu-shi": Method(
        "maximum likelihood of ellipsoid and field directions, Newton's method on the Lagrangian",
        "Wu and Shi 2015",
        (),
        "magyc_gtsam.estimators.ellipsoid.wu_shi:calibrate_wu_shi",
    ),
    "magical": Method(
        "MAG.I.C.AL: ellipsoid and field directions by alternating least squares",
        "Papafotis and Sotiriadis 2019",
        (),
        "magyc_gtsam.estimators.ellipsoid.magical:calibrate_magical",
    ),
}


def methods() -> Mapping[str, Method]:
    """Return {name: method}: this package's methods first, then those of other installed packages."""
    return _METHODS | methods_from_outside(_METHODS)


@one_thread
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
        robust: whether to reject disturbed data; None uses the method's default.
        progress: called with the share done, 0 to 1.
        options: options of the method; or those of a calibration, with the entries that describe its recording:
            `calibrate(recording, calibration.method, **calibration.configuration)` repeats it.

    Raises:
        MagycError: unknown method or option, options of a recording in other axes or another unit, a stuck sensor, or
            data that the method cannot use.
    """
    keep_freed_memory()
    entry = _entry(method)
    check_field_strength(field_strength)
    expect_recording("mg.calibrate", recording)
    expect_progress(progress)
    field = recording.magnetic_field
    if (field[-1] == field[0]).all() and (field == field[0]).all():
        raise MagycError("magnetic_field: all rows are the same; the sensor is stuck, or was not turned")
    counts = recording.magnetic_field_unit == "counts"
    if not counts:
        check_noise(noise)
    if counts and (entry.needs or field_strength is not None):
        what = "field_strength" if field_strength is not None else f"method {method!r}"
        raise MagycError(
            f"{what}: needs the field in tesla, and this recording holds raw counts; give tesla per count "
            "(magnetic_unit=), or take a method that needs the magnetometer alone"
        )
    shared = {"field_strength": field_strength, "noise": noise, "robust": robust}
    given = {k: v for k, v in shared.items() if v is not None} | options_among(options, recording)
    function = _function(method, entry, given)
    own, earlier = fingerprint(recording), given.get("prior")
    if isinstance(earlier, Mapping):
        earlier = given["prior"] = Calibration.from_dict(earlier)
    before = earlier.fitted_to if isinstance(earlier, Calibration) else ()
    if first_shared(own, before) is not None:
        raise MagycError(
            "prior: it was fitted to samples of this recording, which would count twice; leave the prior out, or give "
            "one from other recordings"
        )
    usable = without_faults(recording, ("magnetic_field", *entry.needs))
    try:
        result: Calibration = function(with_chance_repeats(usable.recording), progress=progress, **given)
    except MagycError as problem:
        if not usable.refused:
            raise
        raise MagycError(f"{usable.refused}; {problem}") from None
    result = as_mounted(noted(result, recordings=[*before, own]), recording, options.get("compass"))
    left_out = usable.left_out
    if left_out:
        message = f"{result.message}; left out: {'; '.join(left_out)}"
        result = noted(replace(result, message=message), left_out=left_out)
    if result.trusted and result.field_strength is not None and not counts:
        measured = strength_of(result.field_strength * result.soft_iron)
        doubt = doubt_strength(measured, field_strength)
        if doubt:
            result = replace(result, converged=False, message=f"{doubt}; {result.message}")
    if usable.refused:
        result = replace(result, converged=False, message=f"{usable.refused}; {result.message}")
    return result.made_from(recording)


def check_options(method: str = "smoother", **options: Any) -> None:
    """Check the options of `calibrate` without data.

    Raises:
        MagycError: unknown method or option, or a value that is out of range.
    """
    entry = _entry(method)
    given = {
        k: v
        for k, v in options_among(options).items()
        if v is not None or k not in ("field_strength", "noise", "robust")
    }
    _function(method, entry, given)
    check_field_strength(options.get("field_strength"))
    if entry.options:
        _imported(entry.options)(**given)


def _entry(method: Any) -> Method:
    """Return the entry of a method that can be used."""
    entry = (_METHODS.get(method) or methods().get(method)) if isinstance(method, str) else None
    if entry is None:
        raise MagycError(f"method: {method!r} is not one of {', '.join(methods())}")
    if entry.problem:
        raise MagycError(f"method {method!r}: {entry.problem}")
    return entry


def _function(method: str, entry: Method, given: Mapping[str, Any]) -> Callable[..., Calibration]:
    """Return the function of a method that has all the given options."""
    with requires_gtsam(f"method {method!r}"):
        function: Callable[..., Calibration] = _imported(entry.function)
    allowed = (
        _imported(entry.options).__dataclass_fields__
        if entry.options
        else getattr(function, "__kwdefaults__", None) or {}
    )
    unknown = sorted(given.keys() - allowed.keys())
    if unknown:
        there = ", ".join(sorted(allowed.keys() - {"progress"}))
        raise MagycError(f"method {method!r} has no option {', '.join(map(repr, unknown))}; it has {there}")
    return function


@cache  # the look-up of a module that is loaded takes as long as the first checks of a calibration
def _imported(name: str) -> Any:
    """Import and return the object named by "module:name"."""
    module, what = name.split(":")
    return getattr(importlib.import_module(module), what)
