"""A `KeyframeBuffer` across the boundaries of its blocks: every sample in one block, late ones refused."""

import numpy as np
import pytest

from magyc_gtsam.factors import KeyframeBuffer, MagycError

FIELD = np.array([20e-6, 3e-6, 45e-6])


@pytest.mark.parametrize("late", [0, 5])
@pytest.mark.parametrize("delay", [0.0, 0.02, 0.1])
def test_every_sample_after_the_first_rate_is_in_one_block(delay, late):
    """With a delay above the gyroscope's interval the first samples after each keyframe were lost.

    The last `late` magnetometer samples before a keyframe arrive after it.
    """
    rates, stamps = np.arange(0, 10, 0.01), np.arange(0.003, 10, 0.013)
    field = FIELD + 1e-9 * np.arange(len(stamps))[:, None]  # tells the samples apart
    buffer, at, seen = KeyframeBuffer(delay=delay), 0, []
    for keyframe in np.arange(1.0, 10.0):
        now = rates[(rates > keyframe - 1 + 1e-9) & (rates <= keyframe + 1e-9)] if keyframe > 1 else rates[:101]
        buffer.add_rate(now, np.zeros((len(now), 3)))
        arrived = np.searchsorted(stamps, keyframe) - late
        for i in range(at, arrived):
            buffer.add_field(float(stamps[i]), field[i])
        at = arrived
        block = buffer.close(float(keyframe))
        seen += np.round((block.field[:, 0] - FIELD[0]) / 1e-9).astype(int).tolist()
    first = np.searchsorted(stamps - delay, 0.0)
    assert seen == list(range(first, at))


def test_a_sample_from_before_the_last_block_is_refused():
    """It was taken, and left out without a word."""
    buffer, time = KeyframeBuffer(delay=0.1), np.arange(0, 5.001, 0.01)
    buffer.add_rate(time, np.zeros((len(time), 3)))
    buffer.add_field(time[10::5], np.tile(FIELD, (len(time[10::5]), 1)))
    buffer.close(5.0)
    for stamps in (4.9, np.array([4.9, 5.05])):
        with pytest.raises(MagycError, match=r"sample at 4\.900 s comes after one at 5\.000 s"):
            buffer.add_field(stamps, np.tile(FIELD, (2, 1)) if np.ndim(stamps) else FIELD)
    buffer.add_rate(5.01, np.zeros(3))
    buffer.add_field(5.05, FIELD)
    assert buffer.close(5.01).samples == 1
