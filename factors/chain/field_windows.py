"""Windows of magnetometer samples with the gyroscope's integrals over each: the data of a field chain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from magyc_gtsam.factors.chain.empty_windows import NOTHING, Between
from magyc_gtsam.factors.chain.rotations import Array, exponential_matrices


@dataclass(frozen=True, eq=False)
class FieldWindows:
    """n windows integrated at one bias and delay; the windows run along the last, contiguous axis.

    Attributes:
        time: (n,) s, mean stamp.
        count: (n,) number of magnetometer samples.
        field: (3, n) T, mean measured field.
        rotation: (3, 3, n) mean of R_jᵀ, integrated world→sensor.
        rotation_bias: (3, 3, 3, n) its derivative with respect to the bias (third axis), s.
        rotation_rate: (3, 3, n) its derivative with respect to the delay, 1/s.
        lever: (3, 3, n − 1) s, K̄' − K̄ between neighbours.
        link_time: (n − 1,) s², Σ dt² between neighbours; the link's variance is σ_g² times it.
        linked: (n − 1,) False where a hole in the gyroscope separates two windows.
        bias: (3,) rad/s and delay: s, at which the gyroscope was integrated.
        between: the motion while the field was not measured.
    """

    time: Array
    count: Array
    field: Array
    rotation: Array
    rotation_bias: Array
    rotation_rate: Array
    lever: Array
    link_time: Array
    linked: np.ndarray
    bias: Array
    delay: float
    between: Between = NOTHING

    def __len__(self) -> int:
        return len(self.time)

    def rotation_at(self, bias: Array, delay: float) -> Array:
        """Return M (3, 3, n) at a bias and delay, to first order; the latest result is cached and must not be written
        to.
        """

        def moved() -> Array:
            result = np.einsum("ijkn,k->ijn", self.rotation_bias, bias - self.bias)
            result += self.rotation
            if delay != self.delay:
                result += (delay - self.delay) * self.rotation_rate
            return result

        return self._kept("rotation", (bias.tobytes(), delay), moved)

    def turn_at(self, bias: Array) -> Array:
        """Return E = Exp(−ΔK (b − b₀)) (3, 3, n − 1) from one window to the next; cached in the same way."""
        return self._kept(
            "turn",
            bias.tobytes(),
            lambda: exponential_matrices(np.einsum("ijn,j->in", self.lever, self.bias - bias)),
        )

    @cached_property
    def spread(self) -> float:
        """Mean distance, in T, of a window's field from the centroid of all."""
        away = self.field - self.field.mean(axis=1)[:, None]
        return float(np.sqrt(np.einsum("in,in->n", away, away)).mean())

    def _kept(self, what: str, key: object, compute: Callable[[], Array]) -> Array:
        """Return the cached result if the key is the last one; residuals and Jacobians are requested at the same
        state.
        """
        kept = self._last.get(what)
        if kept is None or kept[0] != key:
            kept = self._last[what] = key, compute()
        return kept[1]

    @cached_property
    def _last(self) -> dict[str, tuple[object, Array]]:
        return {}

    def part(self, first: int, stop: int) -> FieldWindows:
        """Return the windows `first` ≤ n < `stop`, in the same world frame."""
        rows, links = slice(first, stop), slice(first, stop - 1)
        return replace(
            self,
            time=self.time[rows],
            count=self.count[rows],
            field=self.field[:, rows],
            rotation=self.rotation[:, :, rows],
            rotation_bias=self.rotation_bias[:, :, :, rows],
            rotation_rate=self.rotation_rate[:, :, rows],
            lever=self.lever[:, :, links],
            link_time=self.link_time[links],
            linked=self.linked[links],
            between=self.between.part(first, stop - 1),
        )
