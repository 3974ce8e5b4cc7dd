"""Whether the blocks in a graph agree with the rest of it: a normalised innovation squared (NIS) per block, and a word.

With the whitened residual r and Jacobian J of a block at the estimate that holds it, and the joint covariance P of its
keys, the innovation against everything else is S⁻¹ν = r, S⁻¹ = I − J P Jᵀ; the NIS is νᵀS⁻¹ν. Its part in the range
of J is what the graph can see (a disturbance, a step, a wrong mounting), the rest the scatter inside the block.
The offset of the hard iron that explains a block best, against everything else, follows from the same numbers.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum
from statistics import median

import numpy as np
from scipy.special import chdtrc

from magyc_gtsam.factors.variables import Array

_SCATTERED = 10  # blocks whose median scatter is judged
_SEEN = 0.02  # of a direction's variance that is not the block's own doing; below it the graph cannot contradict


@dataclass(frozen=True)
class HealthLimits:
    """When a block counts as contradicted.

    Attributes:
        window: blocks whose NIS are judged together.
        long: blocks over which a small but lasting excess is judged.
        tolerance: factor by which NIS may exceed its expectation before it counts, for a model that is nearly right:
            over `window` and over `long`.
        suspect: probability below which a window is suspect. At a block every 2.5 s a window is suspect by chance
            once in 3 · 10⁵ hours at 1e-9.
        held: probability below which a variable that a prior holds has moved from it.
        hold: s that an offset must last to be a step of the hard iron; a shorter one is a disturbance.
        returned: share of its size below which an offset has gone.
        least: T, smallest offset that is named.
        scatter: factor by which the samples may scatter more than their stated noise.
        memory: s for which a disturbance that is over is still reported.
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


class Word(str, Enum):
    """How far a graph with magnetometer blocks can be trusted."""

    WAITING = "waiting"  # no block has entered: the heading is not settled
    CONSISTENT = "consistent"
    SUSPECT = "suspect"
    INCONSISTENT = "inconsistent"

    def __str__(self) -> str:
        return str(self.value)


@dataclass(frozen=True, eq=False)
class BlockFit:
    """How one block fits the rest of the graph.

    Attributes:
        time: s, mean stamp of its samples.
        nis: in the range of its Jacobian.
        freedom: degrees of freedom of `nis`.
        scatter: root mean square of the rest, 1 where the noise is as stated.
        offset: (3,) T by which the hard iron would have to differ for this block.
        offset_sigma: T, root of the trace of its covariance.
        soft_iron, hard_iron: (3, 3), (3,) T, at which it was judged.
        seen, field: (3,) T, means over its samples of the world's field in the sensor's frame, and of the readings.
    """

    time: float
    nis: float
    freedom: int
    scatter: float
    offset: Array
    offset_sigma: float
    soft_iron: Array
    hard_iron: Array
    seen: Array
    field: Array

    def offset_from(self, reference: BlockFit) -> Array:
        """(3,) T by which its readings differ, on the mean, from those of another block's calibration."""
        result: Array = self.field - reference.soft_iron @ self.seen - reference.hard_iron
        return result


@dataclass(frozen=True)
class Health:
    """What to make of the magnetometer in the graph.

    Attributes:
        word: `consistent`, `suspect`, `inconsistent`, or `waiting` while no block has entered.
        by: what contradicts, with its size; empty where nothing does.
        since: s, time of the first block that did; NaN where none.
        nis: of the last blocks, per degree of freedom.
    """

    word: Word
    by: str = ""
    since: float = float("nan")
    nis: float = float("nan")

    def __str__(self) -> str:
        return f"{self.word}: {self.by} since {self.since:.1f} s" if self.by else str(self.word)


def block_fit(
    information: Array, gradient: Array, square: float, covariance: Array, rows: int, hard_iron: slice
) -> tuple[float, int, float, Array, Array]:
    """NIS, its degrees of freedom, scatter, offset (3,) and its covariance of one block.

    Args:
        information: (p, p) JᵀJ; gradient: (p,) −Jᵀr; square: rᵀr, at the estimate.
        covariance: (p, p) P.
        rows: of r, before any compression.
        hard_iron: the columns of h.
    """
    used = np.flatnonzero(
        np.diag(information)
    )  # no block acts on a pose's translation or the accelerometer's bias
    weight, direction = np.linalg.eigh(information[used][:, used])
    kept = weight > 1e-9 * weight[-1]
    root = direction[:, kept] * np.sqrt(weight[kept])
    along = gradient[used] @ root / weight[kept]
    scatter = np.sqrt(max(square - float(along @ along), 0.0) / max(rows - len(along), 1))
    share = np.eye(len(along)) - root.T @ covariance[used][:, used] @ root
    seen, axes = np.linalg.eigh(0.5 * (share + share.T))
    clear = seen > _SEEN
    projected = axes.T[clear] @ along
    nis = float(np.sum(projected**2 / seen[clear]))
    on_offset = information[:, hard_iron]
    curvature = information[hard_iron, hard_iron] - on_offset.T @ covariance @ on_offset
    bend, sides = np.linalg.eigh(curvature)  # its pseudo-inverse
    spread = (sides * np.divide(1.0, bend, out=np.zeros(3), where=bend > 1e-6 * bend[-1])) @ sides.T
    return nis, int(clear.sum()), float(scatter), spread @ gradient[hard_iron], spread


class _Sums:
    """NIS and degrees of freedom summed over the last blocks."""

    def __init__(self, span: int) -> None:
        self._last: deque[BlockFit] = deque(maxlen=span)
        self.nis = 0.0
        self.freedom = 0

    def add(self, fit: BlockFit) -> None:
        """One more block, and the oldest one out."""
        if len(self._last) == self._last.maxlen:
            self.nis -= self._last[0].nis
            self.freedom -= self._last[0].freedom
        self._last.append(fit)
        self.nis += fit.nis
        self.freedom += fit.freedom

    def __len__(self) -> int:
        return len(self._last)

    @property
    def since(self) -> float:
        """s, time of the oldest block."""
        return self._last[0].time

    def unlikely(self, tolerance: float, probability: float) -> bool:
        """Whether NIS is too large, less probable than `probability` where it is `tolerance` times as expected."""
        return self.freedom > 0 and bool(chdtrc(self.freedom, self.nis / tolerance) < probability)


class Monitor:
    """Turns the fits of successive blocks into a word.

    Attributes:
        fits: of the last blocks.
        over: [(first, last) s) of disturbances that are over and whose blocks nobody has taken out yet.
    """

    def __init__(self, limits: HealthLimits) -> None:
        self.limits = limits
        self.fits: deque[BlockFit] = deque(maxlen=1000)
        self._sums = _Sums(limits.window), _Sums(limits.long)
        self._reference: BlockFit | None = None  # the last block before an offset began
        self._began: float | None = None
        self._size = np.zeros(3)
        self._named = ""
        self._since = float("nan")
        self._ended = -np.inf
        self.over: list[tuple[float, float]] = []
        self._held: dict[str, tuple[str, float]] = {}

    @property
    def open(self) -> bool:
        """Whether an offset has begun that is neither over nor named."""
        return self._began is not None

    def add(self, fit: BlockFit) -> None:
        """One more block."""
        limits = self.limits
        before = self.fits[-1] if self.fits else fit
        self.fits.append(fit)
        for sums in self._sums:
            sums.add(fit)
        if self._began is None:
            alone = _Sums(1)
            alone.add(fit)
            unlikely = any(sums.unlikely(limits.tolerance[0], limits.suspect) for sums in (self._sums[0], alone))
            if unlikely and float(np.linalg.norm(fit.offset)) > max(limits.least, 4 * fit.offset_sigma):
                self._began = fit.time
                self._reference = before
                self._size = fit.offset_from(before)
                self._named, self._since = "", fit.time
            return
        assert self._reference is not None
        offset = fit.offset_from(self._reference)
        size = float(np.linalg.norm(self._size))
        if float(offset @ self._size) / size**2 < limits.returned:
            self._named = f"disturbance of {size * 1e6:.1f} µT for {fit.time - self._began:.0f} s"
            self.over.append((self._began, fit.time))
            self._ended, self._began = fit.time, None
            return
        lasted = fit.time - self._began
        self._size = self._size + 0.3 * (offset - self._size)
        if lasted >= limits.hold:
            self._named = f"step of the hard iron of {np.linalg.norm(self._size) * 1e6:.1f} µT"

    def hold(self, name: str, moved: bool, text: str, time: float) -> None:
        """Whether something that a prior or the blocks hold is not where it is held, and the words for it."""
        if moved:
            self._held.setdefault(name, (text, time))
            self._held[name] = (text, self._held[name][1])
        else:
            self._held.pop(name, None)

    @property
    def health(self) -> Health:
        """The word at present."""
        if not self.fits:
            return Health(Word.WAITING)
        limits, window = self.limits, self._sums[0]
        nis, last = window.nis / max(window.freedom, 1), self.fits[-1].time
        if self._held:
            text, since = next(iter(self._held.values()))
            return Health(Word.INCONSISTENT, text, since, nis)
        if self._began is not None:
            if self._named:
                return Health(Word.INCONSISTENT, self._named, self._since, nis)
            size = float(np.linalg.norm(self._size)) * 1e6
            return Health(Word.SUSPECT, f"disturbance or step of {size:.1f} µT", self._since, nis)
        if self._named and last - self._ended < limits.memory:
            return Health(Word.INCONSISTENT, self._named, self._since, nis)
        scatter = median(self.fits[-1 - i].scatter for i in range(min(len(self.fits), _SCATTERED)))
        if len(window) == limits.window and scatter > limits.scatter:
            return Health(Word.INCONSISTENT, f"noise {scatter:.1f} times as stated", window.since, nis)
        for sums, tolerance in zip(self._sums, limits.tolerance, strict=True):
            if sums.unlikely(tolerance, limits.suspect):
                mean = sums.nis / sums.freedom
                text = f"attitude, mounting or delay: NIS {mean:.1f} per degree of freedom over {len(sums)} blocks"
                return Health(Word.SUSPECT, text, sums.since, mean)
        return Health(Word.CONSISTENT, nis=nis)
