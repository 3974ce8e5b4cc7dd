"""What is known, on real recordings: the skew of one unit's chips by evidence, and an earlier calibration as prior.

    python benchmarks/known.py FOLDER

FOLDER holds BROAD trials as MCAP, and others as arrays in its folder `real`, as `real_honesty.py` describes. The
heading is judged by the optical attitude: the standard deviation of the field's direction, which the room bends by
some 3°.

1. Each trial's moving part: what is said of a skew, and whether the result is trusted.
2. Trials of one unit: each is calibrated with the skew by evidence and with twelve parameters, and judged on the others
   that are not disturbed.
3. Trials with an attached magnet, while it is attached: the matrix from the other two as prior and the hard iron from
   20 s, judged on the whole, against a calibration of the whole and of the 20 s alone; means over all such pieces, 4 s
   apart.
"""

from __future__ import annotations

import argparse
from itertools import permutations
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

import magyc_gtsam as mg
from magyc_gtsam.study.outcome import heading_error

UNITS = {
    "A": ("01", "04", "06"),
    "B": ("02", "05", "28"),
}  # by gyroscope biases and hard irons; the files do not say
DISTURBED = ("28",)  # magnets beside it
MOVING = {"01": (34.0, 160.0), "06": (38.0, 160.0)}  # s; the others say it themselves
ATTACHED = {"32": (41.5, 92.0), "33": (46.0, 92.0), "35": (46.0, 92.0)}  # s
PIECE = 20.0  # s
ANYTHING = 100e-6  # T, by which a magnet changes the hard iron
RAW = mg.Calibration(np.eye(3), np.zeros(3))


def read(path: Path) -> mg.Recording:
    """The moving part of a trial, with the optical attitude."""
    number = path.name[6:8]
    if path.suffix == ".mcap":
        return mg.read(path).between(*MOVING.get(number, ATTACHED.get(number)))
    data = np.load(path)
    time = data["tm"]
    seen = np.linalg.norm(data["q"], axis=1) > 0.5
    inside = (time > data["tq"][seen][0]) & (time < data["tq"][seen][-1])
    attitude = np.full((len(time), 4), np.nan)
    attitude[inside] = Slerp(data["tq"][seen], Rotation.from_quat(data["q"][seen]))(time[inside]).as_quat()
    field, rate = data["m"].astype(float), data["w"].astype(float)
    recording = mg.Recording(time, field, rate, attitude=attitude, name=path.stem)
    moved = time[np.flatnonzero(data["move"])[[0, -1]]] - time[0]
    return recording.between(*ATTACHED.get(number, moved))


def main() -> None:
    """Print the three tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    paths = sorted([*folder.glob("broad_*.mcap"), *folder.glob("real/broad_*.npz")], key=lambda path: path.name)
    logs = {path.name[6:8]: read(path) for path in paths}
    print("trial  skew °                  evidence  trusted  whether the field varies")
    asked, never = {}, {}
    for number, log in logs.items():
        blind = mg.Recording(
            log.time,
            log.magnetic_field,
            log.angular_rate,
            magnetic_field_fresh=log.magnetic_field_fresh,
            angular_rate_fresh=log.angular_rate_fresh,
        )
        asked[number], never[number] = mg.calibrate(blind), mg.calibrate(blind, misalignment=0)
        found = asked[number]
        skew = np.degrees(-found.terms[0].value).round(2) if found.terms else "none"
        evidence = found.diagnostics.get("skew", {}).get("evidence", np.nan)
        varies = next((said for said in found.message.split("; ") if "the field" in said and "varies" in said), "")
        print(f"{number}     {skew!s:22}  {evidence:8.1f}  {found.trusted!s:7}  {varies[:90]}")
    print("\nfit on  judged on  heading °: raw    12   by evidence")
    means = []
    for unit in UNITS.values():
        for one, other in permutations([number for number in unit if number in logs], 2):
            if other in DISTURBED:
                continue
            ways = RAW, never[one], asked[one]
            means.append([judged(logs[other], way, asked[one].delay) for way in ways])
            print(f"{one}      {other}               " + "  ".join(f"{each:5.2f}" for each in means[-1]))
    print("mean                      " + "  ".join(f"{each:5.2f}" for each in np.mean(means, axis=0)))
    print("\nmagnet  heading °: 20 s with the others' matrix  20 s alone  whole")
    for number in ATTACHED:
        others = [logs[other] for other in ATTACHED if other != number and other in logs]
        if number not in logs or len(others) < 2:
            continue
        prior = mg.calibrate(others[0])
        prior = mg.calibrate(others[1], prior=prior, hard_iron_walk=ANYTHING)
        log = logs[number]
        whole = mg.calibrate(log)
        pieces = [log.between(start, start + PIECE) for start in np.arange(0, log.duration - PIECE, 4.0)]
        ways = {"told": {"prior": prior, "hard_iron_walk": ANYTHING}, "alone": {}}
        found = {way: [mg.calibrate(piece, **options) for piece in pieces] for way, options in ways.items()}
        means = [np.mean([judged(log, each, each.delay) for each in found[way]]) for way in ways]
        print(
            f"{number}                     "
            + "  ".join(f"{each:12.2f}" for each in (*means, judged(log, whole, whole.delay)))
        )


def judged(log: mg.Recording, calibration: mg.Calibration, delay: float) -> float:
    """deg, standard deviation of the magnetic heading in the optical world."""
    return heading_error(log, calibration, delay).deviation


if __name__ == "__main__":
    main()
