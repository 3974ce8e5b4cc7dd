"""How often is a trusted result wrong under faults as real vehicles have them?

    python benchmarks/real_faults.py [FAULT ...] [--motion NAME] [--seeds 2] [--first-seed 0]
                                     [--by calibrate|online|gap] [--times 0.5]

The vehicles are those of `real_vehicles.py`, the faults those of `real_fault_list.py`; each has two strengths, which
`--times` multiplies, numbers of rows excepted. A result is wrong if the hard iron is off by more than 4 stated sigmas
and 1 µT on an axis, or the heading of a level turn by more than 4 sigmas and 1.5°. Where the instrument changes or has
no single truth, each of its values counts as right: the latest, the mean, or that of each state; of a bent response,
the straight one that fits it best. `online` is judged at sixteen looks, where it has converged. Faults in brackets are
those that some of these motions hide. The last columns are the root mean squares of the largest errors in sigmas of
trusted results, and coverage, trusted or not: the share of the hard iron's axes within one sigma, and of hard irons
within the ellipsoid of 68 %. Of an honest covariance both are 0.68; all three axes at once are within one sigma in 0.32
if they are independent.
"""

import argparse
from collections import defaultdict
from dataclasses import replace
from itertools import pairwise

import numpy as np
from real_fault_list import FAULTS
from real_vehicles import DEG, MOTIONS, TWO_PI, scene
from scipy.stats import chi2

import magyc_gtsam as mg
from magyc_gtsam.level_turn import LevelTurn, MisalignmentError

SIGMAS, IRON, HEADING = 4.0, 1e-6, 1.5  # from which a result is wrong; T, deg
ELLIPSOID = chi2.ppf(chi2.cdf(1, 1), 3)  # square of the normalised error that 68 % do not exceed
LOOKS = 16
BY_NAME = {motion.__name__: motion for motion in MOTIONS}


def judged(calibration, own, end):
    """Return (wrong, hard iron in sigmas, T, heading in sigmas, deg, coverages) by the truth that fits best."""
    still = tuple(x for x in calibration.terms if x.name not in ("timing", "hysteresis", "tone"))
    still, covariance = replace(calibration, terms=still), calibration.covariance
    a, (n, _, d) = np.arange(0, TWO_PI, np.pi / 18), own.world
    u = np.stack([n * np.cos(a), -n * np.sin(a), d + 0 * a], axis=1)
    angle = np.arctan2(u[:, 1], u[:, 0])
    turn = LevelTurn(np.degrees(angle), u, np.eye(3)[0], np.eye(3)[1], np.degrees(np.arctan2(d, n)), "z")
    of_heading = turn.systematic(covariance, calibration.soft_iron, MisalignmentError.of(calibration.diagnostics))
    sigma, found = np.sqrt(np.diag(covariance)[6:9]), []
    for soft, hard in own.truths(end):
        rows = np.vstack([u @ soft.T + hard, hard])
        f = still.corrected(rows, time=end + 1e-3 * np.arange(len(rows)), angular_rate=own.bias + 0 * rows)
        left = calibration.soft_iron @ f[-1]
        off, square = np.abs(left), left @ np.linalg.solve(covariance[6:9, 6:9], left)
        turned = np.abs(np.angle(np.exp(1j * (np.arctan2(f[:-1, 1], f[:-1, 0]) - angle)))) / DEG
        wrong = ((off > SIGMAS * sigma) & (off > IRON)).any()
        wrong |= ((turned > SIGMAS * of_heading) & (turned > HEADING)).any()
        covered = (off < sigma).mean(), square < ELLIPSOID
        largest = (off / sigma).max(), off.max(), (turned / of_heading).max(), turned.max()
        found.append((bool(wrong), *largest, covered))
    return min(found, key=lambda each: (each[0], max(each[1], each[3])))


def looks(recording, by):
    """Yield each calibration with a covariance, whether it is to be believed, and its time."""
    if by != "online":
        found = mg.calibrate(recording) if by == "calibrate" else mg.find_gap(recording).calibration
        if found.covariance is not None:
            yield found, found.trusted, recording.time[-1]
        return
    online, edges = mg.OnlineCalibrator(), np.linspace(0, len(recording.time), LOOKS + 1).astype(int)
    (tm, m), (tg, w) = recording.magnetometer, recording.gyroscope
    for start, stop in pairwise(edges):
        first, last = recording.time[start], recording.time[stop - 1]
        for time, value, name in ((tm, m, "magnetic_field"), (tg, w, "angular_rate")):
            rows = (time >= first) & (time <= last)
            online.update(time[rows], **{name: value[rows]})
        found = online.calibration
        if found is not None and found.covariance is not None:
            yield found, online.converged and found.trusted, last


def results(motion, name, level, seed, by, times):
    """Yield for each look whether it is trusted, and the judgement."""
    own = scene(BY_NAME[motion], seed, f"{motion}/{name}/{level}")
    size = FAULTS[name][1 + level]
    FAULTS[name].act(own, size if isinstance(size, int) else times * size)
    recording = own.recording()
    try:
        for found, trusted, time in looks(recording, by):
            yield trusted, judged(found, own, time)
    except mg.MagycError:
        yield False, None


def rms(values):
    return f"{np.sqrt(np.mean(np.square(values))):.2f}" if len(values) else "–"


def main(given):
    """Print the table and every wrong result."""
    print("| fault | strength | logs | looks | trusted | wrong | hard iron σ | heading σ | axes | ellipsoid |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    count, wrong = defaultdict(int), []
    for name in given.faults or FAULTS:
        for level, strength in enumerate(("weak", "strong")):
            rows = []
            for seed in range(given.first_seed, given.first_seed + given.seeds):
                for motion in given.motion or BY_NAME:
                    for trusted, found in results(motion, name, level, seed, given.by, given.times):
                        rows.append((trusted, found))
                        if trusted and found[0]:
                            wrong.append((name, strength, motion, seed, found))
            logs = given.seeds * len(given.motion or BY_NAME)
            good = [found for trusted, found in rows if trusted]
            bad = sum(found[0] for found in good)
            within = np.mean([found[5] for _, found in rows if found is not None] or [[np.nan] * 2], axis=0)
            shown = name if FAULTS[name].shows else f"({name})"
            errors = " | ".join(rms([found[k] for found in good]) for k in (1, 3))
            errors += " | " + " | ".join(f"{each:.2f}" for each in within)
            print(f"| {shown} | {strength} | {logs} | {len(rows)} | {len(good)} | {bad} | {errors} |", flush=True)
            for key, value in (("logs", logs), ("looks", len(rows)), ("trusted", len(good)), ("wrong", bad)):
                count[key] += value
    print("\n" + ", ".join(f"{value} {key}" for key, value in count.items()))
    for name, strength, motion, seed, (_, sigmas, size, of_heading, heading, _) in wrong:
        off = f"{1e6 * size:.2f} µT {sigmas:.1f} σ, {heading:.1f}° {of_heading:.1f} σ"
        print(f"{name} {strength} {motion} seed {seed}: {off}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("faults", nargs="*", choices=[[], *FAULTS], default=[])
    parser.add_argument("--motion", action="append", choices=BY_NAME)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--by", choices=("calibrate", "online", "gap"), default="calibrate")
    parser.add_argument("--times", type=float, default=1.0)
    main(parser.parse_args())
