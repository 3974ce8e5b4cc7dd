"""`smoother` and `magyc-bfg` against `magyc_bfg` of the authors' package, same process, same data.

The authors' package pins numpy < 2, so it gets an environment of its own:

    python3 -m venv .venv-peer && .venv-peer/bin/pip install . magyc==1.0.0
    .venv-peer/bin/python benchmarks/speed_and_accuracy.py

Prints, per motion, the processor times of one 10-minute log at 10 Hz (median over seeds and calls), their ratio,
and the root-mean-square errors of hard iron (mG, norm), soft iron (det 1, Frobenius, %) and gyroscope bias (mrad/s,
norm); at the end the ratio recording by recording. The peer is fed in gauss and with windows of one second, as its
documentation asks. BLAS has one thread: after a call with several the peer's wait busily for a tenth of a second, which
would count as time of what is called next.
"""

import argparse
import os
import time

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"  # read when numpy is loaded

import numpy as np
from magyc import magyc_bfg

import magyc_gtsam as mg

GAUSS = 1e-4
MOTIONS = ("wide", "moderate", "low", "tiny")


def peer(recording: mg.Recording) -> mg.Calibration:
    """The authors' MAGYC-BFG as its documentation runs it."""
    hard_iron, soft_iron, gyro_bias, *_ = magyc_bfg(
        recording.magnetic_field / GAUSS, recording.angular_rate, recording.time, measurements_window=10
    )
    scale = np.cbrt(np.linalg.det(soft_iron))
    return mg.Calibration(soft_iron / scale, hard_iron * GAUSS, gyro_bias)


PEER = "magyc_bfg of magyc 1.0.0"
METHODS = {
    "smoother": mg.calibrate,
    "magyc-bfg": lambda recording: mg.calibrate(recording, "magyc-bfg"),
    PEER: peer,
}


def errors(estimate: mg.Calibration, truth: mg.Calibration) -> tuple[float, float, float]:
    """Hard iron in mG, soft iron in %, gyroscope bias in mrad/s."""
    return (
        float(np.linalg.norm(estimate.hard_iron - truth.hard_iron)) * 1e7,
        float(np.linalg.norm(estimate.soft_iron - truth.soft_iron)) * 100,
        float(np.linalg.norm(estimate.gyro_bias - truth.gyro_bias)) * 1e3,
    )


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--repeat", type=int, default=3, help="calls per recording; the median counts")
    parser.add_argument("--peer-repeat", type=int, help="likewise of the authors' package; default: as --repeat")
    arguments = parser.parse_args()
    seeds = range(arguments.seeds)
    repeat = dict.fromkeys(METHODS, arguments.repeat) | {PEER: arguments.peer_repeat or arguments.repeat}
    mg.calibrate(mg.simulate("wide", seed=99).recording)  # imports and caches are not part of the time
    heads = ("ms", "ratio", "hard iron mG", "soft iron %", "bias mrad/s")
    print(f"{'motion':10s}{'method':26s}" + "".join(f"{head:>14s}" for head in heads))
    ratios: list[float] = []
    for motion in MOTIONS:
        took: dict[str, list[float]] = {name: [] for name in METHODS}
        wrong: dict[str, list[tuple[float, float, float]]] = {name: [] for name in METHODS}
        for seed in seeds:
            simulation = mg.simulate(motion, seed=seed)
            for name, method in METHODS.items():
                for _ in range(repeat[name]):
                    start = time.process_time()
                    estimate = method(simulation.recording)
                    took[name].append(time.process_time() - start)
                wrong[name].append(errors(estimate, simulation.truth))
        slowest = np.median(took[PEER])
        each = {name: np.median(np.reshape(took[name], (-1, repeat[name])), axis=1) for name in METHODS}
        ratios += (each[PEER] / each["smoother"]).tolist()
        for name in METHODS:
            median = np.median(took[name])
            hard, soft, bias = np.sqrt(np.mean(np.square(wrong[name]), axis=0))
            numbers = (median * 1e3, slowest / median, hard, soft, bias)
            print(f"{motion:10s}{name:26s}" + "".join(f"{number:14.2f}" for number in numbers), flush=True)
    low, middle, high = np.percentile(ratios, (0, 50, 100))
    print(f"smoother, recording by recording: median {middle:.0f}, least {low:.0f}, most {high:.0f} times")


if __name__ == "__main__":
    main()
