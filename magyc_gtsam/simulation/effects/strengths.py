"""The published strength (factor 1) of each effect, and its reason.

`sigma` is the smallest size that is visible at one standard deviation in 600 s at 10 Hz with a magnetometer of 10 mG
and a gyroscope of 5 mrad/s, at pitch ±45° and ±5°; None where it has not been derived. The strengths are about sixteen
of these on the wide motion, so that a quarter of a strength is at the limit of visibility; where an effect is far less
visible at pitch ±5°, they are twelve of these there, unless no sensor has an error that large. The visibility of each
effect after the twelve parameters have absorbed their part is measured by benchmarks/gap_strengths.py.
"""

from __future__ import annotations

from dataclasses import dataclass

from magyc_gtsam.simulation.scene import MILLIGAUSS

_MS = 1e-3
_MRAD = 1e-3


@dataclass(frozen=True)
class Strength:
    """The strength of an effect at factor 1.

    Attributes:
        size: size in `unit`.
        unit: SI unit, with its reference quantity.
        shown: the size in customary units.
        reason: reason for the size.
        sigma: (pitch ±45°, pitch ±5°) size at one standard deviation, in `unit`.
    """

    size: float
    unit: str
    shown: str
    reason: str
    sigma: tuple[float, float] | None = None


NAMED_STRENGTHS: dict[str, Strength] = {
    "motor-current": Strength(
        3.0 * MILLIGAUSS,
        "T per σ of the current",
        "3 mG per σ of the current",
        "a cable a hand's breadth from the sensor",
        (0.16 * MILLIGAUSS, 0.16 * MILLIGAUSS),
    ),
    "temperature-hard-iron": Strength(
        4.0 * MILLIGAUSS,
        "T per σ of the temperature",
        "4 mG per σ of the temperature",
        "more than sixteen, since a drift shares most of it",
        (0.17 * MILLIGAUSS, 0.17 * MILLIGAUSS),
    ),
    "hard-iron-step": Strength(
        6.0 * MILLIGAUSS,
        "T",
        "6 mG",
        "a battery that slipped by a millimetre",
        (0.35 * MILLIGAUSS, 0.35 * MILLIGAUSS),
    ),
    "hard-iron-drift": Strength(
        4.0 * MILLIGAUSS,
        "T, root mean square about the mean",
        "4 mG rms",
        "as a step, but spread over the run",
    ),
    "misalignment": Strength(
        45 * _MRAD, "rad", "2.6°", "chips on two boards; twelve on the moderate motion", (0.9 * _MRAD, 3.9 * _MRAD)
    ),
    "timing": Strength(40 * _MS, "s", "40 ms", "phones are late by 20 to 60 ms", (3.2 * _MS, 2.2 * _MS)),
    "eddy-plane": Strength(60 * _MS, "s", "60 ms", "a thick aluminium deck; sixteen", (3.8 * _MS, 3.8 * _MS)),
    "gyro-scale": Strength(
        20e-3, "1", "2 %", "the data sheets of consumer gyroscopes allow 3 %", (0.7e-3, 1.4e-3)
    ),
    "gyro-quadratic": Strength(0.15, "s/rad", "6 % at 0.4 rad/s", "a scale error that grows with the rate"),
    "temperature-gyro": Strength(
        1.6 * _MRAD,
        "rad/s per σ of the temperature",
        "1.6 mrad/s per σ of the temperature",
        "0.02 °/s/°C; sixteen",
        (0.1 * _MRAD, 0.1 * _MRAD),
    ),
    "g-sensitivity": Strength(
        7 * _MRAD,
        "rad/s per g",
        "7 mrad/s per g",
        "bad parts have 0.2 °/s/g to 0.4 °/s/g; no more, though pitch ±5° then cannot see it",
        (0.4 * _MRAD, 6 * _MRAD),
    ),
    "field-gradient": Strength(
        4e-3, "1 per σ of the depth", "0.4 % per σ of the depth", "a wreck below; twenty", (0.2e-3, 0.2e-3)
    ),
    "local-anomaly": Strength(
        20 * MILLIGAUSS, "T at its largest", "20 mG", "a chain passed at 8 m", (1.0 * MILLIGAUSS, 1.0 * MILLIGAUSS)
    ),
    "saturation": Strength(
        0.05, "1", "full scale 5 % below the largest reading", "a core that is too small for the hard iron"
    ),
    "cubic": Strength(
        30 * MILLIGAUSS,
        "T at 500 mG",
        "30 mG at 500 mG",
        "6 %, of an uncompensated core; fifteen on the moderate motion",
        (0.6 * MILLIGAUSS, 2 * MILLIGAUSS),
    ),
    "hysteresis": Strength(
        5.0 * MILLIGAUSS, "T, half the loop's width", "5 mG", "unhardened steel; twenty", (0.23 * MILLIGAUSS,) * 2
    ),
    "coloured-noise": Strength(
        6.0 * MILLIGAUSS, "T", "6 mG rms", "half as much again as the white noise at 0.1 Hz"
    ),
    "spikes": Strength(80 * MILLIGAUSS, "T", "80 mG on 1 % of the samples", "bus errors, relays"),
    "tone": Strength(4.0 * MILLIGAUSS, "T", "4 mG", "mains at 1 m, folded by the sampling"),
    "quantisation": Strength(30 * MILLIGAUSS, "T", "30 mG per count", "three times the noise"),
    "sample-hold": Strength(
        0.7, "1", "own period 1.7 times the log's", "a magnetometer slower than the log, free-running"
    ),
    "axis-order": Strength(1.0, "1", "a signed permutation", "there is no half of it"),
    "current-squared": Strength(
        3.0 * MILLIGAUSS,
        "T per σ of the current's square",
        "3 mG per σ of the square",
        "a converter near the sensor",
    ),
    "load-soft-iron": Strength(12e-3, "1 per σ of the current", "1.2 % per σ of the current", "a motor's core"),
    "soft-iron-step": Strength(20e-3, "1", "2 % along a rod", "a tool or an anchor stowed near the sensor"),
    "temperature-gain": Strength(
        6e-3, "1 per σ of the temperature", "0.6 % per σ of the temperature", "an uncompensated sensor"
    ),
    "gain-drift": Strength(
        6e-3, "1, standard deviation over the recording", "0.6 % (standard deviation)", "a sensor that warms up"
    ),
    "gyro-bias-step": Strength(3 * _MRAD, "rad/s", "3 mrad/s", "0.2 °/s, of a consumer part after a shock"),
    "gyro-bias-drift": Strength(
        1.6 * _MRAD, "rad/s, root mean square about the mean", "1.6 mrad/s rms", "a part that wanders over minutes"
    ),
    "axis-delays": Strength(
        60 * _MS, "s, between the first axis and the last", "60 ms", "a multiplexed converter with a slow filter"
    ),
    "clock-drift": Strength(
        180 * _MS, "s over the recording", "180 ms in ten minutes", "a resonator 300 ppm off the other clock"
    ),
}

FOREIGN_STRENGTHS: dict[str, Strength] = {
    "servo-magnet": Strength(8 * MILLIGAUSS, "T", "8 mG", "the magnet of a panning camera, with end stops"),
    "loose-magnet": Strength(6 * MILLIGAUSS, "T", "6 mG", "a battery that rolls from side to side"),
    "axis-product": Strength(18 * MILLIGAUSS, "T at 500 mG", "18 mG at 500 mG", "cross-axis effect of a core"),
    "rate-product": Strength(0.3, "s/rad", "3 % at 0.1 rad/s", "flexing of the gyroscope's frame"),
    "deadband-lag": Strength(200 * _MS, "s", "200 ms", "iron that lags only in fast turns"),
    "vibration-bias": Strength(
        2.0 * _MRAD,
        "rad/s per σ",
        "2 mrad/s per σ of the current's square",
        "a gyroscope that rectifies vibration",
    ),
}

STRENGTHS: dict[str, Strength] = {**NAMED_STRENGTHS, **FOREIGN_STRENGTHS}
