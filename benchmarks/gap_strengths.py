"""The published strengths of the blind test's effects, and how far each stands out on its motions.

python benchmarks/gap_strengths.py [--runs 4]
"""

import argparse

from magyc_gtsam.blindtest.scenarios import MOTIONS
from magyc_gtsam.blindtest.visibility import median_visibility
from magyc_gtsam.simulation.effects import STRENGTHS


def main() -> None:
    """Print the table of docs/blind_test.md."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=4, help="recordings of each effect and motion")
    runs = parser.parse_args().runs
    print(f"| effect | × 1 | {' | '.join(f'σ, {motion}' for motion in MOTIONS)} | reason for the size |")
    print("|---" * (3 + len(MOTIONS)) + "|")
    for name, strength in STRENGTHS.items():
        sigmas = " | ".join(f"{median_visibility(name, motion, runs):.0f}" for motion in MOTIONS)
        print(f"| {name} | {strength.shown} | {sigmas} | {strength.reason} |", flush=True)


if __name__ == "__main__":
    main()
