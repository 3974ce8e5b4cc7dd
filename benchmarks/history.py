"""What a history says of simulated seasons, and what one more log costs. `python benchmarks/history.py [SEASONS]`.

`python benchmarks/history.py shared [SEASONS]`: dives that have the same model error, in part or all of it.
`python benchmarks/history.py scale [INSTRUMENTS]`: instruments whose gyroscope's scales are off, with and without an
estimate of them.
`python benchmarks/history.py FOLDER [SCALE]`: BROAD's trials, each against the others of its unit; SCALE is the
deviation of the gyroscope's scales, 0.01 or so, which are then estimated too.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from season import SeasonPlan, dive_factors, draw_season

import magyc_gtsam as mg
from magyc_gtsam.history import History
from magyc_gtsam.history.coordinates import shape_of, soft_iron_of
from magyc_gtsam.history.log_factor import HARD_IRON, SCALE, compress, factor_of


def seasons(count: int) -> None:
    """Sixty dives, two jumps of 4 µT, a walk of 0.3 µT per √day, one dive beside a wreck, one in a wrong unit."""
    dives = dive_factors(("wide", "moderate", "low", "tiny"))
    named = false = spoilt = jumps = 0
    shape, hard_iron, ahead, covered = [], [], [], []
    for seed in range(count):
        season = draw_season(seed, dives)
        history = History(season.factors)
        found = {index for index, _, _ in history.jumps}
        contradicting = {each.index for each in history.contradictions}
        jumps += len(season.jumps)
        named += len(found & set(season.jumps))
        false += len(found - set(season.jumps)) + len(contradicting - {*season.wrecks, *season.wrong_units})
        spoilt += contradicting >= {*season.wrecks, *season.wrong_units}
        own = compress(history.calibrations[history.groups[0][0]], "", None)
        assert own.covariance is not None
        off = shape_of(history.calibrations[history.groups[0][0]].soft_iron)[0] - season.shape
        shape.append(off @ np.linalg.solve(own.covariance[:5, :5], off))
        for k in set(history.groups[0]) - contradicting:
            off = history.hard_iron[k] - season.hard_iron[k]
            hard_iron.append(off @ np.linalg.solve(history.hard_iron_covariance[k], off))
        off = history.next.hard_iron - season.next_hard_iron
        spread = np.asarray(history.next.covariance)[6:9, 6:9]
        ahead.append(off @ np.linalg.solve(spread, off))
        covered += list(np.abs(off) < 1.96 * np.sqrt(np.diag(spread)))
    band = 1.96 * np.sqrt(2 / count)
    print(f"{count} seasons")
    print(f"jumps named and dated {named}/{jumps}; false jumps and contradictions {false} in {60 * count} dives")
    print(f"seasons whose wreck and wrong unit are both named {spoilt}/{count}")
    print(f"NEES of the soft iron {np.mean(shape):.2f} of 5 ± {band * np.sqrt(5):.2f}")
    print(f"NEES of the hard iron {np.mean(hard_iron):.2f} of 3")
    print(f"NEES of the next dive's hard iron {np.mean(ahead):.2f} of 3 ± {band * np.sqrt(3):.2f}")
    print(f"its 95 % interval holds {np.mean(covered):.1%}")


def shared_errors(count: int) -> None:
    """Print the NEES of the next dive's soft and hard iron where the dives share their model error or not."""
    kinds = dive_factors(("wide", "moderate", "low", "tiny"))
    for size in ((0.005, 0.5), (0.0005, 0.05)):
        for share in (0.0, 0.5, 1.0):
            for dives in (2, 5, 20, 60):
                plan = SeasonPlan(dives, 0.1, 0, 0.0, 0, 0, model_error=size, shared=share)
                squares = []
                for seed in range(count):
                    season = draw_season(10_000 + seed, kinds, plan)
                    found = compress(History(season.factors).next, "", None)
                    off = found.mean - np.r_[season.shape, season.next_hard_iron * 1e6, np.zeros(3)]
                    parts = (slice(0, 5), HARD_IRON)
                    squares.append([off[p] @ np.linalg.solve(found.covariance[p, p], off[p]) for p in parts])
                nees = "{:.1f} of 5, {:.1f} of 3".format(*np.mean(squares, axis=0))
                print(f"{size[0]:.2%}, {size[1]} µT, {share:.0%} shared, {dives} dives: soft and hard iron {nees}")


def one_more(logs: int) -> None:
    """Processor time of adding a log and reading its result, in units of one calibration."""
    season = draw_season(0, dive_factors(("wide", "low")), SeasonPlan(dives=logs))
    history = History(season.factors)
    with TemporaryDirectory() as folder:
        history.save(Path(folder) / "history.yaml")
        start = time.process_time()
        history = History.load(Path(folder) / "history.yaml")
        read = time.process_time() - start
    instrument = {"soft_iron": soft_iron_of(season.shape), "hard_iron": season.next_hard_iron}
    bias = history.next.gyro_bias
    recording = mg.simulate("wide", 600, 10, seed=1, gyro_bias=bias, **instrument).recording
    mg.calibrate(recording)  # what is imported and made once
    start = time.process_time()
    mg.calibrate(recording)
    alone = time.process_time() - start
    start = time.process_time()
    history.add(recording, time=season.factors[-1].time + 86400.0)
    added = time.process_time() - start
    start = time.process_time()
    history.next  # noqa: B018
    solved = time.process_time() - start
    assert logs in history.groups[0]
    shares = f"add {added / alone:.1f}, then the next calibration {solved / alone:.1f}"
    print(f"{logs} logs: {shares} times one calibration; to load the file {read / alone:.1f}")


def left_out(folder: Path, options: dict[str, float]) -> None:
    """Each trial of a unit of BROAD against what the others of its unit predict; `folder` holds the trials' arrays."""
    factors = {}
    for file in sorted(folder.glob("broad_*.npz")):
        data, trial = np.load(file), int(file.name[6:8])
        rows = np.flatnonzero((data["tm"] > 53) & (data["tm"] < 95) if trial in (33, 35) else data["move"])
        time, field, rate = data["tm"][rows], data["m"][rows].astype(float), data["w"][rows].astype(float)
        factors[trial] = factor_of(mg.Recording.from_streams((time, field), (time, rate)), None, options)
    for number, name in ((1, "broad_01_slow_rotation"), (6, "broad_06_fast_rotation")):
        factors[number] = factor_of(mg.read(folder.parent / f"{name}.mcap"), None, options)
    magnet = mg.read(folder.parent / "broad_32_attached_magnet_1cm.mcap").between(41.5, 92)
    factors[32] = factor_of(magnet, None, options)
    trials = sorted(factors)
    history = History([factors[trial] for trial in trials])
    for group in history.groups:
        print("unit:", *(trials[i] for i in group))
        for i in group:
            own = history.factors[i]
            others = compress(History([history.factors[k] for k in group if k != i]).next, "", None)
            off, spread = own.mean - others.mean, own.covariance + others.covariance
            parts = [(slice(0, 5), "soft iron"), (HARD_IRON, "hard iron")]
            for part, name in [*parts, (SCALE, "gyroscope's scale, ‰")][: 3 if options else 2]:
                squares = off[part] @ np.linalg.solve(spread[part, part], off[part]) / len(off[part])
                print(
                    f"  trial {trials[i]}, {name}: off by {np.round(off[part], 4)}, squares / freedoms {squares:.2f}"
                )


def scales(instruments: int) -> None:
    """Print errors and NEES of `next` from ten dives an instrument, whose gyroscope's scales are off by 1 % an axis."""
    for options in ({}, {"gyroscope_scale": 0.01}):
        squares, errors, sigmas, logs = [], [], [], 0
        for seed in range(instruments):
            dives, truth = dives_with_scale(seed)
            history = mg.calibrate_many(dives, **options)
            found = compress(history.next, "", None)
            off = found.mean - (truth if options else np.delete(truth, np.arange(14)[SCALE]))
            parts = [slice(0, 5), HARD_IRON, *([SCALE] if options else [])]
            squares.append([off[p] @ np.linalg.solve(found.covariance[p, p], off[p]) for p in parts])
            errors.append([off[p] @ off[p] for p in parts])
            sigmas.append(np.trace(found.covariance[HARD_IRON, HARD_IRON]))
            logs += sum(factor.mean is not None for factor in history.factors)
        print(f"{options or 'without'}: {logs} of {10 * instruments} logs used")
        print("  NEES of soft iron (5), hard iron (3), scale (3):", np.round(np.mean(squares, axis=0), 2))
        print("  root mean square error, relative, µT, ‰:", np.round(np.sqrt(np.mean(errors, axis=0)), 4))
        print(f"  stated sigma of the hard iron {np.sqrt(np.mean(sigmas)):.3f} µT")


def dives_with_scale(seed: int) -> tuple[list[mg.Recording], np.ndarray]:
    """Return ten dives of an instrument, and s, g ‰, h µT and a bias of 0 for what varies from dive to dive."""
    rng = np.random.default_rng(seed)
    shape, scale, hard_iron = rng.normal(0, 0.05, 5), rng.normal(0, 0.01, 3), rng.normal(0, 20e-6, 3)
    own_bias = rng.normal(0, 5e-3, 3)
    dives = []
    for k in range(10):
        motion = str(rng.choice(["wide", "moderate", "low", "tiny"]))
        bias = own_bias + rng.normal(0, 1e-3, 3)
        dive = mg.simulate(
            motion,
            600,
            10,
            seed=1000 * seed + k,
            soft_iron=soft_iron_of(shape),
            hard_iron=hard_iron,
            gyro_bias=bias,
        ).recording
        time, rate = dive.gyroscope
        dives.append(dive.with_samples(dive.magnetometer, (time, bias + (rate - bias) * (1 + scale))))
    return dives, np.r_[shape, scale * 1e3, hard_iron * 1e6, np.zeros(3)]


if __name__ == "__main__":
    if len(sys.argv) > 1 and Path(sys.argv[1]).is_dir():
        left_out(Path(sys.argv[1]), {"gyroscope_scale": float(sys.argv[2])} if len(sys.argv) > 2 else {})
    elif sys.argv[1:2] == ["shared"]:
        shared_errors(int(sys.argv[2]) if len(sys.argv) > 2 else 40)
    elif sys.argv[1:2] == ["scale"]:
        scales(int(sys.argv[2]) if len(sys.argv) > 2 else 40)
    else:
        seasons(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
        one_more(60)
        one_more(1000)
