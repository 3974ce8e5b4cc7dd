"""The identity of a recording by its samples, so that no estimate counts the same samples twice.

A fingerprint holds the smallest hashes of all runs of eight magnetometer samples. Those of two recordings that share
samples share hashes, in the share of the samples that both have of all that either has (Broder 1997), under any name,
with any clock and for any interval of a log.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.recording.checks import Array
from magyc_gtsam.recording.recording import Recording

Hashes = NDArray[np.uint64]

_KEPT = 64  # hashes; of two recordings that share a tenth of their samples, one in fifty shares less than `_LEAST`
_LEAST = 2  # shared hashes; one may be chance
_BYTES = 6  # of each hash
_RUN = 8  # samples; shorter runs of coarse readings at rest recur in other logs
_FACTORS = np.random.PCG64(0).random_raw(_RUN) | np.uint64(1)


def fingerprint(recording: Recording) -> str:
    """Return the fingerprint of the magnetometer's samples, as text."""
    return _text(_smallest(recording.magnetometer.value))


class RunningFingerprint:
    """The fingerprint of a recording that grows, in constant time and memory."""

    def __init__(self) -> None:
        self._last = np.empty((0, 3))  # samples whose runs continue
        self._hashes = np.empty(0, np.uint64)

    def take(self, values: Array) -> None:
        """Add the next samples (n, 3) of the magnetometer, without repeats."""
        rows = np.vstack([self._last, values])
        if len(rows) >= _RUN:
            self._hashes = np.union1d(self._hashes, _smallest(rows))[:_KEPT]
        self._last = rows[-(_RUN - 1) :]

    @property
    def text(self) -> str:
        """The fingerprint so far; "" before the first run of samples."""
        return _text(self._hashes)

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the state as named arrays, for `restore`."""
        return {"last": self._last, "hashes": self._hashes}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Restore a state that `state` returned."""
        self._last, self._hashes = state["last"], state["hashes"]


def first_shared(own: str, others: Iterable[str]) -> str | None:
    """Return the first of other fingerprints that shares a tenth of its samples or more with `own`; None if none does.

    A fingerprint of an earlier version, which cannot be compared, shares none.
    """
    mine = _hashes(own)
    for other in others:
        theirs = _hashes(other)
        smallest = np.union1d(mine, theirs)[:_KEPT]
        shared = np.isin(smallest, mine) & np.isin(smallest, theirs)
        if shared.sum() >= min(_LEAST, len(smallest)) > 0:
            return other
    return None


def _smallest(values: Array) -> Hashes:
    """Return the smallest hashes of the runs of samples (n, 3), ascending."""
    if not len(values):
        return np.empty(0, np.uint64)
    rows = _mixed(np.ascontiguousarray(values).view(np.uint64).T)
    count = max(len(rows) - _RUN + 1, 1)
    runs = _mixed([rows[k : k + count] for k in range(min(len(rows), _RUN))]) >> np.uint64(64 - 8 * _BYTES)
    few = 2 * _KEPT  # more than are kept, since some may be equal
    return np.unique(runs if len(runs) <= few else np.partition(runs, few)[:few])[:_KEPT]


def _text(hashes: Hashes) -> str:
    return base64.b64encode(hashes.astype(">u8").view(np.uint8).reshape(-1, 8)[:, -_BYTES:].tobytes()).decode()


def _mixed(parts: Iterable[Hashes]) -> Hashes:
    """Return one hash (n,) of several arrays (n,)."""
    total = np.uint64(0)
    for factor, part in zip(_FACTORS, parts, strict=False):
        mixed = (part ^ (part >> np.uint64(32))) * factor
        total = (total ^ (total >> np.uint64(29))) * factor + (mixed ^ (mixed >> np.uint64(31)))
    return np.asarray(total ^ (total >> np.uint64(32)))


def _hashes(text: str) -> Hashes:
    """Return the hashes of a fingerprint, ascending; none for a text that is none."""
    try:
        data = np.frombuffer(base64.b64decode(text, validate=True), np.uint8)
    except (binascii.Error, ValueError):
        return np.empty(0, np.uint64)
    if len(data) % _BYTES or len(data) < 2 * _BYTES:
        return np.empty(0, np.uint64)
    whole = np.zeros((len(data) // _BYTES, 8), np.uint8)
    whole[:, -_BYTES:] = data.reshape(-1, _BYTES)
    return whole.view(">u8").ravel().astype(np.uint64)
