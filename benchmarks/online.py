"""The online smoother over a long mission, beside `magyc_ifg` of the authors' package; and what it must show.

    python benchmarks/online.py mission [--hours 10]     update time and memory, hour by hour
    python benchmarks/online.py batch [--runs 100]       end result against batch, efficiency and NEES, at the end and
                                                         when it first says converged
    python benchmarks/online.py steps [--runs 100]       steps of 2 µT found within 30 s; their time and size
    python benchmarks/online.py alarms [--hours 100]     false alarms in clean motion
    python benchmarks/online.py kills [--runs 1000]      killed and resumed again and again
    python benchmarks/online.py real FOLDER              real recordings against batch (MCAP, datasets/README.md)

`mission` runs `magyc_ifg` too where the authors' package is installed (speed_and_accuracy.py says how).
"""

import argparse
import resource
import tempfile
import time
from dataclasses import replace
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.factors.chain.vech import vech
from magyc_gtsam.study.efficiency import BLOCKS, FREEDOMS, cramer_rao, error, nees

MOTIONS = ("wide", "moderate", "low", "tiny")
INTERVALS = {  # s, the parts of real recordings that move; the magnet is attached from 41.5 to 92 s
    "broad_01_slow_rotation": (34, 160),
    "broad_06_fast_rotation": (38, 160),
    "broad_32_attached_magnet_1cm": (41.5, 92),
    "nexus5_augmented_reality": (None, None),
    "nexus5_calibration_d1": (None, None),
}


def feed(online, recording, step=1.0, after=None):
    """Each sensor's own samples, `step` seconds at a time."""
    mag, gyro = recording.magnetometer, recording.gyroscope
    edges = np.arange(recording.time[0], recording.time[-1] + step, step)
    for start, end in pairwise(edges):
        rows = slice(*np.searchsorted(mag.time, [start, end]))
        online.update(mag.time[rows], mag.value[rows])
        rows = slice(*np.searchsorted(gyro.time, [start, end]))
        online.update(gyro.time[rows], angular_rate=gyro.value[rows])
        if after is not None:
            after(end)
    return online


def distance(calibration, batch):
    """Largest difference in posterior sigmas of the batch result."""

    def vector(c):
        return np.concatenate([vech(c.soft_iron), c.hard_iron, c.gyro_bias])

    return float(np.abs((vector(calibration) - vector(batch)) / np.sqrt(np.diag(batch.covariance))).max())


def memory():
    """MB resident now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def peer(recording, minutes):
    """s that `magyc_ifg` of the authors' package takes for so many minutes; None without it."""
    if find_spec("magyc") is None:
        return None
    from magyc import magyc_ifg

    part = recording.between(0, 60 * minutes)
    start = time.process_time()
    magyc_ifg(part.magnetic_field / 1e-4, part.angular_rate, part.time, measurements_window=10)
    return time.process_time() - start


def mission(arguments):
    """Median, mean and largest time of an update with one window's samples, of a reading a minute, and memory."""
    hours = arguments.hours or 10
    recording = mg.simulate("wide", duration=3600 * hours, seed=0).recording
    for minutes in (1, 5, 10, 20):
        took = peer(recording, minutes)
        if took is not None:
            print(f"magyc_ifg, {minutes} min: {took:.1f} s, {took / (60 * minutes) * 1e3:.1f} ms per window")
    online, block = mg.OnlineCalibrator(), 15
    took, first, read = np.zeros(len(recording.time) // block), None, []
    print("            median ms   mean ms    max ms   read: median ms    max ms    memory MB")
    for i in range(len(took)):
        rows = slice(i * block, (i + 1) * block)
        start = time.process_time()
        online.update(recording.time[rows], recording.magnetic_field[rows], recording.angular_rate[rows])
        took[i] = time.process_time() - start
        if (i + 1) % 40 == 0:
            start = time.process_time()
            _ = online.calibration
            read.append(time.process_time() - start)
        if (i + 1) % 2400 == 0 or i == 399:
            part = took[i - 399 : i + 1] if i == 399 else took[i - 2399 : i + 1]
            name = "10 min" if i == 399 else f"hour {(i + 1) // 2400}"
            first = first or np.median(part)
            times = f"{np.median(part) * 1e3:11.3f}{part.mean() * 1e3:10.3f}{part.max() * 1e3:10.1f}"
            reads = f"{np.median(read) * 1e3:18.1f}{np.max(read) * 1e3:10.1f}"
            print(f"{name:10s}{times}{reads}{memory():13.2f}", flush=True)
            read.clear()
    print(f"median of the last hour over that of the first ten minutes: {np.median(took[-2400:]) / first:.2f}")
    print(
        f"against batch: {distance(online.calibration, mg.calibrate(recording)):.3f} sigma; steps {len(online.changes)}"
    )


def judged(calibration, simulation, end):
    """Squared error, Cramér–Rao bound (12,) and NEES of a calibration from the first `end` seconds."""
    span = replace(simulation, recording=simulation.recording.between(0, end))
    deviation = error(calibration, simulation.truth)
    return deviation**2, np.diag(cramer_rao(span)), nees(deviation, calibration.covariance)


def followed(simulation):
    """The end result, what was said when it first converged, and when that was."""
    first = []
    online = mg.OnlineCalibrator()

    def look(end):
        if online.converged and not first:
            first.append((end, online.calibration))

    feed(online, simulation.recording, 2.0, look)
    return online, first


def batch(arguments):
    """Against the batch method and the bound, at the end and at first convergence."""
    runs = arguments.runs or 100
    half = 1.96 * np.sqrt(2 * FREEDOMS / runs)
    print(f"NEES band {FREEDOMS - half:.2f} to {FREEDOMS + half:.2f}")
    for motion in arguments.motion or MOTIONS:
        at_end, at_first, when, apart, wrong = [], [], [], [], 0
        for seed in range(arguments.seed, arguments.seed + runs):
            simulation = mg.simulate(motion, seed=seed)
            online, first = followed(simulation)
            at_end.append(judged(online.calibration, simulation, None))
            for end, calibration in first:
                when.append(end)
                at_first.append(judged(calibration, simulation, end))
            wrong += len(online.changes)
            apart.append(distance(online.calibration, mg.calibrate(simulation.recording)))
        for name, values in (("end", at_end), ("converged", at_first)):
            square, bound, consistency = (np.mean(part, axis=0) for part in zip(*values, strict=True))
            ratio = "  ".join(f"{k} {np.sqrt(square[b].sum() / bound[b].sum()):.3f}" for k, b in BLOCKS.items())
            print(f"{motion:10s}{name:10s}{ratio}  NEES {consistency:.2f}  ({len(values)} runs)")
        print(
            f"{motion:10s}against batch at most {max(apart):.4f} sigma; converged after {np.median(when):.0f} s "
            f"({min(when):.0f} to {max(when):.0f}); false steps {wrong}",
            flush=True,
        )


def steps(arguments):
    """Steps of 2 µT (`--size`) in a random direction."""
    runs = arguments.runs or 100
    print("motion    found in 30 s  after   time: error / stated  rms z    step: rms z  max z   false")
    for motion in arguments.motion or MOTIONS:
        late, times, values, false = [], [], [], 0
        for seed in range(arguments.seed, arguments.seed + runs):
            random = np.random.default_rng(seed)
            at, step = random.uniform(200, 250), random.standard_normal(3)
            step *= arguments.size * 1e-6 / np.linalg.norm(step)
            simulation = mg.simulate(motion, duration=290, seed=seed)
            recording = simulation.recording
            field = recording.magnetic_field + (recording.time >= at)[:, None] * step
            seen = []
            online = mg.OnlineCalibrator()
            feed(
                online,
                replace(recording, magnetic_field=field),
                1.0,
                lambda t, o=online, s=seen: o.changes and s.append(t),
            )
            changes = online.changes
            false += max(len(changes) - 1, 0)
            if seen:
                late.append(seen[0] - at)
                times.append((changes[0].time - at, changes[0].time_sigma))
                values.append((changes[0].step - step) / changes[0].step_sigma)
        (error, sigma), score = np.array(times).T, np.array(values)
        print(
            f"{motion:10s}{np.sum(np.array(late) <= 30):4d} of {runs:3d}{np.median(late):8.0f} s"
            f"{rms(error):10.3f} s / {rms(sigma):.3f} s{rms(error / sigma):10.2f}"
            f"{rms(score):11.2f}{np.abs(score).max():10.1f}{false:8d}",
            flush=True,
        )


def rms(values):
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def alarms(arguments):
    """Clean motion, an hour at a time after the first."""
    hours, count = arguments.hours or 100, 0
    for seed in range(int(np.ceil(hours / 4))):
        motion = MOTIONS[seed % 4]
        online = feed(
            mg.OnlineCalibrator(), mg.simulate(motion, duration=4 * 3600, seed=1000 + seed).recording, 10.0
        )
        count += len(online.changes)
        print(f"{4 * (seed + 1):4d} h ({motion}): {count} false alarms", flush=True)


def kills(arguments):
    """Killed and resumed again and again in one run: the same final estimate?"""
    runs = arguments.runs or 1000
    recording = mg.simulate("wide", seed=0).recording
    expected = feed(mg.OnlineCalibrator(horizon=300), recording, 0.5).calibration.to_dict()
    same = 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "online.npz"
        moments = np.linspace(0.3, 599, runs)
        online, done = mg.OnlineCalibrator(horizon=300), 0
        for i in range(0, len(recording.time), 5):
            rows = slice(i, i + 5)
            online.update(recording.time[rows], recording.magnetic_field[rows], recording.angular_rate[rows])
            if done < runs and recording.time[i] >= moments[done]:
                online.save(path)
                online = mg.OnlineCalibrator.load(path)
                done = int(np.searchsorted(moments, recording.time[i], side="right"))
                same += 1
        print(
            f"{same} kills in one run: final estimate the same bit for bit: {online.calibration.to_dict() == expected}"
        )


def real(arguments):
    """Real recordings, each against batch on the same interval, and read every second."""
    for name, interval in INTERVALS.items():
        recording = mg.read(arguments.folder / f"{name}.mcap").between(*interval)
        online, read = mg.OnlineCalibrator(), []

        def look(_, online=online, read=read):
            start = time.process_time()
            _ = online.calibration
            read.append(time.process_time() - start)

        feed(online, recording, after=look)
        calibration, whole = online.calibration, mg.calibrate(recording)
        said = (
            f"converged {online.converged}; steps {len(online.changes)}; read in at most {max(read) * 1e3:.0f} ms"
        )
        print(f"{name:30s} {distance(calibration, whole):.4f} sigma; {said}")
    recording = mg.read(arguments.folder / "broad_32_attached_magnet_1cm.mcap")
    for change in feed(mg.OnlineCalibrator(), recording).changes:
        print(
            f"magnet: step at {change.time - recording.time[0]:.1f} ± {change.time_sigma:.1f} s, "
            f"{change.step * 1e6} ± {change.step_sigma * 1e6} µT, after it {change.after.hard_iron * 1e6} µT"
        )


def main() -> None:
    """Run one part and print its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts = {part.__name__: part for part in (mission, batch, steps, alarms, kills, real)}
    parser.add_argument("part", choices=parts)
    parser.add_argument("folder", type=Path, nargs="?", default=Path("."))
    parser.add_argument("--runs", type=int)
    parser.add_argument("--hours", type=float)
    parser.add_argument("--size", type=float, default=2.0, help="steps: µT")
    parser.add_argument("--seed", type=int, default=0, help="batch, steps: the first one")
    parser.add_argument("--motion", action="append", choices=MOTIONS, help="batch, steps: only this one")
    arguments = parser.parse_args()
    parts[arguments.part](arguments)


if __name__ == "__main__":
    main()
