"""What is known, on real recordings: the skew of one unit's chips by evidence, and an earlier calibration as prior.

    python benchmarks/known.py FOLDER

FOLDER holds BROAD trials as arrays (*.npz) and `truth_by_optics.json`, as `real_honesty.py` describes. Trials of one
unit: for each, with and without the skew, the error of the hard iron against optics. Then trials with an attached
magnet: the matrix of one, and hard iron from 20 s of another.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import magyc_gtsam as mg

_MAGNET = ("broad_33", "broad_35")


def moving(path: Path) -> mg.Recording:
    """The part of a trial in which it was moved."""
    data = np.load(path)
    time = data["tm"]
    rows = np.flatnonzero(data["move"]) if "move" in data and len(data["move"]) == len(time) else [0, -1]
    recording = mg.Recording(time, data["m"].astype(float), data["w"].astype(float), name=path.stem)
    return recording.between(time[rows[0]] - time[0], time[rows[-1]] - time[0])


def truth_of(path: Path, truths: dict[str, Any]) -> np.ndarray:
    """(3,) µT by optics."""
    name = next(name for name in truths if name in path.stem or path.stem.startswith(name))
    return np.array(truths[name]["h"])


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    truths = json.loads((folder / "truth_by_optics.json").read_text(encoding="utf-8"))
    print("trial      skew °                  evidence  error µT asked / 12    trusted asked / 12")
    for path in sorted(folder.glob("broad_*.npz")):
        recording, truth = moving(path), truth_of(path, truths)
        asked, never = mg.calibrate(recording), mg.calibrate(recording, misalignment=0)
        skew = np.degrees(-asked.terms[0].value).round(2) if asked.terms else "none"
        off = [float(np.linalg.norm(each.hard_iron * 1e6 - truth)) for each in (asked, never)]
        evidence = asked.diagnostics.get("skew", {}).get("evidence", float("nan"))
        print(
            f"{path.stem[:8]}   {skew!s:22}  {evidence:7.1f}   {off[0]:6.2f} / {off[1]:6.2f}   "
            f"      {asked.trusted!s:5} / {never.trusted}"
        )
    print("\nmatrix of   hard iron from 20 s of   error µT with prior / alone / whole log")
    magnet = {name: next(folder.glob(f"{name}*.npz"), None) for name in _MAGNET}
    for first, second in (_MAGNET, _MAGNET[::-1]):
        one, other = magnet[first], magnet[second]
        if one is None or other is None:
            continue
        earlier, recording, truth = mg.calibrate(moving(one)), moving(other), truth_of(other, truths)
        middle = 0.5 * recording.duration
        part = recording.between(middle - 10, middle + 10)
        found = (
            mg.calibrate(part, prior=earlier, hard_iron_walk=100e-6),
            mg.calibrate(part),
            mg.calibrate(recording),
        )
        off = [float(np.linalg.norm(each.hard_iron * 1e6 - truth)) for each in found]
        print(f"{first}   {second}                 {off[0]:6.2f} / {off[1]:6.2f} / {off[2]:6.2f}")


if __name__ == "__main__":
    main()
