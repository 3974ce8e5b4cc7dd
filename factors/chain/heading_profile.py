"""The probability of a graph's heading error, from blocks of magnetometer samples and the graph's attitudes.

Where the whole graph is rotated by ψ about the vertical, a sample reads m = A P Rᵀ Rz(−ψ) f + h. For each ψ this is
linear in soft iron A and hard iron h, so that their optimum and its cost have a closed form. Thirteen rows that
represent all samples thus yield the profile of the cost over ψ, with any number of minima. A heading whose optimum is
a soft iron that is not positive definite is excluded, however well it fits: where the world's field is upside down,
−A at another heading fits the samples exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import SYMMETRIC_UNITS, unvech

_HEADINGS = 72  # number of headings in the profile, 5 degrees apart: a minimum is some tens of degrees wide
_MODEL_ERROR = (
    0.1  # relative to the field: six degrees of attitude error, common to a block's samples, unknown to the graph
)
COLUMNS = 13  # vec P 9, share 1, field 3


@dataclass(frozen=True, eq=False)
class HeadingProfile:
    """The probability of each heading error.

    Attributes:
        angle: (n,) rad, ψ, evenly spaced from −π on.
        probability: (n,), with sum 1.
    """

    angle: Array
    probability: Array

    @property
    def best(self) -> float:
        """The most probable ψ in rad, interpolated between grid points by the probabilities around it."""
        top = int(np.argmax(self.probability))
        near = np.abs(_wrapped(self.angle - self.angle[top])) < np.radians(30)
        weight = self.probability * near
        offset = _wrapped(self.angle - self.angle[top]) @ weight / weight.sum()
        return float(_wrapped(self.angle[top] + offset))

    def within(self, angle: float, centre: float = 0.0) -> float:
        """Return the probability that ψ is at most `angle` rad from `centre`."""
        return float(self.probability[np.abs(_wrapped(self.angle - centre)) <= angle].sum())


def block_rows(design: Array, share: Array, field: Array) -> Array:
    """Compress a block's samples to at most 13 rows (vec P, share, m) with equal sums of squares for every A, v and h.

    Args:
        design: (k, 3, 3) P, from the body frame at the keyframe to the sensor at the sample.
        share: (k,) coefficient of the hard iron.
        field: (k, 3) measured.
    """
    rows = np.column_stack([design.reshape(-1, 9), share, field])
    if len(rows) <= COLUMNS:
        return rows
    scale = np.maximum(np.abs(rows).max(axis=0), 1e-12)
    root: Array = np.linalg.qr(rows / scale, mode="r") * scale
    return root


def in_world(rows: Array, rotation: Array) -> Array:
    """Return the rows of a block with P replaced by P Rᵀ, where R (3, 3) is the attitude at its keyframe."""
    turned = rows[:, :9].reshape(-1, 3, 3) @ rotation.T
    return np.column_stack([turned.reshape(-1, 9), rows[:, 9:]])


def heading_profile(
    rows: Array,
    field: Array,
    sigma: float,
    samples: int,
    blocks: int,
    mean: Array,
    information: Array,
) -> HeadingProfile:
    """Compute the profile from the rows of all blocks in the world frame.

    Args:
        rows: (n, 13), stacked results of `in_world`.
        field: (3,) f, world frame, in the unit of the rows.
        sigma: standard deviation of a sample, in that unit.
        samples, blocks: numbers of samples and of blocks.
        mean, information: (9,), (9, 9) of the prior on vech(A) and h.
    """
    strength = float(np.linalg.norm(field))
    variance = sigma**2 + samples / blocks * (_MODEL_ERROR * strength) ** 2
    if len(rows) > COLUMNS:
        rows = block_rows(rows[:, :9].reshape(-1, 3, 3), rows[:, 9], rows[:, 10:])
    angle = -np.pi + 2 * np.pi * np.arange(_HEADINGS) / _HEADINGS
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, z = field
    turned = np.stack([cos * x + sin * y, cos * y - sin * x, np.full(_HEADINGS, z)])  # Rz(−ψ) f
    seen = np.einsum("nij,jk->kni", rows[:, :9].reshape(-1, 3, 3), turned)
    design = np.concatenate(
        [
            np.einsum("eij,knj->knie", SYMMETRIC_UNITS, seen),
            np.broadcast_to(rows[:, 9][None, :, None, None] * np.eye(3), (_HEADINGS, len(rows), 3, 3)),
        ],
        axis=3,
    ).reshape(_HEADINGS, -1, 9)
    wanted = rows[:, 10:].ravel()
    normal = design.swapaxes(1, 2) @ design / variance + information
    right = design.swapaxes(1, 2) @ wanted / variance + information @ mean
    best = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    left = np.einsum("kna,ka->kn", design, best) - wanted
    off = best - mean
    cost = np.einsum("kn,kn->k", left, left) / variance + np.einsum("ka,ab,kb->k", off, information, off)
    possible = np.linalg.eigvalsh(unvech(best[:, :6]))[:, 0] > 0
    if not possible.any():
        return HeadingProfile(angle, np.full(_HEADINGS, 1 / _HEADINGS))
    least = float(cost[possible].min())
    scale = max(1.0, least / max(3 * blocks - 9, 1))
    weight = np.exp(-0.5 * (np.where(possible, cost, np.inf) - least) / scale)
    return HeadingProfile(angle, weight / weight.sum())


def _wrapped(angle: Array) -> Array:
    result: Array = (angle + np.pi) % (2 * np.pi) - np.pi
    return result
