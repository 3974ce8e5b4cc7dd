"""How often is a trusted result wrong after something changed for good late in a log?

    python benchmarks/late_changes.py [--by calibrate|online|gap] [--seeds 2] [--first-seed 0]

The vehicles are those of `real_vehicles.py`. In the last share of a log the gyroscope has another bias, the
magnetometer is turned, or it has another gain or hard iron. Of a bias a result is wrong beyond three sigmas and 1
mrad/s, of the others as `real_faults.py` states. Prints the wrong ones of the trusted for each share.
"""

import argparse
from collections import defaultdict

import numpy as np
from real_faults import judged, looks
from real_vehicles import DEG, MOTIONS, scene
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg

SHARES = (0.02, 0.05, 0.1, 0.3)
CHANGES = {  # sizes in SI units
    "gyroscope's bias": (3e-3, 10e-3),
    "magnetometer turned": (2 * DEG, 6 * DEG),
    "gain": (0.03,),
    "hard iron": (4e-6, 15e-6),
}
UNITS = {"gyroscope's bias": (1e3, "mrad/s"), "magnetometer turned": (1 / DEG, "°"), "gain": (1e2, "%")}
LEAST = 1e-3  # rad/s


def change(own, what, share, size):
    """Change a scene for good in its last share; return the gyroscope's bias there."""
    late, vector = (own.t > (1 - share) * own.t[-1])[:, None], own.vector(size)
    if what == "gyroscope's bias":
        own.on_rate.append(lambda w: w + late * vector)
        return own.bias + vector
    if what == "magnetometer turned":
        turn = Rotation.from_rotvec(vector).as_matrix()
    elif what == "gain":
        turn = np.diag(1 + vector)
    else:
        own.iron, own.right = late * vector, [(own.soft, own.hard + vector)]
        return own.bias
    own.on_field.append(lambda m: np.where(late, m @ turn.T, m))
    own.right = [(turn @ own.soft, turn @ own.hard)]
    return own.bias


def trusted_and_wrong(motion, seed, by, what, share, size):
    """Return whether the result at the end of a log is trusted, and whether it is wrong."""
    own = scene(motion, seed, f"{motion.__name__}/{what}/{share}/{size}")
    bias = change(own, what, share, size) if size else own.bias
    recording = own.recording()
    try:
        every = list(looks(recording, by))
    except mg.MagycError:
        every = []
    if not every:  # no calibration
        return False, False
    found, trusted, time = every[-1]
    if what != "gyroscope's bias":
        return trusted, judged(found, own, time)[0]
    off = np.abs(found.gyro_bias - bias)
    return trusted, bool(((off > 3 * found.sigma["gyro_bias"]) & (off > LEAST)).any())


def main():
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--by", choices=("calibrate", "online", "gap"), default="calibrate")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first-seed", type=int, default=0)
    given = parser.parse_args()
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    print("| change | " + " | ".join(f"last {share:.0%}" for share in SHARES) + " |")
    print("|---" * (1 + len(SHARES)) + "|")
    for what, sizes in {"none": (0.0,), **CHANGES}.items():
        for size in sizes:
            count = defaultdict(lambda: [0, 0])
            for share in SHARES:
                for seed in seeds:
                    for motion in MOTIONS:
                        trusted, wrong = trusted_and_wrong(motion, seed, given.by, what, share, size)
                        count[share][0] += trusted and wrong
                        count[share][1] += trusted
            scale, unit = UNITS.get(what, (1e6, "µT"))
            name = what if not size else f"{what}, {scale * size:.0f} {unit}"
            print(
                f"| {name} | " + " | ".join("{} of {}".format(*count[share]) for share in SHARES) + " |",
                flush=True,
            )


if __name__ == "__main__":
    main()
