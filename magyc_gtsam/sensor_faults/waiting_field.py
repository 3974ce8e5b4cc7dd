"""The magnetometer's samples that wait until it is known whether the gyroscope is stuck."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.recording import Array, Samples
from magyc_gtsam.recording.growing_rows import GrowingRows
from magyc_gtsam.sensor_faults.stuck import field_turned

_WAITING = 60.0  # s, longest wait for the samples of the other sensor


class WaitingField:
    """The magnetometer's samples since the gyroscope's first undecided one, and the stamp up to which it has come.

    It refers to no detector, so that both are freed with their last user, and not at the next garbage collection.

    Args:
        whole: whether the samples come as one block.
    """

    def __init__(self, whole: bool) -> None:
        self._whole = whole
        self._field = GrowingRows(4)
        self._latest = -np.inf  # s, stamp of the last gyroscope sample

    def append(self, magnetometer: Samples, gyroscope: Samples) -> None:
        """Take new samples of both sensors."""
        if len(gyroscope.time):
            self._latest = float(gyroscope.time[-1])
        if len(magnetometer.time):
            self._field.append(np.column_stack(magnetometer))

    def cut(self, pending: float) -> None:
        """Drop the samples before the gyroscope's first undecided stamp, `pending` s, or its last."""
        if len(self._field):
            time = self._field.rows[:, 0]
            since = min(pending, self._latest)
            self._field.cut(int(np.searchsorted(time, max(since, time[-1] - 2 * _WAITING))))

    def turned(self, rows: Array) -> bool | None:
        """Return whether the field turned during the gyroscope's stuck rows (n, 4); None while that is not known."""
        field, last = self._field.rows, rows[-1, 0]
        if not self._whole and (not len(field) or field[-1, 0] < last):
            return None if self._latest - last < _WAITING else False
        between = slice(*np.searchsorted(field[:, 0], [rows[0, 0], last]))
        return field_turned(field[between, 1:], rows[0, 1:])

    def state(self) -> dict[str, Array]:
        """Return the state for `restore`."""
        return {"field": self._field.rows.copy(), "latest": np.array(self._latest)}

    def restore(self, state: dict[str, Array]) -> None:
        """Continue from `state`."""
        self._field.append(state["field"])
        self._latest = float(state["latest"])
