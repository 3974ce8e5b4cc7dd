"""What a person beside the vehicle is shown while it turns: directions seen, the next move, the residual."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.live.source import NewSamples
from magyc_gtsam.online.calibrator import OnlineCalibrator
from magyc_gtsam.online.coverage import cells
from magyc_gtsam.online.next_move import next_move
from magyc_gtsam.recording import Array, Samples

_KEPT = 4000  # samples of the whole run, evenly thinned
_DRAWN = 400  # of them
_RECENT = 5.0  # s of which the residual is taken
_SURE = 4.0  # deviations of the mean residual from which the field is called disturbed
_LEAST = 0.5e-6  # T, and at least this: less is below the ripple of a hand-held turn


class Picture:
    """Samples of a run, few of all and all of the last seconds, and what they show with the present calibration.

    Args:
        online: the calibrator; what it has kept of an earlier run is shown as well.
    """

    def __init__(self, online: OnlineCalibrator) -> None:
        self._online = online
        self._seen: Array = online.field[-_KEPT:]
        self._every, self._phase = 1, 0
        self._recent: deque[Samples] = deque()

    def take(self, batch: NewSamples) -> None:
        """New samples."""
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
        """JSON types: `points` (n × 3, of the unit sphere), `cells` (60, seen or not), `now`, `next`, `residual`."""
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
        """How far the last seconds are off the sphere, and whether that is more than noise and calibration explain."""
        if not self._recent or not calibration.field_strength:
            return None
        value = np.vstack([samples.value for samples in self._recent])
        off = np.linalg.norm(calibration.apply(value), axis=1) - calibration.field_strength
        noise = float(calibration.noise.get("magnetic_field") or 0.0)
        own = (
            0.0
            if calibration.covariance is None
            else float(np.linalg.eigvalsh(calibration.covariance[6:9, 6:9])[-1])
        )
        limit = max(_SURE * np.sqrt(noise**2 / len(off) + own), _LEAST)
        return {
            "mean_ut": float(off.mean()) * 1e6,
            "rms_ut": float(np.sqrt((off**2).mean())) * 1e6,
            "noise_ut": noise * 1e6,
            "limit_ut": float(limit) * 1e6,
            "disturbed": bool(abs(off.mean()) > limit),
        }


def _directions(field: Array, calibration: Calibration | None, among: Array | None = None) -> Array:
    """Unit vectors; before there is a calibration, about the middle of what was seen."""
    if calibration is None:
        among = field if among is None else among
        field = field - (among.min(axis=0) + among.max(axis=0)) / 2
    else:
        field = calibration.apply(field)
    length = np.linalg.norm(field, axis=1, keepdims=True)
    unit: Array = field / np.where(length > 0, length, 1.0)
    return unit
