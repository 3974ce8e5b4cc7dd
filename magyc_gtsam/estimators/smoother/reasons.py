"""Reasons not to trust a fit: the model does not fit, too little motion, no convergence, jumps of the field."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.estimators.field_jumps import field_jumps
from magyc_gtsam.estimators.model_error import ModelError
from magyc_gtsam.estimators.model_error.rest import moving
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.minima import positive
from magyc_gtsam.estimators.smoother.noise_levels import scatter
from magyc_gtsam.estimators.smoother.options import MOST_DELAY, SmootherOptions
from magyc_gtsam.factors.chain.chain_values import DELAY
from magyc_gtsam.observability import Observability
from magyc_gtsam.recording import Recording

# How the reasons begin that name no fault of the log.
TOO_LITTLE_MOTION, NOT_CONVERGED = "too little motion", "no convergence"
MOST_UNEXPLAINED = 0.1  # share of the field strength left unexplained in a window
_LATEST = 0.1  # share of the recording at its end; the calibration is used from then on
_LEAST_TRUSTED = 0.5  # mean weight of the windows below which the result must not be trusted
# Least duration, s, and number of windows that are rejected at the end of a log and may be a change for good
_LAST = 5.0
_LAST_WINDOWS = 5
_LONG = 2.0  # s, longest time that a window stands for
_MUCH_LESS = 0.5  # ratio of the sigmas by white residuals to those by the residuals as they are
_NOISIER = 1.25  # times a noise that is given by which the data may scatter; at 1.4 one of 80 results was wrong
# Misalignment that the data may show of chips given as aligned; with 0.3° 5 of 48 logs were wrong, with 0.6° 23
_ALIGNED = np.radians(0.3)


def jumped(fit: Fit, recording: Recording) -> list[str]:
    """Return a sentence on the field's jumps if the fit rejects much of the recording, or much of its end."""
    latest = fit.weights.window[-max(int(_LATEST * len(fit.weights.window)), 1) :]
    if fit.trusted_share >= _LEAST_TRUSTED and latest.mean() >= _LEAST_TRUSTED:
        return []
    jumps = field_jumps(recording)
    if not jumps:
        return []
    named = " and ".join(f"at {jump.time:.0f} s by {jump.size * 1e6:.0f} µT" for jump in jumps)
    return [f"the field jumped {named}: calibrate a stretch between (start=, end=), or run `mg.find_gap`"]


def disturbed_end(fit: Fit, first: float | None = None) -> str:
    """Return a sentence on a disturbance that lasts to the end of what was fitted; "" if there is none.

    The iron may have changed for good there: a ramp of 8 µT over the last tenth was rejected as a disturbance, and the
    calibration of what was before trusted, 9° off at the end. So may the gyroscope's bias where its turns are rejected:
    after a jump by 10 mrad/s in the last twentieth the one before it was trusted, 700 sigmas off.

    Args:
        fit: of a recording, or of the end of a longer one.
        first: stamp, s, of the recording's first row, from which times count; None where the recording goes on.
    """
    weight = fit.weights.window.copy()
    weight[1:] = np.minimum(weight[1:], fit.weights.link)
    if weight.min() >= _LEAST_TRUSTED:
        return ""
    windows = fit.chain.windows
    kept = moving(windows.time, windows.rotation)
    time, length = windows.time[kept], np.minimum(np.gradient(windows.time), _LONG)[kept]
    rejected = np.cumsum(_LEAST_TRUSTED - weight[kept][::-1])  # from each window to the end
    if not rejected.max(initial=0.0) > 0:
        return ""
    last = int(np.argmax(rejected)) + 1
    if last < _LAST_WINDOWS or length[-last:].sum() < _LAST:
        return ""
    if first is None:
        when, remedy = f"in the last {windows.time[-1] - time[-last]:.0f} s", "keep turning until that is decided"
    else:
        when = f"from {time[-last] - first:.0f} s to the end"
        remedy = "choose an interval before it (end=), or record on after a change"
    return f"the field is disturbed {when}, where the iron or the gyroscope's bias may have changed for good: {remedy}"


def misfits(fit: Fit, field_strength: float, observable: bool) -> list[str]:
    """Return the reasons not to trust the result because the model does not fit, the root cause first."""
    reasons = []
    left = float(np.sqrt(np.mean(fit.weights.window * fit.chain.window_sigma**2)))
    misfit = ""
    if left > MOST_UNEXPLAINED * field_strength:
        misfit = f"the model leaves {left * 1e6:.1f} µT unexplained (at most {MOST_UNEXPLAINED:.0%} of the field)"
    elif observable and not positive(fit):
        misfit = "only a soft iron that mirrors the field fits, which no instrument has"
    if misfit:
        reasons.append(
            f"{misfit}: the field or the instrument changed during the recording; choose an interval (start=, end=)"
        )
    trusted = fit.trusted_share
    if trusted < _LEAST_TRUSTED:
        reasons.append(
            f"{1 - trusted:.0%} of the recording is disturbed, at most {1 - _LEAST_TRUSTED:.0%} is tolerated"
        )
    return reasons


def doubts_of(fit: Fit, field_strength: float, observability: Observability) -> list[str]:
    """Return the reasons not to trust the result, the root cause first; empty if there are none."""
    reasons = misfits(fit, field_strength, observability.observable)
    if not observability.observable and _by_misfit(fit, observability):
        worst = observability.weak[0]
        reasons.append(
            f"the field or the instrument changed, or something else is missing in the model ({worst.what} "
            f"±{worst.sigma:.2g} {worst.unit}, limit {worst.limit:.2g}, by the sensors' noise alone "
            f"±{worst.sigma / np.sqrt(fit.colour):.2g}): run `mg.find_gap`, or choose an interval (start=, end=)"
        )
    elif not observability.observable:
        swept = np.ptp(fit.chain.windows.field, axis=1) * 1e6
        along = ", ".join(f"{value:.0f}" for value in swept)
        much = "; turning over sweeps some 90 along each" if swept.min() < 90 else ""
        reasons.append(
            f"{TOO_LITTLE_MOTION} (the field swept {along} µT along x, y, z{much}): {observability.weak[0].sentence}"
        )
    delay = float(fit.state.parameters[DELAY])
    if not abs(delay) < MOST_DELAY:
        reasons.append(
            f"the magnetometer lags by {delay:.1f} s, at most {MOST_DELAY:g} s is tolerated: give both sensors stamps "
            "of one clock (stamps='log')"
        )
    if not fit.converged:
        reasons.append(f"{NOT_CONVERGED} within {fit.iterations} iterations")
    return reasons


def _by_misfit(fit: Fit, observability: Observability) -> bool:
    """Return whether the motion would be enough if the residuals were white: it is the model that lacks something.

    After a jump of 3 to 9 µT in five minutes the sigmas of a wide motion are 4 to 7 times as large.
    """
    white = fit.colour**-0.5
    return white < _MUCH_LESS and all(weak.sigma * white <= weak.limit for weak in observability.weak)


def contradicted_options(
    fit: Fit, options: SmootherOptions, unexplained: ModelError, strength: float
) -> list[str]:
    """Return sentences on noise levels and aligned chips that were given, and that the data contradict.

    Args:
        fit: at its minimum, with these options.
        options: of the fit.
        unexplained: the model error of the fit.
        strength: of the field, T.
    """
    return [*_noisier(fit, options), *_misaligned(options, unexplained, strength)]


def _noisier(fit: Fit, options: SmootherOptions) -> list[str]:
    if options.noise is None:
        return []
    remedy = "correct it, or omit it (noise=), so that it is estimated"
    if options.prior is not None:
        remedy += ", or omit an earlier calibration that is not of this instrument as it is now (prior=)"
    names = (("magnetometer", 1e6, "µT"), ("gyroscope", 1e3, "mrad/s"))
    return [
        f"the {name}'s noise is given as {level * factor:.2g} {unit}, and the data scatter by {seen * factor:.2g} "
        f"{unit}: {remedy}"
        for (name, factor, unit), level, seen in zip(names, options.noise, scatter(fit), strict=True)
        if seen > _NOISIER * level
    ]


def _misaligned(options: SmootherOptions, unexplained: ModelError, strength: float) -> list[str]:
    if options.misalignment != 0:
        return []
    return [
        f"the chips are given as aligned, and the data show {np.degrees(c.size / strength):.1f}° between them: omit it "
        "(misalignment=), so that it is estimated, or calibrate where the field is uniform"
        for c in unexplained.components
        if c.name == "skew" and c.size > _ALIGNED * strength
    ]
