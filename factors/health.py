"""Health of the blocks in a graph: the verdict that follows from the fits of successive blocks (`block_fit.py`)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum
from math import isfinite
from statistics import median

import numpy as np
from scipy.special import chdtrc

from magyc_gtsam.factors.block_fit import BlockFit

CHECK_AXES = (
    "check the axes of the world field (north-east-down or east-north-up), of the poses and of the mounting"
)
_SCATTERED = 10  # number of latest blocks whose median scatter is judged


@dataclass(frozen=True)
class HealthLimits:
    """Limits of the verdict on a graph's blocks.

    Attributes:
        window: number of blocks whose NIS are judged together.
        long: number of blocks over which a small but lasting excess is judged.
        tolerance: factors, over `window` and over `long`, by which the NIS may exceed its expectation, to allow for a
            model that is only nearly right.
        suspect: probability below which a window is suspect. At one block every 2.5 s a window is suspect by chance
            once in 3 · 10⁵ hours at 1e-9.
        held: probability below which a variable that a prior holds counts as moved from it.
        hold: s, duration from which an offset is a step of the hard iron; a shorter one is a disturbance.
        returned: share of its size below which an offset counts as over.
        least: T, smallest offset that is reported.
        scatter: factor by which the samples may scatter more than their stated noise.
        memory: s for which a disturbance is still reported after its end.
    """

    window: int = 3
    long: int = 200
    tolerance: tuple[float, float] = (1.3, 1.15)
    suspect: float = 1e-9
    held: float = 1e-5
    hold: float = 25.0
    returned: float = 0.4
    least: float = 0.5e-6
    scatter: float = 1.4
    memory: float = 300.0


class HealthStatus(str, Enum):
    """The degree to which a graph with magnetometer blocks can be trusted."""

    WAITING = "waiting"  # no block has entered, or none could be judged yet
    CONSISTENT = "consistent"
    SUSPECT = "suspect"
    INCONSISTENT = "inconsistent"

    def __str__(self) -> str:
        return str(self.value)


@dataclass(frozen=True)
class Health:
    """The verdict on the magnetometer in the graph.

    Attributes:
        status: `consistent`, `suspect`, `inconsistent`, or `waiting` while no block has entered or been judged.
        by: the contradiction, with its size, or what is waited for; empty where there is none.
        since: s, time of the first block that contradicts or is not judged; NaN where there is none.
        nis: NIS of the last blocks per degree of freedom.
    """

    status: HealthStatus
    by: str = ""
    since: float = float("nan")
    nis: float = float("nan")

    def __str__(self) -> str:
        since = f" since {self.since:.1f} s" if isfinite(self.since) else ""
        return f"{self.status}: {self.by}{since}" if self.by else str(self.status)


UNJUDGED = Health(HealthStatus.WAITING, "no block is judged (health=None)")


class _Sums:
    """NIS and degrees of freedom summed over the last blocks."""

    def __init__(self, span: int) -> None:
        self._last: deque[BlockFit] = deque(maxlen=span)
        self.nis = 0.0
        self.freedom = 0

    def add(self, fit: BlockFit) -> None:
        """Add a block and remove the oldest one once `span` is reached."""
        if len(self._last) == self._last.maxlen:
            self.nis -= self._last[0].nis
            self.freedom -= self._last[0].freedom
        self._last.append(fit)
        self.nis += fit.nis
        self.freedom += fit.freedom

    def without(self, first: float, stop: float) -> _Sums:
        """Return the sums without the blocks from `first` to before `stop`, in s."""
        assert self._last.maxlen is not None
        result = _Sums(self._last.maxlen)
        for fit in self._last:
            if not first <= fit.time < stop:
                result.add(fit)
        return result

    def __len__(self) -> int:
        return len(self._last)

    @property
    def since(self) -> float:
        """Time of the oldest block, in s."""
        return self._last[0].time

    def unlikely(self, tolerance: float, probability: float) -> bool:
        """Whether a NIS this large is less probable than `probability` if its expectation is `tolerance` times as
        large.
        """
        return self.freedom > 0 and bool(chdtrc(self.freedom, self.nis / tolerance) < probability)


class Monitor:
    """Derives the health of a graph from the fits of successive blocks.

    Attributes:
        fits: fits of the last blocks.
        over: (first, last) in s of disturbances that have ended, and of steps after which new variables of the
            calibration have begun, whose blocks are still in the graph.
        unjudged: what to report while blocks that have entered are not judged, and the time in s of the first of them.
    """

    def __init__(self, limits: HealthLimits) -> None:
        self.limits = limits
        self.fits: deque[BlockFit] = deque(maxlen=1000)
        self._sums: tuple[_Sums, ...] = _Sums(limits.window), _Sums(limits.long)
        self._reference: BlockFit | None = None  # the last block before an offset began
        self._began: float | None = None
        self._size = np.zeros(3)
        self._named = ""
        self._since = float("nan")
        self._ended = -np.inf
        self.over: list[tuple[float, float]] = []
        self.unjudged: tuple[str, float] | None = None
        self._held: dict[str, tuple[str, float]] = {}

    @property
    def open(self) -> bool:
        """Whether an offset has begun that is neither over nor identified."""
        return self._began is not None

    def add(self, fit: BlockFit) -> None:
        """Add a block's fit."""
        limits = self.limits
        before = self.fits[-1] if self.fits else fit
        self.fits.append(fit)
        for sums in self._sums:
            sums.add(fit)
        alone = _Sums(1)
        alone.add(fit)
        unlikely = alone.unlikely(limits.tolerance[0], limits.suspect)
        if self._began is None:
            unlikely |= self._sums[0].unlikely(limits.tolerance[0], limits.suspect)
            if unlikely and float(np.linalg.norm(fit.offset)) > max(limits.least, 4 * fit.offset_sigma):
                self._began = fit.time
                self._reference = before
                self._size = fit.offset_from(before)
                self._named, self._since = "", fit.time
            return
        if fit.calibration != before.calibration and not unlikely:  # otherwise a walk ties it to the one before
            self._named = ""
            self._end(self._began, fit.time)
            return
        assert self._reference is not None
        offset = fit.offset_from(self._reference)
        size = float(np.linalg.norm(self._size))
        if float(offset @ self._size) / size**2 < limits.returned:
            self._named = f"disturbance of {size * 1e6:.1f} µT for {fit.time - self._began:.0f} s"
            self._end(self._began, fit.time)
            return
        lasted = fit.time - self._began
        self._size = self._size + 0.3 * (offset - self._size)
        if lasted >= limits.hold:
            self._named = f"step of the hard iron of {np.linalg.norm(self._size) * 1e6:.1f} µT"

    def _end(self, began: float, time: float) -> None:
        """End the present offset, whose blocks then leave the graph and no longer count."""
        self.over.append((began, time))
        self._ended, self._began = time, None
        self._sums = tuple(sums.without(began, time) for sums in self._sums)

    def hold(self, name: str, moved: bool, text: str, time: float) -> None:
        """Record whether a quantity contradicts what is held of it, by a prior, by the blocks or by physics, and how to
        report it.
        """
        if moved:
            self._held.setdefault(name, (text, time))
            self._held[name] = (text, self._held[name][1])
        else:
            self._held.pop(name, None)

    @property
    def health(self) -> Health:
        """The health at present."""
        limits, window = self.limits, self._sums[0]
        nis = window.nis / max(window.freedom, 1) if self.fits else float("nan")
        if self._held:
            text, since = next(iter(self._held.values()))
            return Health(HealthStatus.INCONSISTENT, text, since, nis)
        if not self.fits:
            return Health(HealthStatus.WAITING, *(self.unjudged or ()))
        last = self.fits[-1].time
        if self._began is not None:
            if self._named:
                return Health(HealthStatus.INCONSISTENT, self._named, self._since, nis)
            size = float(np.linalg.norm(self._size)) * 1e6
            return Health(HealthStatus.SUSPECT, f"disturbance or step of {size:.1f} µT", self._since, nis)
        if self._named and last - self._ended < limits.memory:
            return Health(HealthStatus.INCONSISTENT, self._named, self._since, nis)
        scatter = median(self.fits[-1 - i].scatter for i in range(min(len(self.fits), _SCATTERED)))
        if len(window) == limits.window and scatter > limits.scatter:
            return Health(HealthStatus.INCONSISTENT, f"noise {scatter:.1f} times as stated", window.since, nis)
        for sums, tolerance in zip(self._sums, limits.tolerance, strict=True):
            if sums.unlikely(tolerance, limits.suspect):
                mean = sums.nis / sums.freedom
                text = f"attitude, mounting or delay: NIS {mean:.1f} per degree of freedom over {len(sums)} blocks"
                return Health(HealthStatus.SUSPECT, text, sums.since, mean)
        return Health(HealthStatus.CONSISTENT, nis=nis)
