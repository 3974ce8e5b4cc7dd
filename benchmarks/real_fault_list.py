"""Faults of real vehicles' sensors, surroundings and logging, for `real_faults.py`; each has its physics in a function.

A function changes a `Scene`; where the instrument has no single truth it states those that are right.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from real_vehicles import DEG, GRID, TWO_PI, Scene, legs, low_pass, swell, total
from scipy.spatial.transform import Rotation

GRAVITY = 9.81


def thermal(s, size):
    """Offset and gain drift as the instrument warms up."""
    warm = 1 - np.exp(-s.t / s.r.uniform(60, 200)) + 0.1 * swell(s.r, s.t, 150, 1)
    warm, hard, gain = low_pass(warm, 15), s.vector(size), s.r.normal(0, 3e3 * size, 3)
    s.on_field.append(lambda m: m * (1 + warm[:, None] * gain) + warm[:, None] * hard)
    s.loads.append((warm, hard, gain))


def battery(s, size):
    s.load(legs(s.r, s.t, 4, 40, lambda n: s.r.choice([0, 0.2, 0.7, 1], n), 0.5), size, (0, 0.2, 0.7, 1))


def effort(s):
    """Return a thruster's effort (n,), 0 at rest."""
    size = np.abs(low_pass(s.rate[:, 2], 0.3))
    return np.minimum(size / (np.quantile(size, 0.95) + 1e-9), 1.5)


def thruster(s, size):
    work = effort(s)
    s.load(work, size, (0, 0.25, 0.75, 1))
    phase = TWO_PI * total(s.r.uniform(17, 60) * (0.4 + 0.6 * work))
    s.iron = s.iron + ((np.sin(phase) + 0.4 * np.sin(2 * phase + 1)) * work)[:, None] * s.vector(size)


def tool(s, size):
    """A magnetised tool lies near for a sixth to two fifths of the time."""
    begin, long = s.r.uniform(0.1, 0.6) * s.t[-1], s.r.uniform(0.15, 0.4) * s.t[-1]
    s.load(low_pass(1.0 * ((s.t > begin) & (s.t < begin + long)), 0.4), size, (0, 1))


def rudder(s, size):
    angle = low_pass(s.rate[:, 2], 0.4)
    s.load(np.clip(angle / np.sqrt(np.mean(angle**2)), -2, 2), size, (0,))


def servo(s, size):
    """Steel of rudder and elevator; the elevator follows the pitch, so that its mean is part of the hard iron."""
    rudder(s, size)
    angle = low_pass(0.7 * s.angles[:, 1] + 0.8 * s.rate[:, 1], 0.3)
    s.load(np.clip((angle - angle.mean()) / angle.std(), -2, 2), size)


def play(x, width):
    """Return what follows x (n, 3) with a play of this half width; at 50 Hz."""
    every, at = x[::4], x[0].copy()
    out = np.empty_like(every)
    for i, row in enumerate(every):
        out[i] = at = np.minimum(np.maximum(at, row - width), row + width)
    return np.stack([np.interp(np.arange(len(x)) / 4, np.arange(len(every)), c) for c in out.T], axis=1)


def hysteresis(s, width):
    s.on_field.append(lambda m: m + 0.5 * (play(m, width) - m) + 0.2 * (play(m, 2.5 * width) - m))


def g_sensitive(s, size):
    matrix = s.r.normal(0, size, (3, 3))
    s.on_rate.append(lambda w: w + s.up @ matrix.T)


def cross_axis(s, size):
    """The gyroscope's axes define the body's: by all of its matrix, or by the axis of a level turn."""
    matrix = np.eye(3) + s.r.normal(0, size, (3, 3)) * (1 - np.eye(3))
    s.on_rate.append(lambda w: w @ matrix.T)
    left, _, right = np.linalg.svd(matrix)
    up = Rotation.from_rotvec(np.cross([0, 0, 1], matrix[:, 2] / np.linalg.norm(matrix[:, 2]))).as_matrix()
    s.right += [(s.soft @ (left @ right).T, s.hard), (s.soft @ up.T, s.hard)]


def gyroscope_clips(s, share):
    most = np.quantile(np.abs(s.rate).max(axis=1), 1 - share)
    s.on_rates.append(lambda t, w: np.clip(w, -most, most))


def clock(s, drift):
    drift *= s.r.choice([-1, 1])
    s.stamps = (lambda t: t * (1 + drift), s.stamps[1])


def jitter(s, size):
    def late(size):
        return lambda t: np.maximum.accumulate(
            np.sort(t + s.r.exponential(size, len(t))) + 1e-7 * np.arange(len(t))
        )

    s.stamps = late(size), late(size / 2)


def bursts(s, count):
    def last(t):
        i = np.arange(len(t))
        end = np.minimum((i // count + 1) * count - 1, len(t) - 1)
        return t[end] + 0.002 + 2e-4 * (i - end + count)

    s.stamps = last, s.stamps[1]


def ranging(s, size):
    """Beyond a limit another range is used, with its own gain and offset."""
    most = s.r.uniform(0.5, 0.9) * np.quantile(np.abs(s.body @ s.soft.T + s.hard).max(axis=1), 0.8)
    offset, gain = s.r.normal(0, size, 3), 1 + s.r.normal(0, 4e3 * size, 3)

    def respond(m):
        return np.where(np.abs(m).max(axis=1)[:, None] > most, m * gain + offset, m)

    s.bent(respond)
    s.right += [(s.soft, s.hard), (np.diag(gain) @ s.soft, gain * s.hard + offset)]
    s.on_samples.append(lambda t, m: respond(m))


def cross_field(s, size):
    """An axis' gain goes with the field across it."""

    def respond(m):
        return m + size / s.strength * m * np.roll(m, 1, axis=1)

    s.bent(respond)
    s.right.append((s.soft, s.hard))
    s.on_field.append(respond)


def missing(s, share):
    """Fast turns are lost, with half of their gyroscope samples if they are half of the log."""
    speed = np.linalg.norm(s.rate, axis=1)

    def slow(t):
        return np.interp(t, s.t, speed) < np.quantile(speed, 1 - share)

    s.kept = slow, (lambda t: slow(t) | (s.r.random(len(t)) < (0.5 if share > 0.4 else 1)))


def temperature_step(s, size):
    since = s.t - s.r.uniform(0.3, 0.7) * s.t[-1]
    warm, bias = np.where(since > 0, 1 - np.exp(-since / 20), 0.0), s.r.normal(0, 1.5e3 * size, 3)
    s.load(warm, size, (0, 1))
    s.on_rate.append(lambda w: w + warm[:, None] * bias)


def mains(s, size):
    """A line of 50 Hz that beats slowly with the sampling."""
    hertz = round(50 / s.hz[0]) * s.hz[0] if s.hz[0] <= 50 else 50.0
    hertz += s.r.choice([-1, 1]) * s.r.uniform(0.01, 0.3)
    slow, way = swell(s.r, s.t, 200, 0.3), s.vector(np.sqrt(2) * size)
    s.on_samples.append(lambda t, m: m + np.sin(TWO_PI * hertz * t + np.interp(t, s.t, slow))[:, None] * way)


def gradient(s, size):
    """The field varies along the way, which follows the heading."""
    way = total(s.r.uniform(0.5, 2) * np.stack([np.cos(s.angles[:, 0]), np.sin(s.angles[:, 0])], axis=1))
    for _ in range(5):
        k = s.r.normal(size=2)
        k *= TWO_PI / s.r.uniform(15, 150) / np.linalg.norm(k)
        s.place = s.place + np.sin(way @ k + s.r.uniform(0, 6))[:, None] * s.vector(size * np.sqrt(6 / 5))


def storm(s, size):
    s.place = np.stack([swell(s.r, s.t, 150, size, band=0.8) for _ in range(3)], axis=1)


def mounted(s, profile, turn):
    """Turn the mount by a profile (n,) from −1 to 1 times a rotation vector; right are both ends and the middle."""
    s.turned(profile[:, None] * turn)
    mounts = [Rotation.from_rotvec(x * turn).as_matrix() for x in (-1, 0, 1)]
    s.right = [(mount @ s.soft, mount @ s.hard) for mount in mounts]


def screw(s, size):
    """The mount snaps to and fro by this angle in deg."""
    mounted(s, legs(s.r, s.t, 5, 30, lambda n: 1.0 * s.r.choice([-1, 1], n), 0.2), s.vector(size * DEG))


def loose(s, size):
    """The mount falls to either side with the roll."""
    mounted(s, low_pass(np.tanh(s.angles[:, 2] / 0.05), 0.1), s.vector(size * DEG))


def boom(s, size):
    felt = s.up[:, :2] + np.gradient(s.rate[:, :2], 1 / GRID, axis=0) * 0.5 / GRAVITY
    s.turned(np.column_stack([felt @ s.r.normal(0, size * DEG, (2, 2)).T, 0 * s.t]))


def contact(s, loss):
    bad, axis = legs(s.r, s.t, 2, 15, lambda n: 1.0 * (s.r.random(n) < 0.3), 0.05), np.eye(3)[s.r.integers(3)]
    s.on_field.append(lambda m: m * (1 - loss * bad[:, None] * axis))
    s.right = [(s.soft, s.hard), (np.diag(1 - loss * axis) @ s.soft, (1 - loss * axis) * s.hard)]


def bias_walk(s, size):
    walk = np.cumsum(s.r.normal(0, size / np.sqrt(len(s.t)), (len(s.t), 3)), axis=0)
    s.on_rate.append(lambda w: w + walk)


def gyroscope_scales(s, size):
    scale = 1 + s.r.normal(0, size, 3)
    s.on_rate.append(lambda w: w * scale)


def radio(s, size):
    s.load(1.0 * ((s.t + s.r.uniform(0, 10)) % s.r.uniform(5, 15) < 0.8), size, (0,))


def one_axis_clips(s, share):
    axis = s.r.integers(3)

    def clip(t, m):
        m[:, axis] = np.minimum(m[:, axis], np.quantile(m[:, axis], 1 - share))
        return m

    s.on_samples.append(clip)


def rectified(s, size):
    """Vibration moves the gyroscope's bias."""
    work = low_pass(np.sum(s.rate**2, axis=1), 0.5)
    bias = s.r.normal(0, size, 3)
    s.on_rate.append(lambda w: w + ((work - work.mean()) / work.std())[:, None] * bias)


def solar(s, size):
    s.load(np.maximum(0, np.cos(s.angles[:, 0] - s.r.uniform(0, 6.3))), size, (0, 0.25, 0.5, 1))


def viscous(s, size):
    """Induced magnetisation that takes seconds to follow."""
    k = s.r.normal(0, size, (3, 3))
    k = (k + k.T) / 2
    s.iron = s.iron + low_pass(s.body, s.r.uniform(3, 20)) @ k.T
    s.right = [(s.soft, s.hard), (s.soft + k, s.hard), (s.soft, s.hard + k @ s.body.mean(axis=0))]


def sag(s, size):
    """The supply sags with the thrusters, and the gain with it."""
    work = effort(s)
    s.on_field.append(lambda m: m * (1 - size * work[:, None]))
    s.right = [((1 - size * x) * s.soft, (1 - size * x) * s.hard) for x in (0, 0.3, 0.6, 1)]


class Fault(NamedTuple):
    """Its function, two strengths, and whether these motions show it."""

    act: Callable[[Scene, float], None]
    weak: float
    strong: float
    shows: bool = True


FAULTS = {
    "clean": Fault(lambda s, size: None, 0, 0), "thermal": Fault(thermal, 1e-6, 5e-6),
    "battery": Fault(battery, 1e-6, 5e-6), "thruster": Fault(thruster, 1e-6, 5e-6),
    "tool": Fault(tool, 3e-6, 15e-6), "rudder": Fault(rudder, 0.7e-6, 3e-6),
    "servo": Fault(servo, 0.7e-6, 3e-6, False), "hysteresis": Fault(hysteresis, 0.4e-6, 2e-6, False),
    "g-sensitive": Fault(g_sensitive, 2e-3, 10e-3), "cross-axis": Fault(cross_axis, 0.005, 0.02),
    "gyroscope-clips": Fault(gyroscope_clips, 0.005, 0.05), "gyroscope-scales": Fault(gyroscope_scales, 0.003, 0.02),
    "bias-walk": Fault(bias_walk, 2e-3, 10e-3), "rectified": Fault(rectified, 1e-3, 5e-3),
    "clock": Fault(clock, 5e-5, 1e-3), "jitter": Fault(jitter, 3e-3, 20e-3), "bursts": Fault(bursts, 3, 10),
    "missing": Fault(missing, 0.2, 0.5), "ranging": Fault(ranging, 0.5e-6, 2e-6),
    "cross-field": Fault(cross_field, 0.004, 0.02), "temperature-step": Fault(temperature_step, 1e-6, 5e-6),
    "filtered": Fault(lambda s, tau: s.on_field.append(lambda m: low_pass(m, tau, 2)), 0.05, 0.3),
    "gyroscope-filtered": Fault(lambda s, tau: s.on_rate.append(lambda w: low_pass(w, tau, 2)), 0.02, 0.15),
    "coarse": Fault(lambda s, q: s.on_samples.append(lambda t, m: np.round(m / q) * q), 0.6e-6, 4e-6),
    "gyroscope-coarse": Fault(lambda s, q: s.on_rates.append(lambda t, w: np.round(w / q) * q), 4e-3, 20e-3),
    "mains": Fault(mains, 1e-6, 5e-6), "radio": Fault(radio, 3e-6, 15e-6), "sag": Fault(sag, 0.005, 0.02),
    "gradient": Fault(gradient, 0.5e-6, 3e-6), "storm": Fault(storm, 0.1e-6, 0.6e-6),
    "screw": Fault(screw, 0.5, 3), "loose": Fault(loose, 0.3, 2, False), "boom": Fault(boom, 1, 4, False),
    "contact": Fault(contact, 0.05, 0.4), "one-axis-clips": Fault(one_axis_clips, 0.02, 0.15),
    "solar": Fault(solar, 1e-6, 4e-6, False), "viscous": Fault(viscous, 0.01, 0.04),
}  # fmt: skip
