"""The page of an accelerometer calibration: verdict, figures and parameters."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np

from magyc_gtsam.estimators.autocal.accelerometer import AccelerometerCalibration, accelerometer_samples
from magyc_gtsam.recording import Array, Mask, Recording
from magyc_gtsam.report.charts import Figure, origin, over_time, sphere
from magyc_gtsam.report.html import rendered
from magyc_gtsam.report.words import Number, uncertain
from magyc_gtsam.storage.files import write_text


def write_accelerometer_report(
    target: str | os.PathLike[str], recording: Recording, calibration: AccelerometerCalibration
) -> Path:
    """Write the page as one self-contained HTML file, atomically, and return its path."""
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
        cloud=_cloud(raw, within, calibration),
        strength=_strength(recording, time, raw, calibration),
        parameters=parameter_rows(calibration),
        configuration=json.dumps(
            {"configuration": dict(calibration.configuration), "diagnostics": dict(calibration.diagnostics)},
            indent=2,
        ),
    )
    write_text(path, text)
    return path


def parameter_rows(calibration: AccelerometerCalibration) -> list[tuple[str, list[str]]]:
    """Return one row per parameter: (name with its unit, one text per axis or a single text)."""
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
    """Return the numbers that the page shows first."""
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


def _cloud(raw: Array, within: Mask, calibration: AccelerometerCalibration) -> Figure:
    """Draw the raw samples, those in motion in another colour, with the fitted ellipsoid and gravity's sphere."""
    gravity = calibration.gravity
    clouds = [("at rest", "raw", raw[within])]
    if not within.all():
        clouds.append(("motion, weighed down", "disturbed", np.clip(raw[~within], -3 * gravity, 3 * gravity)))
    return sphere(
        "Raw samples, the ellipsoid fitted to them, and gravity (m/s²)",
        "Drag to turn. At rest samples lie on the ellipsoid. Where it is bare, no attitude was seen and its shape is a "
        "guess.",
        clouds,
        gravity,
        outlines=[
            (calibration.scale * gravity, calibration.bias, "raw"),
            (np.eye(3) * gravity, np.zeros(3), "calibrated"),
        ],
    )


def _strength(recording: Recording, time: Array, raw: Array, calibration: AccelerometerCalibration) -> Figure:
    """Draw the length of the acceleration over time, raw and calibrated."""
    lengths = [np.linalg.norm(value, axis=1) for value in (raw, calibration.apply(raw))]
    reach = 4 * float(np.median(np.abs(lengths[0] - calibration.gravity))) + 0.5
    limits = calibration.gravity - reach, calibration.gravity + reach
    return over_time(
        "Length over time",
        "Lines: means; bands: range of the samples; dashed: gravity. At rest the calibrated line lies on it.",
        time - origin(recording),
        [
            (label, label, np.clip(value, *limits))
            for label, value in zip(("raw", "calibrated"), lengths, strict=True)
        ],
        "Length (m/s²)",
        strip=True,
        levels=[calibration.gravity],
        wide=True,
    )
