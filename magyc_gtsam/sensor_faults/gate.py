"""A gate between sensor and estimator that holds samples back while a detector is undecided about them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from magyc_gtsam.recording import Array, Samples
from magyc_gtsam.recording.growing_rows import GrowingRows


class Detector(Protocol):
    """A detector that finds one fault of a sensor in its samples as they arrive.

    Which samples it finds faulty must not depend on how the stream is cut into blocks.

    Attributes:
        pending: stamp of the first undecided sample, s; inf if all are decided.
    """

    pending: float

    def observe(self, block: Samples) -> None:
        """Take the next samples, if there are any."""

    def rejects(self, time: Array) -> np.ndarray:
        """Return (n,) bool: the decided samples at `time` (n,) that were found faulty while they could be held back."""

    def state(self) -> Mapping[str, Array]:
        """Return the state for `restore`."""

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""


class SampleGate:
    """Pass on the samples that a detector does not reject.

    Attributes:
        detector: the detector that decides.
        taken, dropped: number of samples.
    """

    def __init__(self, detector: Detector) -> None:
        self.detector = detector
        self._held = GrowingRows(4)
        self.taken = self.dropped = 0

    def take(self, block: Samples) -> Samples:
        """Return the usable samples of this block and of those held back before."""
        if not len(block.time) and not len(self._held):
            return block
        self.detector.observe(block)
        self.taken += len(block.time)
        if not len(self._held) and self.detector.pending == np.inf and not self.detector.rejects(block.time).any():
            return block
        self._held.append(np.column_stack(block))
        decided = self._held.rows[: np.searchsorted(self._held.rows[:, 0], self.detector.pending)]
        rejected = self.detector.rejects(decided[:, 0])
        self._held.cut(len(decided))
        self.dropped += int(rejected.sum())
        passed = decided[~rejected]  # a copy
        return Samples(passed[:, 0], passed[:, 1:])

    def state(self) -> Mapping[str, Array]:
        """Return the state for `restore`."""
        state = {"held": self._held.rows.copy(), "counts": np.array([self.taken, self.dropped])}
        return state | {f"detector/{name}": value for name, value in self.detector.state().items()}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        self._held.append(state["held"])
        self.taken, self.dropped = (int(v) for v in state["counts"])
        prefix = "detector/"
        self.detector.restore({k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)})
