"""Online: the hard iron and its deviation as they settle while samples come in.

python examples/online_stream.py figure.png
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import magyc_gtsam as mg

EVERY = 100  # samples between two looks


def main(figure: Path = Path("online_stream.png"), duration: float = 300.0, seed: int = 4) -> str:
    """Feed a simulated dive sample by sample and save the figure; when it converged, and how far off it is."""
    simulation = mg.simulate("dive", duration, seed=seed)
    recording, online = simulation.recording, mg.OnlineCalibrator()
    assert recording.angular_rate is not None
    seen, converged = [], None
    for k, sample in enumerate(zip(recording.time, recording.magnetic_field, recording.angular_rate, strict=True)):
        online.update(*sample)
        if k % EVERY == EVERY - 1 and online.calibration is not None:
            calibration = online.calibration
            seen.append((sample[0], calibration.hard_iron, calibration.sigma["hard_iron"]))
            if online.converged and converged is None:
                converged = sample[0]
    time, value, sigma = (np.array(column) for column in zip(*seen, strict=True))
    off = 1e6 * (value - simulation.truth.hard_iron)
    drawing, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
    for axis, colour in enumerate(("#2b8cdb", "#1f9e89", "#d9730d")):
        axes.plot(time, off[:, axis], color=colour, label="xyz"[axis])
        axes.fill_between(time, -1e6 * sigma[:, axis], 1e6 * sigma[:, axis], color=colour, alpha=0.12)
    limit = 4e6 * float(sigma[len(sigma) // 3].max())
    axes.set(xlabel="Time (s)", ylabel="Hard iron off by (µT)", ylim=(-limit, limit))
    axes.legend()
    drawing.savefig(figure)
    plt.close(drawing)
    last = f"the hard iron is off by {np.linalg.norm(off[-1]):.2f} µT at the end"
    return f"{'not converged' if converged is None else f'converged after {converged:.0f} s'}; {last}"


if __name__ == "__main__":
    print(main(*map(Path, sys.argv[1:])))
