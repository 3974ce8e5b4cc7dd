"""Metrics of the agreement of a model and a recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp
from scipy.special import chdtri

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.gap.model.field_variation import FieldVariation
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.outcome.agreement import GapMap, Line, Metrics, OpenLoop
from magyc_gtsam.gap.outcome.worth import interleaved
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.fine import Fine
from magyc_gtsam.gap.samples.noise_effects import tone
from magyc_gtsam.gap.samples.wrong_samples import autocorrelation
from magyc_gtsam.metrics import heading_deviation
from magyc_gtsam.recording import Recording

_HORIZON = 20.0  # s
_BINS = 30
_FEW = 5  # windows below which a bin is left out


def measure(
    twin: Twin,
    calibration: Calibration,
    fine: Fine | None = None,
    fitted: Array | None = None,
    variation: FieldVariation | None = None,
    cleaned: Recording | None = None,
) -> Metrics:
    """Compute all metrics of a model on its recording.

    Args:
        twin: the linearised model.
        calibration: the same model as a calibration.
        fine: innovations of single samples, for lines above the frequencies of the motion; None leaves them out.
        fitted: columns (q, 3n) of what was fitted to this recording; None for all parameters and terms of the model.
        variation: of the field, which the held-out likelihood takes into account; None for a constant field.
        cleaned: the recording without the effects on single samples that the calibration has; None if the model's is.
    """
    v = twin.residual()
    lines: tuple[Line, ...] = ()
    if fine is not None:
        found = tone(fine.innovation, fine.time, fine.level, -np.log(RULES.family_wise), fine.edge)
        if found.significant:
            lines = (Line(found.setting["frequency"], float(found.value[0]), found.evidence),)
    return Metrics(
        held_out=held_out(twin, v, twin.base_columns if fitted is None else fitted, variation),
        open_loop=open_loop(twin),
        whiteness=whiteness(v),
        lines=lines,
        heading=heading_error(cleaned or twin.problem.recording, calibration),
        noise=dict(calibration.noise),
        maps=maps(twin, v),
    )


def held_out(twin: Twin, innovation: Array, base: Array, variation: FieldVariation | None) -> float:
    """Return the log-likelihood per window (nats) on blocks that were not fitted, of what has columns (q, 3n).

    A variation of the field is whitened; its determinant, which all models share, is left out.
    """
    block = interleaved(twin.time, RULES.block)
    flat = innovation.ravel()
    if variation is not None:
        flat, base = variation.whiten(flat[None])[0], variation.whiten(base)
    size = np.maximum(np.linalg.norm(base, axis=1), 1e-300)[:, None]
    square = 0.0
    for fold in (0, 1):
        train, test = block != fold, block == fold
        solution = np.linalg.lstsq((base[:, train] / size).T, flat[train], rcond=1e-8)[0]
        error = flat[test] - solution @ (base[:, test] / size)
        square += float(error @ error)
    sigma = twin.chain.window_sigma * 1e6  # density per µT³, for a number of readable size
    constant = 1.5 * np.log(2 * np.pi) + 3 * np.log(sigma) + 0.5 * twin.log_determinant()
    return -float(constant[1:].mean()) - 0.5 * square / twin.n


def open_loop(twin: Twin) -> OpenLoop:
    """Predict the field `_HORIZON` seconds ahead by the gyroscope alone, and compare it with the measured field."""
    windows, parameters = twin.chain.windows, twin.state.parameters
    g, spread = twin.predictions()
    target = np.searchsorted(windows.time, windows.time + _HORIZON)
    start = np.flatnonzero(target < twin.n)
    start = start[start > min(10, twin.n // 4)]  # the filter has not converged before
    broken = np.concatenate([[0], np.cumsum(~windows.linked)])
    start = start[broken[target[start]] == broken[start]]
    target = target[start]
    soft = unvech(parameters[:6])
    to_sensor = np.einsum("ij,jkn->ikn", soft, twin.chain.rotation(parameters)[..., target])
    predicted = np.einsum("ijn,jn->in", to_sensor, g[:, start]) + parameters[6:9, None]
    walked = np.cumsum(np.concatenate([[0.0], windows.link_time])) * twin.chain.noise.gyroscope**2
    g_start = g[:, start]
    across = np.eye(3)[:, :, None] - g_start[:, None] * g_start[None]
    covariance = spread[..., start] + across * (walked[target] - walked[start])
    variance = (
        np.einsum("ijn,jkn,ikn->in", to_sensor, covariance, to_sensor) + twin.chain.window_sigma[target] ** 2
    )
    error = windows.field[:, target] - predicted
    return OpenLoop(
        _HORIZON,
        windows.time[target],
        error.T,
        np.sqrt(np.maximum(variance, 0.0)).T,
        float(np.sqrt((error**2).mean())) if len(start) else 0.0,
        float(np.sqrt(max(float(variance.mean()), 0.0))) if len(start) else 0.0,
    )


def whiteness(innovation: Array) -> float:
    """Return the root mean square of the first autocorrelations relative to that of white noise."""
    rho = autocorrelation(innovation, 20)
    return float(np.sqrt((rho**2).mean() * innovation.size))


def heading_error(recording: Recording, calibration: Calibration) -> float | None:
    """Return the standard deviation of the calibrated field's heading in the reference's world frame, deg.

    The recording is without the calibration's tones.
    """
    if recording.attitude is None:
        return None
    known = np.isfinite(recording.attitude).all(axis=1)
    if known.sum() < 10:
        return None
    # The timing is not applied to the field; a late field is compared with the attitude at its own time instead.
    still = replace(calibration, terms=tuple(t for t in calibration.terms if t.name not in ("timing", "tone")))
    field, time = still.corrected(recording), recording.time
    attitude = Slerp(time[known], Rotation.from_quat(recording.attitude[known]))
    fresh = known & recording.magnetic_field_fresh & (time - calibration.delay >= time[known][0])
    fresh &= time - calibration.delay <= time[known][-1]
    return heading_deviation(field[fresh], attitude(time[fresh] - calibration.delay).as_quat())


def maps(twin: Twin, innovation: Array) -> tuple[GapMap, ...]:
    """Return the misfit as a function of every known variable."""
    signals = twin.windows
    square = (innovation**2).sum(axis=0)
    over: list[tuple[str, str, Array]] = [("time", "s", signals.time - signals.time[0])]
    field = signals.need("field")
    if signals.acceleration is not None:
        down = -signals.acceleration / np.linalg.norm(signals.acceleration, axis=0)
        east = np.cross(down.T, field.T)
        north = np.cross(east, down.T)
        heading = np.rad2deg(
            np.arctan2(-east[:, 0] / np.linalg.norm(east, axis=1), north[:, 0] / np.linalg.norm(north, axis=1))
        )
        over.append(("heading", "°", heading))
        over.append(("pitch", "°", np.rad2deg(np.arcsin(np.clip(-down[0], -1, 1)))))
    over.append(("rate", "rad/s", np.linalg.norm(signals.need("rate"), axis=0)))
    known = (kind for kind in ("temperature", "current") if kind in signals.channels)
    over += [(kind, "unit of the channel", signals.channels[kind][0]) for kind in known]
    reading = field + twin.state.parameters[6:9, None]
    over.append(("field strength", "µT", np.linalg.norm(reading, axis=0) * 1e6))
    result = [_binned(name, unit, value, square) for name, unit, value in over]
    return (*result, _spectrum(twin, innovation))


def _binned(name: str, unit: str, value: Array, square: Array) -> GapMap:
    edges = np.unique(np.quantile(value, np.linspace(0, 1, min(_BINS, len(value) // _FEW) + 1)))
    if name == "time":
        edges = np.linspace(value[0], value[-1], len(edges))
    place = np.clip(np.searchsorted(edges, value, side="right") - 1, 0, max(len(edges) - 2, 0))
    count = np.bincount(place, minlength=max(len(edges) - 1, 1))
    kept = count >= _FEW
    total = np.bincount(place, weights=square, minlength=len(count))[kept]
    count = count[kept]
    centre = 0.5 * (edges[1:] + edges[:-1])[kept] if len(edges) > 1 else edges[:1]
    return GapMap(name, unit, centre, np.sqrt(total / (3 * count)), _band(3 * count), count / count.sum())


def _spectrum(twin: Twin, innovation: Array) -> GapMap:
    n = innovation.shape[1]
    power = (np.abs(np.fft.rfft(innovation, axis=1)[:, 1:]) ** 2).sum(axis=0) / n
    spacing = twin.duration / max(n - 1, 1)
    frequency = np.arange(1, len(power) + 1) / (n * spacing)
    groups = np.array_split(np.arange(len(power)), min(_BINS, len(power)))
    count = np.array([len(g) for g in groups])
    level = np.array([power[g].mean() for g in groups]) / 3
    centre = np.array([frequency[g].mean() for g in groups])
    return GapMap("frequency", "Hz", centre, np.sqrt(level), _band(6 * count), count / count.sum())


def _band(freedoms: np.ndarray) -> Array:
    return np.sqrt(np.stack([chdtri(freedoms, 0.995), chdtri(freedoms, 0.005)], axis=1) / freedoms[:, None])
