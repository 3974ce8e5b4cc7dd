"""`smoother`: the maximum-likelihood calibration under the sensor model (docs/field_chain.md), the default.

The field's direction is a Markov chain under the gyroscope; eliminating it leaves thirteen parameters:
soft iron (times field strength), hard iron, gyroscope bias and the magnetometer's delay. No start, no
attitude and no noise level is asked of the user.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.chain_fit import Fit
from magyc_gtsam.estimators.chain_search import Progress, fit_field_chain, positive
from magyc_gtsam.estimators.clock_drift import MOST, find_drift, restamped, with_drift
from magyc_gtsam.estimators.gauge import fix_scale
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.field_chain import DELAY
from magyc_gtsam.factors.soft_iron import unvech
from magyc_gtsam.observability import Observability, assess
from magyc_gtsam.recording import Array, Recording

_MOST_UNEXPLAINED = 0.1  # share of the field strength left unexplained in a window
_LEAST_TRUSTED = 0.5  # share of the windows' weight below which the result must not be trusted


def calibrate_smoother(
    recording: Recording,
    *,
    field_strength: float | None = None,
    noise: tuple[float, float] | None = None,
    robust: bool | None = None,
    delay: float | None = None,
    window: float = 1.5,
    turn: float | None = None,
    clock_drift: float = 0.0,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate by the field smoother.

    Args:
        recording: with magnetometer and gyroscope.
        field_strength: T, strength of the true field; sets the scale of the soft iron. None: det = 1.
        noise: (magnetometer T, gyroscope rad/s) per sample; None estimates both.
        robust: reject disturbed windows; None and True do.
        delay: s by which the magnetometer lags; None estimates it, a number fixes it.
        window: s, longest window.
        turn: rad, largest rotation inside a window; None chooses it from the spread of the data.
        clock_drift: s/s that the magnetometer's clock gains on the gyroscope's, taken out of its stamps from the first
            row on. What is left of one is found, and a result that it harms is not trusted.
        progress: called with the share done, 0 to 1.

    Raises:
        MagycError: no gyroscope, too few samples, or sensors whose axes or units disagree.
    """
    check_options(noise, robust, delay, window, turn, clock_drift)
    report = progress or (lambda _: None)
    report(0.0)
    options: dict[str, Any] = {"noise": noise, "robust": robust, "delay": delay, "window": window, "turn": turn}
    configuration = options | {"robust": robust is not False}
    del configuration["noise"]
    if noise is not None:
        configuration["noise"] = list(noise)
    if clock_drift:
        configuration["clock_drift"] = clock_drift
        recording = restamped(recording, clock_drift)
    fit, rival = fit_field_chain(recording, **options, progress=report)
    calibration = calibration_of(recording, fit, rival, field_strength, configuration)

    def refit(again: Recording, start: Array | None) -> tuple[Fit, bool]:
        fit, rival = fit_field_chain(again, **options, start=start)
        return fit, calibration_of(again, fit, rival, field_strength, configuration).converged

    drift = find_drift(recording, fit, calibration.converged, refit)
    report(1.0)
    return with_drift(calibration, None if drift is None else drift._replace(known=clock_drift))


def check_options(noise: Any, robust: Any, delay: Any, window: Any, turn: Any, clock_drift: Any) -> None:
    """Refuse what is no option.

    Raises:
        MagycError: an option that is out of range.
    """
    if robust not in (None, True, False):
        raise MagycError(
            f"robust: {robust!r} is neither True nor False; this method has one rejection of its own, the kernels "
            "of magyc_gtsam.factors.KERNELS are for graphs"
        )
    _number("window", window, 0.0, 60.0, "s")
    _number("clock_drift", clock_drift, -MOST, MOST, "s/s")
    if turn is not None:
        _number("turn", turn, 0.0, np.pi, "rad")
    if delay is not None:
        _number("delay", delay, -1.0, 1.0, "s")
    if noise is not None:
        if not isinstance(noise, (tuple, list)) or len(noise) != 2:
            raise MagycError(f"noise: {noise!r} is no pair (magnetometer T, gyroscope rad/s)")
        _number("noise of the magnetometer", noise[0], 0.0, 1e-3, "T")
        _number("noise of the gyroscope", noise[1], 0.0, 10.0, "rad/s")


def _number(name: str, value: Any, low: float, high: float, unit: str) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)) or not low < value < high:
        raise MagycError(f"{name}: {value!r} is no number between {low:g} and {high:g} {unit}")


def calibration_of(
    recording: Recording,
    fit: Fit,
    rival: Fit | None,
    field_strength: float | None,
    configuration: dict[str, Any],
    colour: float | None = None,
) -> Calibration:
    """The result of a fit, its covariance and why it must not be trusted, if so.

    `colour` stands for the fit's own where that holds only the end of a longer chain.
    """
    colour = fit.colour if colour is None else colour
    parameters, covariance = fit.state.parameters, fit.covariance * (colour * fit.widening)
    soft_iron, unit, reported = fix_scale(unvech(parameters[:6]), covariance[:12, :12], field_strength)
    observability = assess(reported, soft_iron, unit, recording)
    reasons = _reasons(fit, rival, unit, observability)
    noise = fit.chain.noise
    return Calibration(
        soft_iron=soft_iron,
        hard_iron=parameters[6:9],
        gyro_bias=parameters[9:12],
        covariance=reported,
        delay=float(parameters[DELAY]),
        delay_sigma=float(np.sqrt(covariance[DELAY, DELAY])) if fit.free[DELAY] else None,
        converged=not reasons,
        message="; ".join(reasons) or f"converged in {fit.iterations} iterations",
        method="smoother",
        noise={"magnetic_field": noise.magnetometer, "angular_rate": noise.gyroscope},
        field_strength=unit,
        observability=observability,
        diagnostics={
            "windows": len(fit.chain.windows),
            "iterations": fit.iterations,
            "cost": fit.reduced.cost,
            "trusted_share": float(fit.weights.window.mean()),
            "colour": colour,
            "widening": fit.widening,
            "disturbed": _disturbed(fit),
        },
        configuration=configuration | ({} if field_strength is None else {"field_strength": field_strength}),
    )


def _reasons(fit: Fit, rival: Fit | None, field_strength: float, observability: Observability) -> list[str]:
    """Why the result must not be trusted, the root cause first; empty where it may be."""
    reasons = []
    left = float(np.sqrt(np.mean(fit.weights.window * fit.chain.window_sigma**2)))
    misfit = ""
    if left > _MOST_UNEXPLAINED * field_strength:
        misfit = f"the model leaves {left * 1e6:.1f} µT unexplained (at most {_MOST_UNEXPLAINED:.0%} of the field)"
    elif not positive(fit):
        misfit = "only a soft iron that mirrors the field fits, which no instrument has"
    if misfit:
        reasons.append(
            f"{misfit}: the field or the instrument changed during the recording; choose an interval (--start, --end)"
        )
    trusted = float(fit.weights.window.mean())
    if trusted < _LEAST_TRUSTED:
        reasons.append(
            f"{1 - trusted:.0%} of the recording is disturbed, at most {1 - _LEAST_TRUSTED:.0%} is tolerated"
        )
    if not observability.observable:
        x, y, z = np.ptp(fit.chain.windows.field, axis=1) * 1e6
        reasons.append(
            f"too little motion (the field swept {x:.0f}, {y:.0f}, {z:.0f} µT along x, y, z; turning over sweeps "
            f"some 90 along each): {observability.weak[0].sentence}"
        )
    if rival is not None:
        other = rival.state.parameters[6:9] * 1e6
        reasons.append(
            f"two calibrations explain the data almost equally well (the other hard iron is "
            f"{other[0]:.1f}, {other[1]:.1f}, {other[2]:.1f} µT): record more motion, or choose "
            "an undisturbed interval (--start, --end)"
        )
    if not fit.converged:
        reasons.append(f"no convergence within {fit.iterations} iterations")
    return reasons


def _disturbed(fit: Fit) -> list[list[float]]:
    """Stretches [from, to] in s that were weighed down to less than half, neighbours joined, longest first."""
    low = np.flatnonzero(fit.weights.window < 0.5)
    if not len(low):
        return []
    time = fit.chain.windows.time
    groups = np.split(low, np.flatnonzero(np.diff(low) > 2) + 1)
    stretches = [[float(time[group[0]]), float(time[group[-1]])] for group in groups]
    return sorted(stretches, key=lambda pair: pair[0] - pair[1])[:20]
