"""Disturbed stretches in a recording, for tests of robustness."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.recording import Recording


def disturb(
    recording: Recording, share: float = 0.2, largest: float = 50e-6, stretch: float = 1.0, seed: int = 0
) -> Recording:
    """Return the recording with a constant disturbance on a share of its stretches.

    Args:
        recording: the recording to disturb.
        share: share of the stretches that are disturbed.
        largest: largest strength of a disturbance, T; direction and strength are random.
        stretch: duration of a stretch, s.
        seed: seed of the random numbers.
    """
    random = np.random.default_rng(seed)
    index = ((recording.time - recording.time[0]) / stretch).astype(int)
    count = int(index[-1]) + 1
    disturbed = random.permutation(count)[: round(share * count)]
    direction = random.standard_normal((len(disturbed), 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    offset = np.zeros((count, 3))
    offset[disturbed] = direction * random.uniform(0, largest, len(disturbed))[:, None]
    return replace(recording, magnetic_field=recording.magnetic_field + offset[index])
