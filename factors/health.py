"""Health of the blocks in a graph: a normalised innovation squared (NIS) per block, and the verdict derived from it.

With the whitened residual r and Jacobian J of a block at the estimate that includes it, and the joint covariance P of
its keys, the innovation against all other factors satisfies S⁻¹ν = r with S⁻¹ = I − J P Jᵀ; the NIS is νᵀS⁻¹ν. Its
part in the range of J is what the graph can contradict (a disturbance, a step, a wrong mounting); the rest is the
scatter inside the block. The offset of the hard iron that explains a block best, against all other factors, follows
from the same quantities.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum
from statistics import median

import numpy as np
from scipy.special import chdtrc

from magyc_gtsam.factors.variables import Array

_SCATTERED = 10  # number of latest blocks whose median scatter is judged
_SEEN = 0.02  # share of a direction's variance that is not the block's own; below it the graph cannot contradict


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


@dataclass(frozen=True, eq=False)
class BlockFit:
    """The fit of one block to the rest of the graph.

    Attributes:
        time: s, mean stamp of its samples.
        nis: normalised innovation squared in the range of the block's Jacobian.
        freedom: degrees of freedom of `nis`.
        scatter: root mean square of the remaining whitened residual, 1 where the noise is as stated.
        offset: (3,) T, change of the hard iron that would explain this block.
        offset_sigma: T, root of the trace of the covariance of `offset`.
        soft_iron, hard_iron: (3, 3), (3,) T, calibration at which the block was judged.
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
        """Return the mean deviation (3,) in T of the block's readings from another block's calibration."""
        result: Array = self.field - reference.soft_iron @ self.seen - reference.hard_iron
        return result


@dataclass(frozen=True)
class Health:
    """The verdict on the magnetometer in the graph.

    Attributes:
        status: `consistent`, `suspect`, `inconsistent`, or `waiting` while no block has entered or been judged.
        by: the contradiction, with its size; empty where there is none.
        since: s, time of the first block that contradicts; NaN where there is none.
        nis: NIS of the last blocks per degree of freedom.
    """

    status: HealthStatus
    by: str = ""
    since: float = float("nan")
    nis: float = float("nan")

    def __str__(self) -> str:
        return f"{self.status}: {self.by} since {self.since:.1f} s" if self.by else str(self.status)


def block_fit(
    information: Array, gradient: Array, square: float, covariance: Array, rows: int, hard_iron: slice
) -> tuple[float, int, float, Array, Array]:
    """Return the NIS of one block, its degrees of freedom, the scatter, the offset (3,) and the offset's covariance.

    Args:
        information: (p, p) JᵀJ at the estimate.
        gradient: (p,) −Jᵀr at the estimate.
        square: rᵀr at the estimate.
        covariance: (p, p) P.
        rows: number of rows of r before any compression.
        hard_iron: the columns of the hard iron h.
    """
    used = np.flatnonzero(
        np.diag(information)
    )  # without columns that no block depends on: a pose's translation, the accelerometer's bias
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
    bend, sides = np.linalg.eigh(curvature)  # eigenvalues for the pseudo-inverse
    spread = (sides * np.divide(1.0, bend, out=np.zeros(3), where=bend > 1e-6 * bend[-1])) @ sides.T
    return nis, int(clear.sum()), float(scatter), spread @ gradient[hard_iron], spread


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
        over: (first, last) in s of disturbances that have ended and whose blocks are still in the graph.
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
        """Whether an offset has begun that is neither over nor identified."""
        return self._began is not None

    def add(self, fit: BlockFit) -> None:
        """Add a block's fit."""
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
            return Health(HealthStatus.WAITING)
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
