"""The options of MAGYC-IFG, over a whole recording and online, with their validation."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

from magyc_gtsam.estimators.magyc.derivative_windows import check_length
from magyc_gtsam.estimators.magyc.state import Prior, scale_prior
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.kernels import kernel
from magyc_gtsam.factors.numbers import is_positive
from magyc_gtsam.runners.isam import Method


@dataclass(frozen=True, kw_only=True)
class IncrementalOptions:
    """The options of MAGYC-IFG.

    Attributes:
        field_strength: T, scales the soft iron; default det 1.
        robust: name of a kernel ("huber", "cauchy", "geman-mcclure", "l1") that weights each window, with
            `compressed=False` only. Its width is in units of `residual_sigma`, which must then be that of the data: √2
            times the magnetometer's noise over the window.
        optimizer: "dogleg" (RISE, as in the paper) or "gauss-newton".
        prior: "norm" as in (9), or "determinant" as the authors' later package fixes it.
        window: s, over which samples are averaged.
        compressed: whether to replace one exact factor at each update, in constant time and memory; False keeps all
            factors in iSAM2 as published. The estimates are the same.
        estimate: "mean" of the last 20 % of the estimates, as in the paper, or the "current" one.
        residual_sigma: of (7), gauss/s.
        prior_sigma: of (9), per window.

    Raises:
        MagycError: an option is invalid.
    """

    field_strength: float | None = None
    robust: str | None = None
    optimizer: Method = "dogleg"
    prior: Prior = "norm"
    window: float = 1.0
    compressed: bool = True
    estimate: Literal["mean", "current"] = "mean"
    residual_sigma: float = 1e-3
    prior_sigma: float = 1e-2

    def __post_init__(self) -> None:
        check_length(self.window)
        if self.estimate not in ("mean", "current"):
            raise MagycError(f"estimate {self.estimate!r} unknown; there are mean, current")
        if self.compressed and self.robust is not None:
            raise MagycError(
                "robust: a compressed factor cannot weigh its windows any more; choose compressed=False, "
                "or method 'smoother'"
            )
        for name in ("residual_sigma", "prior_sigma"):
            if not is_positive(getattr(self, name)):
                raise MagycError(f"{name}: must be finite and above 0, got {getattr(self, name)!r}")
        if self.robust is not None:
            kernel(self.robust)  # raises if it is unknown
        scale_prior(self.prior, self.prior_sigma)  # raises if it is unknown

    @property
    def configuration(self) -> dict[str, Any]:
        """The options as JSON types, sufficient to repeat the run."""
        return asdict(self)
