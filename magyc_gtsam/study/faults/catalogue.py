"""The catalogue of faults by name, each at two strengths."""

from __future__ import annotations

from collections.abc import Mapping

from magyc_gtsam.study.faults import either_sensor as e
from magyc_gtsam.study.faults import gyroscope as g
from magyc_gtsam.study.faults import magnetometer as m
from magyc_gtsam.study.faults import surroundings as s
from magyc_gtsam.study.faults.signals import Fault

FAULTS: Mapping[str, Fault] = {
    "clean": Fault("field", lambda field, scene, strength, random: field, 0, 0, ""),
    # The magnetometer's samples.
    "one-sided-spikes": Fault("field", m.one_sided_spikes, 0.05, 0.2, "of the samples"),
    "two-sided-spikes": Fault("field", e.spikes(30e-6), 0.05, 0.2, "of the samples"),
    "one-axis-spikes": Fault("field", m.one_axis_spikes, 0.05, 0.2, "of the samples"),
    "zero-rows": Fault("field", e.zero_rows, 0.02, 0.2, "of the samples"),
    "stuck-axis": Fault("field", e.stuck_axis, 0.2, 0.45, "of the log"),
    "flickering-axis": Fault("field", e.flickering_axis(0.15e-6), 0.2, 0.6, "of the log"),
    "frozen-magnetometer": Fault("field", m.frozen, 0.2, 0.6, "of the log"),
    "full-scale": Fault("field", m.full_scale, 0.02, 0.2, "of the samples", cuts=True),
    "wrapping-full-scale": Fault("field", m.wrapping_full_scale, 0.02, 0.2, "of the samples"),
    "coarse": Fault("field", e.coarse, 1e-6, 10e-6, "T"),
    "held-magnetometer": Fault("field", e.held, 3, 10, "rows"),
    "low-pass": Fault("iron", e.low_pass, 0.1, 0.5, "s"),
    "moving-mean": Fault("iron", m.moving_mean, 0.3, 1.5, "s"),
    "noise-bursts": Fault("field", m.noise_bursts, 0.1, 0.4, "of the log"),
    "sign-flips": Fault("field", e.flipped_axis, 0.05, 0.3, "of the log"),
    "late-axis": Fault("iron", m.late_axis, 0.05, 0.3, "s"),
    "cubic": Fault("iron", m.cubic, 0.005, 0.02, "of the largest reading"),
    "dead-zone": Fault("iron", m.dead_zone, 1e-6, 5e-6, "T"),
    "hysteresis": Fault("iron", m.hysteresis, 0.5e-6, 3e-6, "T"),
    "hum": Fault("iron", m.hum, 2e-6, 10e-6, "T"),
    # The iron.
    "offset-drift": Fault("iron", m.offset_drift, 1e-6, 5e-6, "T"),
    "offset-walk": Fault("iron", m.offset_walk, 1e-6, 5e-6, "T"),
    "iron-step": Fault("iron", m.iron_step, 3e-6, 20e-6, "T"),
    "iron-steps": Fault("iron", m.iron_steps, 3e-6, 20e-6, "T"),
    "scale-drift": Fault("iron", m.scale_drift, 0.01, 0.03, "of the gain"),
    "reset-flips": Fault("iron", m.reset_flips, 2e-6, 10e-6, "T"),
    "rotating-iron": Fault("iron", s.rotating_iron, 2e-6, 10e-6, "T"),
    "swinging-load": Fault("iron", s.iron_that_swings, 0.5e-6, 3e-6, "T", shows=False),
    "current-with-pitch": Fault("iron", s.current_with_pitch, 1e-6, 3e-6, "T", shows=False),
    "current-with-turning": Fault("iron", s.current_with_turning, 1e-6, 5e-6, "T"),
    "switched-current": Fault("iron", s.switched_current, 1e-6, 5e-6, "T"),
    "helper-at-the-start": Fault("iron", s.helper_at_the_start, 10, 60, "s"),
    # The world.
    "steel-by-heading": Fault("world", s.steel_by_heading, 1e-6, 3e-6, "T", shows=False),
    "stay-beside-steel": Fault("world", s.stay_beside_steel, 5e-6, 20e-6, "T"),
    "passes-of-steel": Fault("world", s.passes_of_steel, 10e-6, 36e-6, "T"),
    "gradient-on-an-arm": Fault("world", s.gradient_on_an_arm, 1e-6, 5e-6, "T"),
    "wandering-field": Fault("world", s.wandering_field, 0.5e-6, 3e-6, "T"),
    "weakening-field": Fault("world", s.weakening_field, 0.01, 0.05, "of the field"),
    "eddy-currents": Fault("body", s.eddy_currents, 0.1, 0.5, "s"),
    # The gyroscope.
    "turned-gyroscope": Fault("turn", g.turned_axes, 1, 5, "deg", turns=True),
    "badly-turned-gyroscope": Fault("turn", g.turned_axes, 10, 15, "deg", turns=True),
    "gyroscope-scale": Fault("turn", g.scale, 0.01, 0.05, "of the rate"),
    "gyroscope-scale-of-one-axis": Fault("turn", g.scale_of_one_axis, 0.01, 0.05, "of the rate"),
    "held-gyroscope": Fault("rate", e.held, 3, 5, "rows"),
    "gyroscope-spikes": Fault("rate", e.spikes(2.0), 0.05, 0.2, "of the samples"),
    "one-sided-gyroscope-spikes": Fault("rate", g.one_sided_spikes, 0.05, 0.2, "of the samples"),
    "gyroscope-zero-rows": Fault("rate", e.zero_rows, 0.02, 0.2, "of the samples"),
    "bias-steps": Fault("rate", g.bias_steps, 10e-3, 50e-3, "rad/s"),
    "bias-drift": Fault("rate", g.bias_drift, 5e-3, 20e-3, "rad/s"),
    "bias-wander": Fault("turn", g.bias_wander, 2e-3, 10e-3, "rad/s"),
    "gyroscope-full-scale": Fault("rate", g.full_scale, 0.9, 0.6, "of the largest rate"),
    "wrapping-gyroscope": Fault("rate", g.wrapping_full_scale, 0.9, 0.6, "of the largest rate"),
    "stuck-gyroscope-axis": Fault("rate", e.stuck_axis, 0.2, 0.45, "of the log"),
    "flickering-gyroscope-axis": Fault("rate", e.flickering_axis(1e-3), 0.2, 0.6, "of the log"),
    "dead-gyroscope": Fault("rate", g.dead, 0.2, 0.45, "of the log"),
    "filtered-gyroscope": Fault("turn", e.low_pass, 0.1, 0.5, "s"),
    "coarse-gyroscope": Fault("rate", e.coarse, 5e-3, 50e-3, "rad/s"),
    "gyroscope-dead-band": Fault("rate", g.dead_band, 10e-3, 50e-3, "rad/s"),
    "gyroscope-cubic": Fault("turn", g.cubic, 0.02, 0.1, "of the largest rate"),
    "gyroscope-feels-gravity": Fault("turn", g.gravity, 5e-3, 20e-3, "rad/s per g"),
    "flipped-gyroscope-axis": Fault("rate", e.flipped_axis, 0.2, 1.0, "of the log"),
    "swapped-gyroscope-axes": Fault("rate", g.swapped_axes, 0.2, 1.0, "of the log"),
    "cycled-gyroscope-axes": Fault("turn", g.cycled_axes, 1, 2, "places", turns=True),
    "wrong-gyroscope-unit": Fault("rate", g.wrong_unit, 2, 57.3, "times"),
    "vibration": Fault("turn", g.vibration, 0.3, 1.0, "rad/s"),
    "gyroscope-noise-bursts": Fault("rate", g.noise_bursts, 0.1, 0.4, "of the log"),
    # Clocks and logging.
    "delay": Fault("iron", s.delayed, 0.05, 0.5, "s"),
    "wandering-latency": Fault("iron", s.wandering_latency, 0.1, 0.3, "s"),
    "stepping-latency": Fault("iron", s.stepping_latency, 0.1, 0.3, "s"),
    "clock-drift": Fault("log", s.clock_drift, 1e-4, 3e-3, ""),
    "jitter": Fault("log", s.jitter, 0.01, 0.04, "s"),
    "lost-samples": Fault("log", s.lost_samples, 0.5, 0.9, "of the samples"),
    "lost-bursts": Fault("log", s.lost_bursts, 0.2, 0.6, "of the samples"),
    "slow-log": Fault("log", s.slow_log, 5, 20, "rows left of 10 Hz"),
    "magnet-in-a-pause": Fault("log", s.magnet_and_gap, 5e-6, 20e-6, "T"),
    # The motion.
    "swell-at-1-hz": Fault("angles", s.swell, 4.0, 1.8, "s", rate=1.0),
    "mostly-at-rest": Fault("angles", s.mostly_at_rest, 0.5, 0.9, "of the log"),
    "nearly-level": Fault("angles", s.nearly_level, 0.8, 0.99, "of roll and pitch"),
}
