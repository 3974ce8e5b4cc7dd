"""Faults in a graph of inertial factors and positions: what the health says while the heading is wrong.

    python benchmarks/slam_faults.py --seeds 3 --first 523
    python benchmarks/slam_faults.py --seeds 10 --first 523 --fault none --fault half-a-turn

Vehicles and graph are in `slam_vehicles.py`. A look, every 2 s, is wrong where the heading is off by more than five of
its stated sigmas and three degrees.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np
from scipy.spatial.transform import Rotation
from slam_vehicles import FIELD, KINDS, Graph, Vehicle


def _mounted(axis: str, degrees: float) -> dict:
    return {"mounting": Rotation.from_euler(axis, degrees, degrees=True).as_matrix()}


def _turned(degrees: float) -> dict:
    return {"world": Rotation.from_euler("z", degrees, degrees=True).apply(FIELD)}


FAULTS = {  # arguments of the vehicle and of its graph
    "none": ({}, {}),
    "sparse": ({}, {"fixes": 10, "odometry": True}),
    "half-a-turn": ({}, {"heading": 3.1, "prior": 1.5, "skip": 10, "threshold": 0.1}),
    "mounting-45": (_mounted("z", 45), {}),
    "mounting-90": (_mounted("z", 90), {}),
    "mounting-180": (_mounted("z", 180), {}),
    "upside-down": (_mounted("x", 180), {}),
    "on-edge": (_mounted("y", 90), {}),
    "north-east-down": ({}, {"world": np.array([FIELD[1], FIELD[0], -FIELD[2]])}),
    "declination-30": ({}, _turned(30)),
    "declination-15": ({}, _turned(15)),
    "step": ({"step": (70.0, 6e-6)}, {}),
    "steel": ({"steel": (60.0, 80.0, 10e-6)}, {}),
    "late": ({"late": 0.1}, {}),
    "bias": ({}, {"bias": np.array([0.05, -0.05, 0.05])}),
}


def main() -> None:
    """Read the command line and print a line for each vehicle and fault."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--duration", type=float, default=120.0, help="s")
    parser.add_argument("--fault", action="append", choices=list(FAULTS))
    parser.add_argument("--vehicle", action="append", choices=KINDS)
    options = parser.parse_args()
    for fault in options.fault or FAULTS:
        drive, held = FAULTS[fault]
        for kind in options.vehicle or KINDS:
            wrong, ends, alarms, judged, scaled = Counter(), Counter(), [], [], []
            for seed in range(options.first, options.first + options.seeds):
                looks = Graph(Vehicle(kind, seed, options.duration, **drive), **held).run()
                states = [
                    "unjudged" if look.health.status == "waiting" and not look.waiting else str(look.health.status)
                    for look in looks
                ]
                wrong.update(state for look, state in zip(looks, states, strict=True) if look.wrong)
                ends[states[-1]] += 1
                alarms += [
                    next((x.time for x, s in zip(looks, states, strict=True) if s[:2] in ("su", "in")), np.nan)
                ]
                judged.append(states.count("unjudged"))
                scaled += [x.error / x.sigma for x, s in zip(looks, states, strict=True) if s == "consistent"]
            slowest = 2 * max(judged)
            error = np.sqrt(np.mean(np.square(scaled))) if scaled else np.nan
            alarm = f"{np.nanmedian(alarms):.0f} s" if np.isfinite(alarms).any() else "none"
            print(
                f"{fault:15s} {kind:10s} wrong looks {dict(wrong)}; alarm in {np.isfinite(alarms).sum()} of "
                f"{options.seeds} (median {alarm}); not judged for {slowest} s at most; ends {dict(ends)}; errors "
                f"while consistent {error:.2f} sigma",
                flush=True,
            )


if __name__ == "__main__":
    main()
