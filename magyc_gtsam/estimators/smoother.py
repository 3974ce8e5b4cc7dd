"""`smoother`: the maximum-likelihood calibration under the sensor model (MATH.md section 4), the default.

The field's direction is a Markov chain under the gyroscope; eliminating it leaves thirteen parameters:
soft iron (times field strength), hard iron, gyroscope bias and the magnetometer's delay. No start, no
attitude and no noise level is asked of the user.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators import axes, starts
from magyc_gtsam.estimators.chain_fit import Fit, adapt, begin, descend, misfit
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.field_chain import DELAY, PARAMETERS, UPPER, FieldChain, Noise, State, symmetric
from magyc_gtsam.factors.preintegration import Preintegration
from magyc_gtsam.observability import Observability, assess
from magyc_gtsam.recording import Array, Recording, Samples

Progress = Callable[[float], None]

_MOVED = 0.01  # rad by which bias or delay may turn a window before the gyroscope is integrated again
_TRIPLETS = 3000  # samples at which the short-term noise is taken
_EXPLAINED = 2.0  # cost per residual at the short-term noise up to which no other start is needed
_CLOSE = 1.1  # ratio of two minima's costs from which they count as close
_MOST_UNEXPLAINED = 0.1  # share of the field strength left unexplained in a window
_LEAST_TRUSTED = 0.5  # share of the windows' weight below which the result must not be trusted
_APART = 0.05  # distance of two minima's hard irons, in field strengths, from which they differ


def calibrate_smoother(
    recording: Recording,
    *,
    field_strength: float | None = None,
    noise: tuple[float, float] | None = None,
    robust: bool | None = None,
    delay: float | None = None,
    window: float = 1.0,
    turn: float | None = None,
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
        progress: called with the share done, 0 to 1.

    Raises:
        MagycError: no gyroscope, too few samples, or sensors whose axes or units disagree.
    """
    report = progress or (lambda _: None)
    report(0.0)
    fit, rival = fit_field_chain(recording, noise=noise, robust=robust, delay=delay, window=window, turn=turn, progress=report)
    configuration = {"window": window, "turn": turn, "robust": robust is not False, "delay": delay}
    if noise is not None:
        configuration["noise"] = list(noise)
    calibration = _calibration(recording, fit, rival, field_strength, configuration)
    report(1.0)
    return calibration


def fit_field_chain(
    recording: Recording,
    *,
    noise: tuple[float, float] | None = None,
    robust: bool | None = None,
    delay: float | None = None,
    window: float = 1.0,
    turn: float | None = None,
    progress: Progress = lambda _: None,
) -> tuple[Fit, Fit | None]:
    """The chain at its lowest minimum, and the best different minimum if one is close (arguments as above)."""
    samples = preintegrate(recording, window, turn)
    free = np.ones(PARAMETERS, dtype=bool)
    free[DELAY] = delay is None
    windows = samples.integrate(delay=delay or 0.0)
    if len(windows) < 8:
        raise MagycError(
            f"{len(windows)} windows of {window:g} s, at least 8 are needed: record longer (a minute or more), or move"
        )
    short_term = short_term_noise(recording) if noise is None else None
    level = short_term or Noise(*noise)  # type: ignore[misc]
    chain = FieldChain(windows, level)
    progress(0.2)
    begun = begin(chain, starts.from_gyroscope(windows), free)
    best = _descended(samples, begun)
    explained = best.converged and best.reduced.cost < 0.5 * _EXPLAINED * 3 * len(windows)
    progress(0.4)
    best = _adapted(samples, best, robust is not False, short_term)
    if explained and level.magnetometer < 0.1 * _strength(best):
        return best, None
    # The misfit is more than the sensors' noise: the axes may disagree, or the minimum be a false one.
    axes.check(recording)
    fits = [best]
    for parameters in starts.others(windows, best.state.parameters[9:12]):
        progress(0.4 + 0.1 * len(fits))
        fit = _descended(samples, begin(chain, parameters, free))
        fits.append(_adapted(samples, fit, robust is not False, short_term))
    return _lowest(fits)


def _lowest(fits: list[Fit]) -> tuple[Fit, Fit | None]:
    """The minimum of lowest robust misfit, and a different one within `_CLOSE` of it.

    Minima found with different noise levels and weights are compared at one noise, each residual counting
    up to its rejection threshold; a soft iron that is not positive definite counts only if all are so.
    """
    possible = [fit for fit in fits if _positive(fit)] or fits
    noise = min((fit.chain.noise for fit in possible), key=lambda noise: noise.magnetometer)
    ranked = sorted(possible, key=lambda fit: misfit(fit, noise))
    best = ranked[0]
    rival = next((fit for fit in ranked[1:] if _apart(fit, best)), None)
    if rival is not None and misfit(rival, noise) > _CLOSE * misfit(best, noise):
        rival = None
    return best, rival


def _adapted(samples: Preintegration, fit: Fit, reject: bool, short_term: Noise | None) -> Fit:
    """At the minimum with its own noise and weights, the gyroscope integrated close to it."""
    for _ in range(4):
        fit = adapt(fit, reject, short_term)
        if not _moved(fit):
            break
        fit = _descended(samples, fit)
    return _upright(fit)


def _positive(fit: Fit) -> bool:
    return bool(np.linalg.eigvalsh(symmetric(fit.state.parameters[:6]))[0] > 0)


def preintegrate(recording: Recording, window: float = 1.0, turn: float | None = None) -> Preintegration:
    """The recording's samples, cut into windows."""
    magnetometer, gyroscope = recording.magnetometer, recording.gyroscope
    if turn is None:
        # Rotation inside a window costs information where it is not small against the field's spread over
        # the whole log; at these values some 2 % of the weakest parameter's sigma.
        thin = magnetometer.value[:: max(len(magnetometer.value) // 2000, 1)]
        spread = np.linalg.eigvalsh(np.cov(thin.T))
        turn = float(np.clip(np.sqrt(spread[0] / max(spread.sum(), 1e-30)), 0.15, 0.3))
    return Preintegration(
        *magnetometer,
        *gyroscope,
        interval_mean=recording.angular_rate_is == "interval-mean",
        length=window,
        turn=turn,
    )


def short_term_noise(recording: Recording) -> Noise:
    """Noise per sample and axis from second differences, which smooth motion does not enter."""

    def level(samples: Samples, least: float) -> float:
        value = samples.value
        stride = max(len(value) // _TRIPLETS, 1)
        second = value[2::stride] - 2 * value[1:-1:stride] + value[:-2:stride]
        deviation = np.sqrt(np.einsum("ni,ni->n", second, second) / 18)
        # Upper quartile of sqrt(χ²₃/3): drivers that interpolate leave half of the differences at zero.
        return max(float(np.percentile(deviation, 75)) / 1.170, least)

    return Noise(level(recording.magnetometer, 1e-10), level(recording.gyroscope, 1e-6))


def _descended(samples: Preintegration, fit: Fit) -> Fit:
    """At the minimum for the noise and weights at hand, the gyroscope integrated close to it."""
    fit = descend(fit, settled=1.0)
    for _ in range(8):
        if not _moved(fit):
            break
        parameters = fit.state.parameters
        chain = FieldChain(samples.integrate(parameters[9:12], parameters[DELAY]), fit.chain.noise)
        state = chain.start(parameters)
        fit = replace(fit, chain=chain, state=state, reduced=chain.eliminate(state, fit.weights))
        fit = descend(fit, settled=1.0)
    return _upright(fit)


def _moved(fit: Fit) -> bool:
    """Whether bias or delay are so far from where the gyroscope was integrated that second order matters."""
    windows, parameters = fit.chain.windows, fit.state.parameters
    turned = np.einsum("ijn,j->in", windows.lever[:, :, windows.linked], parameters[9:12] - windows.bias)
    slid = windows.rotation_rate * (parameters[DELAY] - windows.delay)
    return bool(np.abs(turned).max(initial=0.0) > _MOVED or np.abs(slid).max() > _MOVED)


def _upright(fit: Fit) -> Fit:
    """(B, g) and (−B, −g) are one solution: take the one with positive soft iron."""
    parameters, direction = fit.state
    if parameters[[0, 3, 5]].sum() >= 0:
        return fit
    flipped = parameters.copy()
    flipped[:6] *= -1
    state = State(flipped, -direction)
    return replace(fit, state=state, reduced=fit.chain.eliminate(state, fit.weights))


def _strength(fit: Fit) -> float:
    return float(np.cbrt(abs(np.linalg.det(symmetric(fit.state.parameters[:6])))))


def _apart(fit: Fit, other: Fit) -> bool:
    distance = np.linalg.norm(fit.state.parameters[6:9] - other.state.parameters[6:9])
    return bool(distance > _APART * _strength(other))


def _calibration(
    recording: Recording, fit: Fit, rival: Fit | None, field_strength: float | None, configuration: dict[str, Any]
) -> Calibration:
    colour = fit.colour
    parameters, covariance = fit.state.parameters, fit.covariance * colour
    scaled = symmetric(parameters[:6])
    strength = _strength(fit) if field_strength is None else field_strength
    jacobian = np.eye(12, PARAMETERS)
    jacobian[:6, :6] /= strength
    if field_strength is None:  # det A = 1: strength = ∛det B moves with B
        inverse = np.linalg.inv(scaled)
        slope = strength / 3 * inverse[UPPER] * np.where(UPPER[0] == UPPER[1], 1.0, 2.0)
        jacobian[:6, :6] -= np.outer(parameters[:6], slope) / strength**2
    reported = jacobian @ covariance @ jacobian.T
    observability = assess(reported, scaled / strength, strength, recording)
    reasons = _reasons(fit, rival, strength, observability)
    noise = fit.chain.noise
    return Calibration(
        soft_iron=scaled / strength,
        hard_iron=parameters[6:9],
        gyro_bias=parameters[9:12],
        covariance=reported,
        delay=float(parameters[DELAY]),
        delay_sigma=float(np.sqrt(covariance[DELAY, DELAY])) if fit.free[DELAY] else None,
        converged=not reasons,
        message="; ".join(reasons) or f"converged in {fit.iterations} iterations",
        method="smoother",
        noise={"magnetic_field": noise.magnetometer, "angular_rate": noise.gyroscope},
        field_strength=strength,
        observability=observability,
        diagnostics={
            "windows": len(fit.chain.windows),
            "iterations": fit.iterations,
            "cost": fit.reduced.cost,
            "trusted_share": float(fit.weights.window.mean()),
            "colour": colour,
            "disturbed": _disturbed(fit),
        },
        configuration=configuration | ({} if field_strength is None else {"field_strength": field_strength}),
    )


def _reasons(fit: Fit, rival: Fit | None, strength: float, observability: Observability) -> list[str]:
    """Why the result must not be trusted, the root cause first; empty where it may be."""
    reasons = []
    left = float(np.sqrt(np.mean(fit.weights.window * fit.chain.window_sigma**2)))
    if left > _MOST_UNEXPLAINED * strength or not _positive(fit):
        reasons.append(
            f"the model leaves {left * 1e6:.1f} µT unexplained (at most {_MOST_UNEXPLAINED:.0%} of the field is "
            "tolerated): the field or the instrument changed during the recording; choose an interval (--start, --end)"
        )
    trusted = float(fit.weights.window.mean())
    if trusted < _LEAST_TRUSTED:
        reasons.append(f"{1 - trusted:.0%} of the recording is disturbed, at most {1 - _LEAST_TRUSTED:.0%} is tolerated")
    if not observability.observable:
        x, y, z = _turned(fit)
        reasons.append(
            f"too little motion (it turned by {x:.0f}°, {y:.0f}°, {z:.0f}° about x, y, z): "
            f"{observability.weak[0].sentence}"
        )
    if rival is not None:
        other = rival.state.parameters[6:9] * 1e6
        reasons.append(
            f"two calibrations explain the data almost equally well (the other hard iron is "
            f"{other[0]:.1f}, {other[1]:.1f}, {other[2]:.1f} µT): record more motion"
        )
    if not fit.converged:
        reasons.append(f"no convergence within {fit.iterations} iterations")
    return reasons


def _turned(fit: Fit) -> Array:
    """(3,) range of the attitude about the sensor's axes against its mean, in degrees."""
    rotation = fit.chain.windows.rotation[:, :, :: max(len(fit.chain.windows) // 200, 1)]
    attitude = Rotation.from_matrix(np.moveaxis(rotation, 2, 0)).inv()
    vectors = (attitude.mean().inv() * attitude).as_rotvec(degrees=True)
    return np.ptp(vectors, axis=0)


def _disturbed(fit: Fit) -> list[list[float]]:
    """Stretches [from, to] in s that were weighed down to less than half, neighbours joined, longest first."""
    low = np.flatnonzero(fit.weights.window < 0.5)
    if not len(low):
        return []
    time = fit.chain.windows.time
    groups = np.split(low, np.flatnonzero(np.diff(low) > 2) + 1)
    stretches = [[float(time[group[0]]), float(time[group[-1]])] for group in groups]
    return sorted(stretches, key=lambda pair: pair[0] - pair[1])[:20]


@dataclass(frozen=True, eq=False)
class WindowResiduals:
    """What the model leaves unexplained, window by window.

    time (n,) s; magnetic_field (n, 3) T in sensor axes, its sigma (n,) T and robust weight (n,); link
    (n − 1, 3) rad between neighbours, its sigma (n − 1,) rad (infinite across a hole) and weight (n − 1,).
    """

    time: Array
    magnetic_field: Array
    magnetic_sigma: Array
    magnetic_weight: Array
    link: Array
    link_sigma: Array
    link_weight: Array


def window_residuals(recording: Recording, calibration: Calibration) -> WindowResiduals:
    """Residuals of any calibration with a gyroscope bias; its parameters are kept, the directions smoothed.

    Raises:
        MagycError: no gyroscope, or no gyroscope bias.
    """
    if calibration.gyro_bias is None:
        raise MagycError(f"method {calibration.method!r} estimates no gyroscope bias, so there are no window residuals")
    samples = preintegrate(recording)
    windows = samples.integrate(calibration.gyro_bias, calibration.delay)
    noise = short_term_noise(recording)
    chain = FieldChain(
        windows,
        Noise(
            calibration.noise.get("magnetic_field", noise.magnetometer),
            calibration.noise.get("angular_rate", noise.gyroscope),
        ),
    )
    strength = calibration.field_strength or float(
        np.median(np.linalg.norm(calibration.apply(recording.magnetometer.value), axis=1))
    )
    parameters = starts.parameters(
        calibration.soft_iron * strength, calibration.hard_iron, calibration.gyro_bias, calibration.delay
    )
    fit = adapt(begin(chain, parameters, np.zeros(PARAMETERS, dtype=bool)), True, None)
    residuals = chain.residuals(fit.state)
    return WindowResiduals(
        windows.time,
        residuals.window.T,
        chain.window_sigma,
        fit.weights.window,
        residuals.link.T,
        chain.link_sigma,
        fit.weights.link,
    )
