"""How often the gap over many logs of one instrument names what is missing, and says whose it is.

    python benchmarks/gap_many.py FOLDER [--sets 1] [--logs 10] [--factor 0.25] [--motion wide] [--clean 4]

A set is of one instrument: soft iron, hard iron, gyroscope bias, noise and the effect's directions are drawn once; the
motion, the noise, the surroundings and the place's field anew for each log. What is of the place or the day (a jump, a
drift, a passed object, a gradient) is drawn anew for each log as well. The catalogue's effects are hidden one at a time
at FACTOR of their published strengths, and nothing at all in the sets `--clean`. Rows are Parquet parts in
FOLDER; a run that was stopped goes on. Beside it `--one` asks each set's first log alone.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import magyc_gtsam as mg
from magyc_gtsam.blindtest.generator import sensors
from magyc_gtsam.engine import Row, run_many
from magyc_gtsam.gap.effects import NAMES
from magyc_gtsam.gap.many.model import OF_THE_PLACE
from magyc_gtsam.simulation.environment import CHANNELS

CLEAN = "nothing"


class Unit(NamedTuple):
    """A set of logs: motion, effect (or `CLEAN`), factor, number of the instrument, logs."""

    motion: str
    effect: str
    factor: float
    instrument: int
    logs: int
    one: bool

    @property
    def name(self) -> str:
        return f"{self.motion}-{self.effect}-{self.factor:g}-{self.instrument}-{self.logs}{'-one' if self.one else ''}"


def log_of(unit: Unit, number: int) -> mg.Recording:
    """One log of a set."""
    seed = 1000 * unit.instrument + number
    own = sensors(unit.instrument) | {"field": sensors(seed + 500)["field"]}
    factor = 1.0 if unit.effect == "axis-order" else unit.factor  # there is no half of it
    effects = [] if unit.effect == CLEAN else [(unit.effect, factor)]
    drawn = seed if unit.effect in OF_THE_PLACE else unit.instrument
    simulation = mg.simulate(unit.motion, seed=seed, effects=effects, channels=CHANNELS, effects_seed=drawn, **own)
    return replace(simulation.recording, attitude=None)


def worked(unit: Unit) -> Row:
    """What the gap of a set says."""
    logs = [log_of(unit, number) for number in range(unit.logs)]
    if unit.one:
        gap = mg.find_gap(logs[0])
        return {
            "names": [e.name for e in gap.effects], "of": [], "rivals": [], "verdict": gap.verdict, "strongest": []
        }  # fmt: skip
    many = mg.find_gap(logs)
    return {
        "names": [effect.name for effect in many.effects],
        "of": [effect.of for effect in many.effects],
        "rivals": [name for effect in many.effects for name in effect.ambiguous_with],
        "verdict": many.verdict,
        "strongest": [f"{w.name} {w.shared:.1f} {w.apart:.1f}" for w in many.weights[:3]],
    }


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sets", type=int, default=1)
    parser.add_argument("--logs", type=int, default=10)
    parser.add_argument("--factor", type=float, default=0.25)
    parser.add_argument("--motion", default="wide")
    parser.add_argument("--clean", type=int, default=4)
    parser.add_argument("--first", type=int, default=101, help="number of the first instrument")
    parser.add_argument("--effect", action="append", help="may be repeated; default all")
    parser.add_argument("--one", action="store_true", help="only the first log of each set, alone")
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    cases = [(effect, given.first + k) for k in range(given.sets) for effect in given.effect or NAMES]
    cases += [(CLEAN, given.first + k) for k in range(given.clean)]
    units = [Unit(given.motion, effect, given.factor, k, given.logs, given.one) for effect, k in cases]
    rows = run_many(worked, {unit.name: unit for unit in units}, workers=given.workers, parts=given.folder)
    named = wrong = told = alike = silent = 0
    for unit, row in ((unit, rows[unit.name]) for unit in units):
        if unit.effect == CLEAN:
            silent += row["verdict"] == "none"
            print(f"{unit.name:45s} {row['verdict']} {row['names']} {row['strongest']}")
            continue
        first = row["names"][0] if row["names"] else ""
        right, also = first == unit.effect, unit.effect in row["rivals"]
        named += right
        alike += not right and also
        wrong += any(name != unit.effect for name in row["names"]) and not also
        whose = "place" if unit.effect in OF_THE_PLACE else "instrument"
        told += right and row["of"][:1] == [whose]
        print(
            f"{unit.name:45s} {row['verdict']:8s} {row['names']} {row['of']} or {row['rivals']} {row['strongest']}"
        )
    count = sum(unit.effect != CLEAN for unit in units)
    print(f"\nnamed {named} of {count}, as good as another {alike}, wrong {wrong}", end="")
    print("" if given.one else f", whose it is told {told} of {named}", end="")
    print(f"; silent {silent} of {given.clean} without an effect")


if __name__ == "__main__":
    main()
