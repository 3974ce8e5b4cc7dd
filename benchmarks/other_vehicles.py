"""Calibrate five vehicles of another simulation than the package's own, under faults; how often is a sigma untrue?

    python benchmarks/other_vehicles.py [FAULT ...] [--seeds 6] [--first-seed 0]

Nothing of `magyc_gtsam.simulation` is used: attitudes are splines through random Euler angles, the angular rate is
their difference quotient, both sensors have rates and stamps of their own (magnetometer 40 Hz with jitter, gyroscope
100 Hz), and strength, dip, soft iron, hard iron, bias and noise levels are drawn anew for each run. One row for each
fault and vehicle: how many results are trusted, the root mean square of their error in stated sigmas (1 expected;
smaller where the sigma covers what the fault may have done), and those that are wrong: off by more than 2.2 sigmas a
degree of freedom (99.8 %) and 0.3 µT. Where the hard iron changes, the value of either part counts as right.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam.recording import Array

DURATION = 420.0  # s
WRONG_SIGMAS, WRONG_SIZE = 2.2, 0.3e-6  # a degree of freedom; T
VEHICLES = {  # s between the knots of the splines; rad a knot of yaw; rad of pitch and roll
    "drone": (2.0, 0.7, 0.25),
    "car": (6.0, 0.6, 0.05),
    "hand": (1.5, 0.9, 0.9),
    "ship": (4.0, 0.25, 0.12),
    "auv": (8.0, 0.5, 0.15),
}


@dataclass
class Run:
    """A run before its noise: stamps s, what the sensors measure T and rad/s, the hard irons that are right."""

    random: np.random.Generator
    attitude: Callable[[Array], Rotation]
    world: Array  # (3,) T
    soft_iron: Array
    hard_iron: Array
    time: Array
    field: Array
    gyro_time: Array
    rate: Array
    right: list[Array]

    @property
    def strength(self) -> float:
        return float(np.linalg.norm(self.world))

    def added(self, profile: Array, size: float) -> None:
        """Add a vector of random components of this size (T), times a profile (n,) over time, in sensor axes."""
        self.field = self.field + profile[:, None] * self.random.normal(0, size, 3)

    def seen(self, time: Array, world: Array) -> Array:
        """Return the field in sensor axes at `time` of a field in world axes, through soft and hard iron."""
        return np.asarray(self.attitude(time).inv().apply(world)) @ self.soft_iron.T + self.hard_iron


def drawn(vehicle: str, seed: int, fault: str) -> Run:
    """Return a run without fault and noise."""
    random = np.random.default_rng([seed, *map(ord, fault), *map(ord, vehicle)])
    step, turn, tilt = VEHICLES[vehicle]
    knots = np.arange(0, DURATION + 5 * step, step)
    yaw = np.cumsum(random.normal(0, turn, len(knots)))
    angles = CubicSpline(knots, np.stack([yaw, *tilt * random.normal(size=(2, len(knots)))], axis=1))

    def attitude(time: Array) -> Rotation:
        return Rotation.from_euler("ZYX", angles(time))

    dip = np.radians(random.uniform(-75, 75))
    world = random.uniform(25e-6, 60e-6) * np.array([np.cos(dip), 0.0, np.sin(dip)])
    soft_iron = np.eye(3) + random.normal(0, 0.08, (3, 3))
    soft_iron = (soft_iron + soft_iron.T) / 2
    hard_iron = random.normal(0, 15e-6, 3)
    time = np.arange(0.01, DURATION, 1 / 40)
    time = np.sort(time + random.normal(0, 5e-4, len(time)))
    gyro_time, half = np.arange(0, DURATION, 1 / 100), 5e-4
    rate = (attitude(gyro_time - half).inv() * attitude(gyro_time + half)).as_rotvec() / (2 * half)
    rate = rate + random.normal(0, 0.01, 3)
    run = Run(random, attitude, world, soft_iron, hard_iron, time, time, gyro_time, rate, [hard_iron])
    run.field = run.seen(time, world)
    return run


def _delay(run: Run) -> None:
    run.field = run.seen(run.time - 0.03, run.world)


def _skew(run: Run) -> None:
    turned = Rotation.from_rotvec(np.radians(run.random.normal(0, 1.0, 3))).as_matrix()
    run.field = (run.field - run.hard_iron) @ turned.T + run.hard_iron


def _room(run: Run) -> None:
    wander = sum(
        run.random.normal(0, 0.5e-6, 3)
        * np.sin(2 * np.pi * run.time / run.random.uniform(20, 200) + run.random.uniform(0, 6))[:, None]
        for _ in range(4)
    )
    run.field = run.seen(run.time, run.world + wander)


def _jump(run: Run) -> None:
    change = run.random.normal(0, 3e-6, 3)
    run.field = run.field + (run.time > run.random.uniform(0.3, 0.7) * DURATION)[:, None] * change
    run.right.append(run.hard_iron + change)


def _drift(run: Run) -> None:
    change = run.random.normal(0, 3e-6, 3)
    run.field = run.field + (run.time / DURATION)[:, None] * change
    run.right.extend(run.hard_iron + share * change for share in (0.25, 0.5, 0.75, 1.0))


def _thermal(run: Run) -> None:
    run.added(np.exp(-run.time / 120), 3e-6)


def _current(run: Run) -> None:
    knots = np.arange(0, DURATION + 10, 10)
    run.added(np.interp(run.time, knots, run.random.uniform(0, 1, len(knots))), 2e-6)


def _passing(run: Run) -> None:
    run.added(np.exp(-(((run.time - run.random.uniform(0.3, 0.7) * DURATION) / 4) ** 2)), 8e-6)


def _clipped(run: Run) -> None:
    limit = np.quantile(np.abs(run.field), 0.97)
    run.field = np.clip(run.field, -limit, limit)


def _bend(run: Run) -> None:
    field = run.field - run.hard_iron
    run.field = run.hard_iron + field * (1 + 0.03 * (field / run.strength) ** 2)


def _coloured(run: Run) -> None:
    white = run.random.normal(0, 0.5e-6, run.field.shape)
    run.field = run.field + lfilter([np.sqrt(1 - 0.97**2)], [1, -0.97], white, axis=0)


def _coarse(run: Run) -> None:
    run.field = np.round(run.field / 0.6e-6) * 0.6e-6


def _outliers(run: Run) -> None:
    rows = run.random.random(len(run.field)) < 0.02
    run.field[rows] += run.random.normal(0, 30e-6, (rows.sum(), 3))


def _stuck(run: Run) -> None:
    begin = run.random.uniform(0.3, 0.7) * DURATION
    rows = (run.time > begin) & (run.time < begin + 15)
    run.field[rows] = run.field[np.argmax(rows)]


def _gyro_scale(run: Run) -> None:
    run.rate = run.rate @ np.diag(1 + run.random.normal(0, 0.015, 3))


def _gyro_drift(run: Run) -> None:
    run.rate = run.rate + (run.gyro_time / DURATION)[:, None] * run.random.normal(0, 0.01, 3)


def _vibration(run: Run) -> None:
    run.added(np.sin(2 * np.pi * (11.3 + 2 * np.sin(run.time / 37)) * run.time), 1e-6)


def _clock(run: Run) -> None:
    run.time = run.time * (1 + 200e-6)


FAULTS: dict[str, Callable[[Run], None]] = {
    "clean": lambda run: None,
    "delay": _delay,
    "skew": _skew,
    "room": _room,
    "jump": _jump,
    "drift": _drift,
    "thermal": _thermal,
    "current": _current,
    "passing": _passing,
    "clipped": _clipped,
    "bend": _bend,
    "coloured": _coloured,
    "coarse": _coarse,
    "outliers": _outliers,
    "stuck": _stuck,
    "gyro-scale": _gyro_scale,
    "gyro-drift": _gyro_drift,
    "vibration": _vibration,
    "clock": _clock,
}


def error_of(vehicle: str, fault: str, seed: int) -> tuple[float, float] | None:
    """Return the error of the hard iron in sigmas a degree of freedom and in T; None of what is not trusted."""
    run = drawn(vehicle, seed, fault)
    FAULTS[fault](run)
    noise, gyro_noise = run.random.uniform(0.2e-6, 0.8e-6), run.random.uniform(1e-3, 6e-3)
    field = run.field + run.random.normal(0, noise, run.field.shape)
    rate = run.rate + run.random.normal(0, gyro_noise, run.rate.shape)
    try:
        calibration = mg.calibrate(mg.Recording.from_streams((run.time, field), (run.gyro_time, rate)))
    except mg.MagycError:
        return None
    if not calibration.trusted:
        return None
    assert calibration.covariance is not None
    information = np.linalg.inv(calibration.covariance[6:9, 6:9])
    errors = [calibration.hard_iron - right for right in run.right]
    return min((float(np.sqrt(e @ information @ e / 3)), float(np.linalg.norm(e))) for e in errors)


def main(faults: list[str], seeds: range) -> None:
    """Print the table."""
    print("| fault | vehicle | trusted | error / sigma | wrong |")
    print("|---|---|---|---|---|")
    total = [0, 0, 0]
    for fault in faults:
        for vehicle in VEHICLES:
            found = [error for seed in seeds if (error := error_of(vehicle, fault, seed)) is not None]
            wrong = [
                f"{s:.1f}σ, {size * 1e6:.2f} µT" for s, size in found if s > WRONG_SIGMAS and size > WRONG_SIZE
            ]
            ratio = f"{np.sqrt(np.mean([s**2 for s, _ in found])):.2f}" if found else ""
            print(
                f"| {fault} | {vehicle} | {len(found)} of {len(seeds)} | {ratio} | {'; '.join(wrong)} |",
                flush=True,
            )
            total = [t + n for t, n in zip(total, (len(seeds), len(found), len(wrong)), strict=True)]
    print(f"\n{total[0]} runs, {total[1]} trusted, {total[2]} of them wrong")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("faults", nargs="*", choices=[[], *FAULTS], default=[])
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--first-seed", type=int, default=0)
    given = parser.parse_args()
    main(given.faults or list(FAULTS), range(given.first_seed, given.first_seed + given.seeds))
