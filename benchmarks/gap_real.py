"""What the gap workflow finds in public recordings, and of what is put into them.

    python benchmarks/gap_real.py FOLDER
    python benchmarks/gap_real.py FOLDER --put-in

FOLDER holds recordings named in datasets/README.md, as MCAP. Prints what is found to be missing in the twelve
parameters, and the standard deviation of the magnetic heading against the optical reference with these and with what
was found. With `--put-in`: a step of 6 µT, the gyroscope's axes in another order and with other signs, and 60 ms
of delay, each put into each recording, beside what is there anyway.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.gap.result import Effect, Gap
from magyc_gtsam.simulation import inject

LOOKS = [  # s
    *(("broad_01_slow_rotation", a, b) for a, b in ((34, 160), (34, 150), (34, 158), (35, 157), (36, 154))),
    *(("broad_01_slow_rotation", a, b) for a, b in ((38, 160), (40, 156), (None, None))),
    ("broad_06_fast_rotation", 38, 160),
    ("broad_06_fast_rotation", None, None),
    ("broad_32_attached_magnet_1cm", 41.5, 92),
    ("broad_32_attached_magnet_1cm", None, None),
    ("nexus5_augmented_reality", None, None),
    ("nexus5_calibration_d1", None, None),
    ("breakout_boards_hand_rotation", None, None),
]
PUT_INTO = [
    ("broad_01_slow_rotation", 36, 154),
    ("broad_06_fast_rotation", 40, 155),
    ("broad_32_attached_magnet_1cm", 41.5, 92),
    ("nexus5_augmented_reality", None, None),
    ("nexus5_calibration_d1", None, None),
    ("breakout_boards_hand_rotation", None, None),
]
TURNED = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
STEP, DELAY = 10.0, 1.5  # published strengths: 6 µT, 60 ms
SEED = 7


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--put-in", action="store_true", help="put known effects in, each by itself")
    arguments = parser.parse_args()
    judge = put_in if arguments.put_in else as_it_is
    for name, start, end in PUT_INTO if arguments.put_in else LOOKS:
        part = "" if start is None else f", {start:g} to {end:g} s"
        print(f"{name}{part}", flush=True)
        judge(mg.read(arguments.folder / f"{name}.mcap").between(start, end))


def as_it_is(recording: mg.Recording) -> None:
    """Print what is missing and the heading before and after it is added."""
    gap = mg.find_gap(recording)
    print(f"    {gap.verdict}: {gap.sentence}")
    if gap.before.heading is not None:
        before, after = gap.before.heading, gap.after.heading
        print(f"    heading {before:.2f}° with twelve parameters, {after:.2f}° with the effects")


def put_in(recording: mg.Recording) -> None:
    """Print what is found of a step, of exchanged axes and of a delay, each put in by itself."""
    own = mg.find_gap(recording)
    order = named(own, "axis-order")
    right = recording
    if order:  # exchanged already: the calibration of the others needs them right
        right = replace(recording, angular_rate=recording.angular_rate @ order[0].value.reshape(3, 3).T)
    calibration = mg.calibrate(right)

    stepped, (truth,) = inject(right, calibration, [("hard-iron-step", STEP)], seed=SEED)
    steps = named(mg.find_gap(stepped), "hard-iron-step")
    size = 6e-7 * STEP * truth.drawn["direction"]
    for step in steps:
        since = step.setting["time"] - recording.time[0] - truth.drawn["time"]
        off = np.linalg.norm(step.value * 1e-6 - size) * 1e6
        print(f"    a step: found {since:+.2f} s from its time, {off:.2f} µT from its 6 µT")
    if not steps:
        print("    a step: missed")

    turned = named(mg.find_gap(replace(right, angular_rate=right.angular_rate @ TURNED.T)), "axis-order")
    exact = bool(turned) and np.array_equal(turned[0].value.reshape(3, 3), TURNED.T)
    print(f"    exchanged axes: {'found' if exact else 'missed'}")

    late, _ = inject(right, calibration, [("timing", DELAY)], seed=SEED)
    delays = [named(gap, "timing") for gap in (own, mg.find_gap(late))]
    before, after = ("none" if not d else f"{d[0].value[0]:.1f} ms" for d in delays)
    print(f"    60 ms of delay: {before} before, {after} with it")


def named(gap: Gap, name: str) -> list[Effect]:
    """The effects of a name that were found."""
    return [effect for effect in gap.effects if effect.name == name]


if __name__ == "__main__":
    main()
