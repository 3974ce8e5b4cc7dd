"""The gap workflow away from the blind test's ten minutes at 10 Hz: other rates, lengths, noise, fields and logs.

    python benchmarks/gap_conditions.py --clean 10 --effects 1

For each condition: recordings in which nothing is hidden, and one (`--effects`) with each effect of the catalogue, and
with each that is in none, at its published strength. That strength is one of ten minutes at 10 Hz and 10 mG: a short or
a noisy recording shows less of it. Counted as the blind test counts; two processes at a time.
"""

import argparse
import os
import zlib
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.blindtest.generator import sensors
from magyc_gtsam.blindtest.scenarios import Scenario
from magyc_gtsam.blindtest.scoring import IN_SET, REFUSED, RIGHT, SILENT, UNKNOWN, WRONG, judged
from magyc_gtsam.simulation import simulate
from magyc_gtsam.simulation.effects import FOREIGN, NAMED
from magyc_gtsam.simulation.environment import CHANNELS

Sensors = dict[str, Any]
Random = np.random.Generator


@dataclass(frozen=True)
class Condition:
    """What differs: the motion, its length s and rate Hz, the sensors, and what is made of the log."""

    motion: str = "wide"
    duration: float = 600.0
    rate: float = 10.0
    sensors: Callable[[Sensors, Random], Sensors] = lambda sensors, _: sensors
    log: Callable[[mg.Recording, Random], mg.Recording] = lambda recording, _: recording


def noise(magnetometer: float, gyroscope: float) -> Callable[[Sensors, Random], Sensors]:
    """Sensors of other noise, T and rad/s."""
    return lambda sensors, _: sensors | {"magnetometer_noise": magnetometer, "gyroscope_noise": gyroscope}


def field(dip: float) -> Callable[[Sensors, Random], Sensors]:
    """A field that dips by `dip` degrees."""
    north, down = np.cos(np.radians(dip)), np.sin(np.radians(dip))
    return lambda sensors, _: sensors | {"field": np.linalg.norm(sensors["field"]) * np.array([north, 0.0, down])}


def streams(every: int, jitter: float = 0.0, lost: float = 0.0) -> Callable[[mg.Recording, Random], mg.Recording]:
    """Streams of their own: the magnetometer at one in `every` of the rows, stamps late by up to `jitter` s."""

    def log(recording: mg.Recording, random: Random) -> mg.Recording:
        time = recording.time
        rows = np.arange(0, len(time), every)
        rows = rows[random.random(len(rows)) >= lost]
        assert recording.angular_rate is not None
        assert recording.acceleration is not None
        late = time + random.uniform(0, jitter, len(time)) if jitter else time
        return mg.Recording.from_streams(
            (late[rows], recording.magnetic_field[rows]),
            (late, recording.angular_rate),
            acceleration=(late, recording.acceleration),
            channels={name: (time[::20], value[::20]) for name, value in recording.channels.items()},
        )

    return log


def holes(recording: mg.Recording, random: Random) -> mg.Recording:
    """Four holes of 3 to 30 s."""
    kept = np.ones(len(recording.time), dtype=bool)
    for start, length in zip(random.uniform(30, 550, 4), random.uniform(3, 30, 4), strict=True):
        kept &= ~((recording.time > start) & (recording.time < start + length))
    return recording.rows(kept)


def lost(recording: mg.Recording, random: Random) -> mg.Recording:
    """One row in five lost."""
    return recording.rows(random.random(len(recording.time)) >= 0.2)


def counts(recording: mg.Recording, _: Random) -> mg.Recording:
    """A magnetometer that reads counts."""
    return replace(recording, magnetic_field=recording.magnetic_field / 1.5e-9, magnetic_field_unit="counts")


CONDITIONS = {
    "50 Hz, 2 min": Condition(duration=120, rate=50),
    "10 Hz, 2 min": Condition(duration=120),
    "25 Hz, 5 min": Condition(duration=300, rate=25),
    "10 Hz, 30 min": Condition("multi", duration=1800),
    "a dive": Condition("dive"),
    "a survey": Condition("survey"),
    "2 mG, 1 mrad/s": Condition(sensors=noise(2e-7, 1e-3)),
    "30 mG, 10 mrad/s": Condition(sensors=noise(30e-7, 1e-2)),
    "at the equator": Condition("multi", sensors=field(0)),
    "near a pole": Condition(sensors=field(84)),
    "hard iron of 250 µT": Condition(
        sensors=lambda s, random: s | {"hard_iron": 2.5e-4 / np.sqrt(3) * random.standard_normal(3)}
    ),
    "soft iron of 1.5 : 0.7": Condition("multi", sensors=lambda s, _: s | {"soft_iron": np.diag([1.5, 1.0, 0.7])}),
    "14 and 100 Hz streams": Condition("multi", duration=300, rate=100, log=streams(7)),
    "20 and 100 Hz, jitter": Condition(duration=300, rate=100, log=streams(5, jitter=8e-4, lost=0.1)),
    "four holes": Condition(log=holes),
    "one row in five lost": Condition("multi", log=lost),
    "counts": Condition(log=counts),
}


def diagnosed(job: tuple[str, str, int]) -> tuple[str, str, str]:
    """(condition, set, kind of the outcome) of one recording."""
    name, effect, number = job
    condition = CONDITIONS[name]
    kind = "single" if effect in NAMED else "foreign" if effect else "none"
    seed = zlib.crc32(f"{name}/{effect}/{number}".encode())
    random = np.random.default_rng([seed, 3])
    effects = ((effect, 1.0),) if effect else ()
    hidden = simulate(
        condition.motion,
        condition.duration,
        condition.rate,
        seed=seed,
        effects=effects,
        channels=CHANNELS,
        **condition.sensors(sensors(seed), random),
    ).recording
    try:
        gap = mg.find_gap(condition.log(replace(hidden, attitude=None), random))
    except mg.MagycError as error:
        return name, kind, f"{REFUSED}: {error}"
    named = tuple((e.name, tuple(e.ambiguous_with)) for e in gap.effects)
    return name, kind, judged(Scenario("", kind, condition.motion, seed, effects), gap.verdict, named)


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--clean", type=int, default=10, help="recordings a condition in which nothing is hidden")
    parser.add_argument("--effects", type=int, default=1, help="recordings a condition of each effect")
    parser.add_argument("--only", choices=CONDITIONS, help="one condition")
    options = parser.parse_args()
    chosen = [options.only] if options.only else list(CONDITIONS)
    hidden = [("", options.clean), *((effect, options.effects) for effect in (*NAMED, *FOREIGN))]
    jobs = [(name, effect, k) for name in chosen for effect, runs in hidden for k in range(runs)]
    print(
        f"{'condition':26s}{'clean, silent':>15s}{'named':>10s}{'wrong':>7s}{'foreign, UNKNOWN':>18s}{'wrong':>7s}"
    )
    tally: Counter[tuple[str, str, str]] = Counter()
    with ProcessPoolExecutor(2) as pool:
        for name, kind, outcome in pool.map(diagnosed, jobs):
            tally[name, kind, outcome] += 1
            if outcome.startswith(f"{REFUSED}:"):
                print(f"  {name}, {kind}: {outcome}", flush=True)
            if sum(n for (of, *_), n in tally.items() if of == name) == len(jobs) // len(chosen):
                _print(name, tally)


def _print(name: str, tally: Counter[tuple[str, str, str]]) -> None:
    def of(kind: str, *outcomes: str) -> str:
        every = sum(n for (condition, k, _), n in tally.items() if (condition, k) == (name, kind))
        return f"{sum(tally[name, kind, outcome] for outcome in outcomes)} of {every}" if every else "-"

    print(
        f"{name:26s}{of('none', SILENT):>15s}{of('single', RIGHT, IN_SET):>10s}{tally[name, 'single', WRONG]:>7d}"
        f"{of('foreign', UNKNOWN):>18s}{tally[name, 'foreign', WRONG]:>7d}",
        flush=True,
    )


if __name__ == "__main__":
    main()
