"""Disturbed stretches, for tests of robustness."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.recording import Recording


def disturb(
    recording: Recording, share: float = 0.2, largest: float = 50e-6, stretch: float = 1.0, seed: int = 0
) -> Recording:
    """Add a constant field of random direction and strength up to `largest` T to a `share` of all stretches."""
    random = np.random.default_rng(seed)
    index = ((recording.time - recording.time[0]) / stretch).astype(int)
    count = int(index[-1]) + 1
    hit = random.permutation(count)[: round(share * count)]
    direction = random.standard_normal((len(hit), 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    offset = np.zeros((count, 3))
    offset[hit] = direction * random.uniform(0, largest, len(hit))[:, None]
    return replace(recording, magnetic_field=recording.magnetic_field + offset[index])
