"""The identity of a recording by its samples, so that no estimate counts the same samples twice.

A fingerprint holds the smallest hashes of all runs of sixteen magnetometer samples. Those of two recordings that share
samples share hashes, in the share of the samples that both have of all that either has (Broder 1997), under any name,
with any clock, for any interval of a log, and in any precision: hashed are the cells in which the samples lie, one
after the other. A run that returns to the same few cells is that of an instrument at rest; it may recur in another log,
and is left out.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.recording.checks import Array
from magyc_gtsam.recording.recording import Recording

Hashes = NDArray[np.uint64]

_KEPT = 64  # hashes; of two recordings that share a tenth of their samples, one in fifty shares less than `_LEAST`
_LEAST = 2  # shared hashes; one may be chance
_BYTES = 6  # of each hash
_RUN = 16  # cells; shorter runs of coarse readings at rest recur in other logs
_BACK = 7  # cells; a sample that returns to one of so many before it says little
_MOST_BACK = 8  # of the cells of a run
# T, the cells' width. Of a copy rounded to 1 nT 89 % of the runs keep their cells, to 10 nT 31 %; a sensor's noise of
# 0.05 to 1 µT makes the runs of other logs differ. No multiple of the steps in which sensors count (0.1, 0.15, 0.3 µT),
# which would put their readings on the edges of cells.
_CELL = np.pi / 3 * 1e-7
_BLOCK = 100_000  # samples at a time, for memory
_FACTORS = np.random.PCG64(0).random_raw(3) | np.uint64(1)


def fingerprint(recording: Recording) -> str:
    """Return the fingerprint of the magnetometer's samples, as text."""
    values, running = recording.magnetometer.value, RunningFingerprint()
    for first in range(0, len(values), _BLOCK):
        running.take(values[first : first + _BLOCK])
    return running.text


class RunningFingerprint:
    """The fingerprint of a recording that grows, in constant time and memory."""

    def __init__(self) -> None:
        self._last = np.empty((0, 3))  # samples whose runs continue
        self._hashes = np.empty(0, np.uint64)

    def take(self, values: Array) -> None:
        """Add the next samples (n, 3) of the magnetometer, without repeats."""
        rows = np.vstack([self._last, values]) if len(self._last) else values
        cells = _cells(rows)
        moved = np.flatnonzero(_moved(cells))
        smallest = _smallest(cells[moved])
        self._hashes = np.union1d(self._hashes, smallest)[:_KEPT] if len(self._hashes) else smallest
        self._last = rows[moved[-(_RUN + _BACK - 1) :]]

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
    for other in others:
        mine, theirs = hashes_of(own), hashes_of(other)
        smallest = np.union1d(mine, theirs)[:_KEPT]
        shared = np.isin(smallest, mine) & np.isin(smallest, theirs)
        if shared.sum() >= min(_LEAST, len(smallest)) > 0:
            return other
    return None


def _cells(values: Array) -> Hashes:
    """Return the cells (n,) of samples (n, 3), each as one number."""
    if compiled.loops:
        cells = np.empty(len(values), np.uint64)
        compiled.loops.hash_cells(len(values), compiled.given(values), np.array([_CELL]), _FACTORS, cells)
        return cells
    return _mixed(np.rint(values.T / _CELL, order="C").astype(np.int64).view(np.uint64))


def _moved(cells: Hashes) -> NDArray[np.bool_]:
    """Return (n,) which samples are not in the cell of the one before."""
    return np.append(True, cells[1:] != cells[:-1])[: len(cells)]


def _smallest(cells: Hashes) -> Hashes:
    """Return the smallest hashes of the runs of cells (n,), each unlike the one before, ascending."""
    if len(cells) < _RUN + _BACK:  # a run comes after the cells to which it may return
        return np.empty(0, np.uint64)
    if compiled.loops:
        runs, rules = np.empty(_KEPT, np.uint64), np.array([_RUN, _BACK, _MOST_BACK, 8 * _BYTES], dtype=float)
        return runs[: int(compiled.loops.hash_runs(len(cells), compiled.given(cells), _FACTORS, rules, runs))]
    kept, some = _kept_runs(cells), 2 * _KEPT  # more than are kept, since some may be equal
    return np.unique(kept if len(kept) <= some else np.partition(kept, some)[:some])[:_KEPT]


def _kept_runs(cells: Hashes) -> Hashes:
    """Return the hashes of the runs of cells that do not return to the same ones."""
    runs = _hashed_runs(cells[_BACK:]) >> np.uint64(64 - 8 * _BYTES)
    back = np.zeros(len(cells) - _BACK, dtype=bool)
    for k in range(2, _BACK + 1):
        back |= cells[_BACK:] == cells[_BACK - k : -k]
    returns = np.cumsum(np.append(0, back))
    kept: Hashes = runs[returns[_RUN:] - returns[:-_RUN] <= _MOST_BACK]
    return kept


def _hashed_runs(cells: Hashes) -> Hashes:
    """Return a hash of each run of `_RUN` cells: a polynomial modulo 2⁶⁴ (Karp and Rabin 1987), by doubling."""
    factor, reach = _FACTORS[:1], 1
    while reach < _RUN:
        cells = cells[:-reach] + factor * cells[reach:]
        factor, reach = factor * factor, 2 * reach
    return _mixed([cells])


def _text(hashes: Hashes) -> str:
    return base64.b64encode(hashes.astype(">u8").view(np.uint8).reshape(-1, 8)[:, -_BYTES:].tobytes()).decode()


def _mixed(parts: Iterable[Hashes]) -> Hashes:
    """Return one hash (n,) of several arrays (n,)."""
    total = np.uint64(0)
    for factor, part in zip(_FACTORS, parts, strict=False):
        mixed = (part ^ (part >> np.uint64(32))) * factor
        total = (total ^ (total >> np.uint64(29))) * factor + (mixed ^ (mixed >> np.uint64(31)))
    return np.asarray(total ^ (total >> np.uint64(32)))


def hashes_of(text: str) -> Hashes:
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
