"""The live display while a vehicle is turned: directions covered, the next motion, and the residual."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.live.next_move import next_move
from magyc_gtsam.live.source import NewSamples
from magyc_gtsam.observability import cells
from magyc_gtsam.online.calibrator import OnlineCalibrator
from magyc_gtsam.recording import Array, Samples

_KEPT = 4000  # samples of the whole run, evenly thinned
_DRAWN = 400  # samples that are drawn
_RECENT = 5.0  # s over which the residual is averaged
# The field counts as disturbed if the mean residual exceeds this many standard deviations and this many T; a smaller
# residual is within the ripple of a turn by hand.
_DISTURBED_SIGMAS = 4.0
_DISTURBED_FIELD = 0.5e-6


class Picture:
    """A thinned set of all samples of a run and the complete last seconds, displayed with the present calibration.

    Args:
        online: the calibrator; samples that it kept of an earlier run are shown too.
    """

    def __init__(self, online: OnlineCalibrator) -> None:
        self._online = online
        self._seen: Array = online.field[-_KEPT:]
        self._every, self._phase = 1, 0
        self._recent: deque[Samples] = deque()

    def take(self, batch: NewSamples) -> None:
        """Add new samples."""
        time, value = batch.magnetometer
        if not len(time):
            return
        self._seen = np.vstack([self._seen, value[self._phase :: self._every]])
        self._phase = (self._phase - len(value)) % self._every
        if len(self._seen) > _KEPT:
            self._seen, self._every = self._seen[::2], 2 * self._every
        self._recent.append(batch.magnetometer)
        while len(self._recent) > 1 and self._recent[0].time[-1] < time[-1] - _RECENT:
            self._recent.popleft()

    def to_dict(self, calibration: Calibration | None) -> dict[str, Any]:
        """Return the display as JSON types.

        Args:
            calibration: the present one; None if there is none yet.

        Returns:
            `points` (n × 3, directions on the unit sphere), `cells` (60, 1 where a direction was covered), `now` (the
            present direction), `next` (the motion to make), `residual`, and `rough` (no calibration yet).
        """
        if not len(self._seen):
            return {"points": [], "cells": [], "now": None, "next": None, "residual": None, "rough": True}
        direction = _directions(self._seen, calibration)
        seen = cells(direction)
        now = (
            _directions(self._recent[-1].value[-1:], calibration, self._seen)[0] if self._recent else direction[-1]
        )
        move = next_move(now, seen)
        return {
            "points": np.round(direction[:: -(-len(direction) // _DRAWN)], 3).tolist(),
            "cells": seen.astype(int).tolist(),
            "now": np.round(now, 3).tolist(),
            "next": None if move is None else move.to_dict(),
            "residual": None if calibration is None else self._residual(calibration),
            "rough": calibration is None,
        }

    def _residual(self, calibration: Calibration) -> dict[str, Any] | None:
        """Return the residual of the field strength over the last seconds, and whether it exceeds its uncertainty.

        None without recent samples or a field strength.
        """
        if not self._recent or not calibration.field_strength:
            return None
        value = np.vstack([samples.value for samples in self._recent])
        residual = np.linalg.norm(calibration.corrected(value), axis=1) - calibration.field_strength
        noise = float(calibration.noise.get("magnetic_field") or 0.0)
        variance = noise**2 / len(residual)
        if calibration.covariance is not None:
            variance += float(np.linalg.eigvalsh(calibration.covariance[6:9, 6:9])[-1])
        limit = max(_DISTURBED_SIGMAS * np.sqrt(variance), _DISTURBED_FIELD)
        return {
            "mean_ut": float(residual.mean()) * 1e6,
            "rms_ut": float(np.sqrt((residual**2).mean())) * 1e6,
            "noise_ut": noise * 1e6,
            "limit_ut": float(limit) * 1e6,
            "disturbed": bool(abs(residual.mean()) > limit),
        }


def _directions(field: Array, calibration: Calibration | None, among: Array | None = None) -> Array:
    """Return unit vectors (n, 3) of the calibrated field (n, 3).

    Without a calibration the hard iron is approximated by the middle of the range of `among` (default: `field`).
    """
    if calibration is None:
        among = field if among is None else among
        field = field - (among.min(axis=0) + among.max(axis=0)) / 2
    else:
        field = calibration.corrected(field)
    length = np.linalg.norm(field, axis=1, keepdims=True)
    unit: Array = field / np.where(length > 0, length, 1.0)
    return unit
