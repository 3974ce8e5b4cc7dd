"""The page of an accelerometer calibration: what to trust, what it looks like, the numbers."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib import figure as drawing

from magyc_gtsam.estimators.accelerometer import AccelerometerCalibration, accelerometer_samples
from magyc_gtsam.recording import Array, Mask, Recording
from magyc_gtsam.report.analysis import spread, summary
from magyc_gtsam.report.html import Figure, rendered, write_page
from magyc_gtsam.report.plots import CALIBRATED, DISTURBED, INK, RAW, drawn, outlines
from magyc_gtsam.report.words import Number, uncertain

_DRAWN: dict[str, Any] = {"markersize": 2.5, "alpha": 0.5, "rasterized": True, "markeredgewidth": 0}


def write_accelerometer_report(
    target: str | os.PathLike[str], recording: Recording, calibration: AccelerometerCalibration
) -> Path:
    """Write the page as one self-contained HTML file, in one step; returns the file."""
    path = Path(target)
    time, raw = accelerometer_samples(recording)
    within = calibration.inliers(raw)
    text = rendered(
        "accelerometer.html",
        recording,
        headline="Accelerometer calibrated" if calibration.converged else "Do not use this calibration",
        good=calibration.converged,
        calibration=calibration,
        numbers=_numbers(calibration, raw, within),
        views=[
            Figure(Markup(_projection(raw, within, calibration, plane)), f"Seen along {gone}")
            for plane, gone in (((0, 1), "z"), ((0, 2), "y"), ((1, 2), "x"))
        ],
        strength=Figure(
            Markup(_strength(time - recording.time[0], raw, calibration)),
            "",
            "Lines: means; bands: range of the samples; dashed: gravity. At rest the calibrated line lies on it.",
        ),
        parameters=parameter_rows(calibration),
        configuration=json.dumps(
            {"configuration": dict(calibration.configuration), "diagnostics": dict(calibration.diagnostics)},
            indent=2,
        ),
    )
    write_page(path, text)
    return path


def parameter_rows(calibration: AccelerometerCalibration) -> list[tuple[str, list[str]]]:
    """(name with its unit, one text per axis or one in all)."""
    sigma = calibration.sigma
    scale_sigma = sigma.get("scale", np.full((3, 3), np.nan))
    bias_sigma = sigma.get("bias", np.full(3, np.nan))

    def texts(value: Array, deviation: Array) -> list[str]:
        return [uncertain(v, s) for v, s in zip(value, deviation, strict=True)]

    rows = [
        (name, texts(*each)) for name, *each in zip(("Scale", "", ""), calibration.scale, scale_sigma, strict=True)
    ]
    return [
        *rows,
        ("Bias (m/s²)", texts(calibration.bias, bias_sigma)),
        ("Noise and motion, 1σ per sample (m/s²)", [f"{calibration.noise:.3g}"]),
        ("Gravity (m/s²)", [f"{calibration.gravity:.5f}"]),
    ]


def _numbers(calibration: AccelerometerCalibration, raw: Array, within: Mask) -> list[Number]:
    """The numbers to see first."""
    still = within if within.any() else np.ones(len(raw), dtype=bool)
    before, after = (
        float(np.sqrt(np.mean((np.linalg.norm(a[still], axis=1) - calibration.gravity) ** 2)))
        for a in (raw, calibration.apply(raw))
    )
    largest = float(np.linalg.norm(calibration.bias))
    tilt = float(np.degrees(np.arctan(largest / calibration.gravity)))
    scale = float(np.abs(np.diag(calibration.scale) - 1).max())
    motion = f"of {len(raw):,} samples, off gravity by {calibration.limit:.2g} m/s²"
    return [
        Number("Gravity missed by", f"{before:.3f} → {after:.3f} m/s²", "1σ, raw → calibrated, without motion"),
        Number("Bias", f"{largest:.3f} m/s²", f"its length: {tilt:.2f}° of tilt"),
        Number("Scale", f"{scale:.2%}", "largest error of an axis"),
        Number("Motion", f"{1 - within.mean():.1%}", motion),
    ]


@drawn(3.6, 3.7)
def _projection(
    figure: drawing.Figure, raw: Array, within: Mask, calibration: AccelerometerCalibration, plane: tuple[int, int]
) -> None:
    """Raw samples with the fitted ellipsoid, those that are motion in another colour, and gravity's sphere."""
    axes = figure.add_subplot()
    gravity, columns = calibration.gravity, list(plane)
    for rows, colour in ((within, RAW), (~within, DISTURBED)):
        if rows.any():
            shown = raw[rows][spread(raw[rows], gravity / 40)]
            axes.plot(*np.clip(shown[:, columns].T, -3 * gravity, 3 * gravity), ".", color=colour, **_DRAWN)
    outlines(axes, calibration.scale, calibration.bias, gravity, "m/s²", plane)


@drawn(4.7, 3.1)
def _strength(figure: drawing.Figure, time: Array, raw: Array, calibration: AccelerometerCalibration) -> None:
    """Length of the acceleration over time, raw and calibrated."""
    axes = figure.add_subplot()
    for value, colour in ((raw, RAW), (calibration.apply(raw), CALIBRATED)):
        middle, mean, lowest, highest = summary(time, np.linalg.norm(value, axis=1))
        axes.fill_between(middle, lowest, highest, color=colour, alpha=0.25, linewidth=0)
        axes.plot(middle, mean, color=colour)
    axes.axhline(calibration.gravity, color=INK, linewidth=1, linestyle="--")
    reach = 4 * float(np.median(np.abs(np.linalg.norm(raw, axis=1) - calibration.gravity))) + 0.5
    axes.set(
        xlabel="Time (s)",
        ylabel="Length (m/s²)",
        xlim=(time[0], time[-1]),
        ylim=(calibration.gravity - reach, calibration.gravity + reach),
    )
