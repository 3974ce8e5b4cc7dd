"""The fit of one block to the rest of its graph, by its normalised innovation squared (NIS).

With the whitened residual r and Jacobian J of a block at the estimate that includes it, and the joint covariance P of
its keys, the innovation against all other factors satisfies S⁻¹ν = r with S⁻¹ = I − J P Jᵀ; the NIS is νᵀS⁻¹ν. Its
part in the range of J is what the graph can contradict (a disturbance, a step, a wrong mounting); the rest is the
scatter inside the block. The offset of the hard iron that explains a block best, against all other factors, follows
from the same quantities.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magyc_gtsam.factors.variables import Array

_SEEN = 0.02  # share of a direction's variance that is not the block's own; below it the graph cannot contradict


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
        calibration: keys of its soft and hard iron.
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
    calibration: tuple[int, int]

    def offset_from(self, reference: BlockFit) -> Array:
        """Return the mean deviation (3,) in T of the block's readings from another block's calibration."""
        result: Array = self.field - reference.soft_iron @ self.seen - reference.hard_iron
        return result


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
