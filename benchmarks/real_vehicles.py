"""Eight vehicles with motions, rates and instruments as real ones have them, for `real_faults.py`.

Nothing of `magyc_gtsam.simulation` or of the study of faults is used. Attitudes, instruments, rates of 5 to 200 Hz (the
sensors have different ones) and noise levels are drawn anew for each run.
"""

import zlib
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg

GRID = 200.0  # Hz, of the physics
TWO_PI, DEG = 2 * np.pi, np.pi / 180
HERTZ = np.array([5.0, 10, 20, 50, 100, 200])


def swell(r, t, period, rms, count=9, band=0.35):
    """Return a narrow-band process of this mean period in s."""
    w, phase = TWO_PI / period * np.exp(r.normal(0, band, count)), r.uniform(0, TWO_PI, count)
    a = r.rayleigh(1.0, count)
    return rms * np.sqrt(2 / np.sum(a**2)) * np.sum(a[:, None] * np.sin(w[:, None] * t + phase[:, None]), axis=0)


def low_pass(values, tau, order=1):
    """Return values (n, …) behind a filter of this time constant in s."""
    return lfilter(*butter(order, 2 / (TWO_PI * tau * GRID)), values - values[0], axis=0) + values[0]


def legs(r, t, least, most, draw, tau):
    """Return values that are constant for `least` to `most` s, with transitions of `tau` s; `draw` gives n of them."""
    ends = np.cumsum(r.uniform(least, most, int(t[-1] / least) + 3))
    return low_pass(draw(len(ends) + 1)[np.searchsorted(ends, t)], tau, 2)


def total(rate):
    """Return the integral of a rate per second."""
    return np.cumsum(rate, axis=0) / GRID


def multirotor(r, t):
    yaw = legs(r, t, 8, 30, lambda n: np.cumsum(r.uniform(-150, 150, n)), 1.2) + swell(r, t, 3, 1.5)
    return yaw, *(legs(r, t, 3, 12, lambda n: r.normal(0, 9, n), 0.4) + swell(r, t, 1.2, 1.5) for _ in "pr")


def glider(r, t):
    dive = legs(r, t, 40, 70, lambda n: 24 * (-1.0) ** np.arange(n) + r.normal(0, 2, n), 3)
    bank = legs(r, t, 50, 120, lambda n: r.choice([-15, 15], n) + r.normal(0, 3, n), 4)
    yaw = total(0.25 / DEG * np.sin(bank * DEG)) + swell(r, t, 8, 1)
    return yaw, dive + swell(r, t, 9, 0.8), bank + swell(r, t, 7, 1)


def rov(r, t):
    yaw = total(legs(r, t, 5, 25, lambda n: r.normal(0, 12, n), 1.5))
    return yaw, swell(r, t, 4, 3) + legs(r, t, 20, 60, lambda n: r.normal(0, 6, n), 2), swell(r, t, 3.2, 4)


def ship(r, t):
    yaw = total(legs(r, t, 30, 80, lambda n: r.choice([-3, -1.5, 0, 1.5, 3], n), 8)) + swell(r, t, 14, 1.5)
    return yaw, swell(r, t, 6.5, 2.5), swell(r, t, 9, 6, band=0.12)


def car(r, t):
    turn = legs(r, t, 6, 25, lambda n: r.choice([0, 0, 15, 15, -15, 8, -25], n), 1)
    slope = legs(r, t, 8, 30, lambda n: r.choice([0, 0, 7, -7, 4, -9], n), 1.2) + swell(r, t, 0.9, 0.4)
    return (
        total(turn),
        slope,
        0.12 * turn + swell(r, t, 1.1, 0.4) + legs(r, t, 10, 40, lambda n: r.normal(0, 2, n), 1),
    )


def figure_eight(r, t):
    phase = total(TWO_PI / r.uniform(2.5, 4) * (1 + 0.15 * swell(r, t, 12, 1)))
    yaw = total(legs(r, t, 10, 30, lambda n: r.normal(0, 15, n), 2)) + 52 * np.sin(phase)
    return yaw, 29 * np.sin(2 * phase + 0.4) + swell(r, t, 20, 20), 46 * np.sin(phase + 1) + swell(r, t, 15, 29)


def buoy(r, t):
    spin = r.choice([-1, 1]) * r.uniform(6, 18) + swell(r, t, 60, 3)
    return total(spin), swell(r, t, 4.5, 6), swell(r, t, 4, 6)


def lawn_mower(r, t):
    leg = r.uniform(30, 45)
    rate = low_pass(np.where(t % leg < 9, 20.0, 0.0) * np.where((t // leg) % 2 < 1, 1, -1), 2, 2)
    pitch = legs(r, t, 25, 50, lambda n: r.choice([-18, -8, 0, 8, 18], n), 3) + swell(r, t, 6, 0.7)
    return r.uniform(0, 360) + total(rate) + swell(r, t, 10, 1), pitch, 0.25 * rate + swell(r, t, 5, 1.5)


MOTIONS = {  # yaw, pitch, roll in deg; the range of the sensors' rates in Hz
    multirotor: (50, 200), glider: (5, 50), rov: (20, 100), ship: (5, 50),
    car: (50, 200), figure_eight: (50, 200), buoy: (10, 100), lawn_mower: (10, 100),
}  # fmt: skip


@dataclass
class Scene:
    """A run; a fault changes its fields. Functions act on readings (n, 3) of the grid or of the samples."""

    r: np.random.Generator
    t: np.ndarray
    attitude: Rotation
    angles: np.ndarray  # rad
    rate: np.ndarray
    world: np.ndarray  # T
    soft: np.ndarray
    hard: np.ndarray
    hz: tuple  # magnetometer, gyroscope
    right: list = field(default_factory=list)  # of (soft iron, hard iron)
    loads: list = field(default_factory=list)  # of (profile (n,), hard iron per unit, relative gain per unit)
    place: np.ndarray = 0.0  # T, added to the world's field
    iron: np.ndarray = 0.0  # T, added in sensor axes
    mount: Rotation = None
    on_field: list = field(default_factory=list)
    on_samples: list = field(default_factory=list)
    on_rate: list = field(default_factory=list)
    on_rates: list = field(default_factory=list)
    kept: tuple = (lambda t: t > -1, lambda t: t > -1)
    stamps: tuple = (lambda t: t, lambda t: t)

    def __post_init__(self):
        self.up, self.body = (self.attitude.inv().apply(v) for v in ([0, 0, 1.0], self.world))
        self.strength, self.bias = np.linalg.norm(self.world), self.r.normal(0, 0.008, 3)

    def vector(self, size):
        v = self.r.normal(size=3)
        return size * v / np.linalg.norm(v)

    def load(self, profile, size, states=()):
        """Add iron with a profile (n,) over time; right are that of its `states`, its mean and its latest value."""
        v = self.vector(size)
        self.iron = self.iron + profile[:, None] * v
        self.right += [(self.soft, self.hard + x * v) for x in states]
        self.loads.append((profile, v, np.zeros(3)))

    def truths(self, end):
        """Return the calibrations (soft iron, hard iron) that are right at `end` s."""
        now, more = max(int(end * GRID), 1), []
        for profile, hard, gain in self.loads:
            for x in (profile[:now].mean(), profile[now - 1]):
                scale = 1 + x * gain
                more.append((scale[:, None] * self.soft, scale * self.hard + x * hard))
        return self.right + more or [(self.soft, self.hard)]

    def bent(self, respond):
        """Set a static response; right are the straight ones that fit over all directions, a turn, and the motion."""
        sphere, a = np.random.default_rng(1).normal(size=(500, 3)), np.arange(0, TWO_PI, 0.1)
        sphere *= self.strength / np.linalg.norm(sphere, axis=1)[:, None]
        n, _, d = self.world
        turn = np.stack([n * np.cos(a), -n * np.sin(a), d + 0 * a], axis=1) + 0.2 * sphere[: len(a)]
        for u in (sphere, turn, self.body[::50]):
            design = np.column_stack([u / self.strength, np.ones(len(u))])
            found = np.linalg.lstsq(design, respond(u @ self.soft.T + self.hard), rcond=None)[0]
            self.right.append((found[:3].T / self.strength, found[3]))

    def turned(self, vector):
        """Turn the mount by rotation vectors (n, 3) rad."""
        self.mount = Rotation.from_rotvec(vector)

    def recording(self):
        m = self.attitude.inv().apply(self.world + self.place) @ self.soft.T + self.hard + self.iron
        m, w = m if self.mount is None else self.mount.apply(m), self.rate
        for f in self.on_field:
            m = f(m)
        for f in self.on_rate:
            w = f(w)
        streams, r = [], self.r
        sizes = r.uniform(0.1e-6, 0.7e-6), r.uniform(0.2, 0.8) * 1e-3 * np.sqrt(self.hz[1] / 2)
        for i, (values, extra) in enumerate(((m, self.on_samples), (w + self.bias, self.on_rates))):
            t = np.arange(0.5 + r.uniform(0, 1 / self.hz[i]), self.t[-1] - 2, 1 / self.hz[i])
            at = CubicSpline(self.t, values)(t) if i else np.stack([np.interp(t, self.t, c) for c in values.T], 1)
            at = at + r.normal(0, sizes[i], at.shape)
            for f in extra:
                at = f(t, at)
            kept = self.kept[i](t)
            streams.append((self.stamps[i](t)[kept], at[kept]))
        return mg.Recording.from_streams(*streams)


def scene(motion, seed, key):
    """Return a run without its fault."""
    r = np.random.default_rng([seed, zlib.crc32(key.encode())])
    t = np.arange(0, r.uniform(280, 480) + 2, 1 / GRID)
    angles = np.stack(motion(r, t), axis=1) * DEG
    spline, h = CubicSpline(t, angles), 5e-4
    before, after = (Rotation.from_euler("ZYX", spline(t + x)) for x in (-h, h))
    dip = r.choice([-1, 1]) * r.uniform(20, 72) * DEG
    world = r.uniform(28e-6, 60e-6) * np.array([np.cos(dip), 0, np.sin(dip)])
    s = r.normal(0, 0.06, (3, 3))
    soft = np.eye(3) + (s + s.T) / 2
    low, high = MOTIONS[motion]
    some = slice(*np.searchsorted(HERTZ, [low, high + 1]))
    gyroscope = r.choice(HERTZ[some])
    hz = r.choice(HERTZ[: np.searchsorted(HERTZ, min(gyroscope, 100) + 1)]), gyroscope
    rate = (before.inv() * after).as_rotvec() / (2 * h)
    soft, hard = soft / np.cbrt(np.linalg.det(soft)), r.normal(0, 15e-6, 3)
    return Scene(r, t, Rotation.from_euler("ZYX", angles), angles, rate, world, soft, hard, hz)
