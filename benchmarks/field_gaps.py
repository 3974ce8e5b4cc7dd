"""Calibrate logs whose magnetometer pauses, with a gyroscope whose scales are wrong: does the sigma hold?

    python benchmarks/field_gaps.py [--seeds 20] [--first-seed 7000]

Ten minutes at 10 Hz without the field for three times 20 s, the gyroscope's axes off by 0.2 % (1σ), or by 1 % and
estimated. Per motion: results that are trusted, the mean NEES of the hard iron (3 expected; less, since the covariance
has room for other errors than are there), and the root mean squares of its error and of its stated sigma.
"""

from __future__ import annotations

import argparse

import numpy as np

import magyc_gtsam as mg

PAUSES = (120.0, 300.0, 450.0)  # s, their begins
LASTS = 20.0  # s


def with_pauses(simulation: mg.Simulation, scale: np.ndarray) -> mg.Recording:
    """The recording without the field in the pauses, the gyroscope's rates about its bias wrong by scales (3,)."""
    (time, field), (gyroscope_time, rate) = simulation.recording.magnetometer, simulation.recording.gyroscope
    bias = simulation.truth.gyro_bias
    kept = ~np.any([(time > begin) & (time < begin + LASTS) for begin in PAUSES], axis=0)
    return mg.Recording.from_streams(
        (time[kept], field[kept]), (gyroscope_time, bias + (rate - bias) * (1 + scale))
    )


def main(seeds: range) -> None:
    """Print the table."""
    print("| motion | scales | trusted | NEES of 3 | error, µT | sigma, µT |\n|---|---|---|---|---|---|")
    for motion in ("wide", "moderate", "low", "tiny"):
        for size, prior in ((0.002, 0.0), (0.01, 0.01)):
            found = []
            for seed in seeds:
                simulation = mg.simulate(motion, seed=seed)
                scale = np.random.default_rng(seed).normal(0, size, 3)
                calibration = mg.calibrate(with_pauses(simulation, scale), gyroscope_scale=prior)
                if calibration.trusted:
                    assert calibration.covariance is not None
                    covariance = calibration.covariance[6:9, 6:9]
                    error = calibration.hard_iron - simulation.truth.hard_iron
                    found.append((error @ np.linalg.solve(covariance, error), error @ error, np.trace(covariance)))
            nees, error2, sigma2 = np.mean(found, axis=0) if found else (np.nan,) * 3
            print(
                f"| {motion} | {100 * size:g} %{', estimated' if prior else ''} | {len(found)} of {len(seeds)} "
                f"| {nees:.1f} | {1e6 * np.sqrt(error2):.2f} | {1e6 * np.sqrt(sigma2):.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=7000)
    given = parser.parse_args()
    main(range(given.first_seed, given.first_seed + given.seeds))
