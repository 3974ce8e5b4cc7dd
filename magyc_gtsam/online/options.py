"""The checked options of the online smoother."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.options import SmootherOptions
from magyc_gtsam.factors.chain.field_chain import DELAY, PARAMETERS
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.online.marginal import BIAS, HARD_IRON
from magyc_gtsam.recording import Array

_OF_BATCH = ("noise", "robust", "delay", "window", "turn", "misalignment", "field")


@dataclass(frozen=True)
class OnlineOptions:
    """The options of `OnlineSmoother`, which documents them."""

    field_strength: float | None
    noise: tuple[float, float] | None
    robust: bool | None
    delay: float | None
    window: float
    turn: float | None
    clock_drift: float
    hard_iron_walk: float
    gyro_bias_walk: float
    detect_changes: bool
    angular_rate_is: Literal["instant", "interval-mean"]
    horizon: float
    prior: Calibration | Mapping[str, Any] | None
    prior_walk: float
    misalignment: float | Literal["auto"]
    field: Any

    def __post_init__(self) -> None:
        _ = self.options
        if self.angular_rate_is not in ("instant", "interval-mean"):
            raise MagycError(
                f"angular_rate_is: must be 'instant' or 'interval-mean', got {self.angular_rate_is!r}"
            )
        for name, least in (
            ("hard_iron_walk", 0.0),
            ("gyro_bias_walk", 0.0),
            ("prior_walk", 0.0),
            ("horizon", 120.0),
        ):
            value = getattr(self, name)
            if isinstance(value, (bool, str)) or not least <= value < np.inf:
                raise MagycError(f"{name}: must be a finite number of at least {least:g}, got {value!r}")

    @property
    def options(self) -> SmootherOptions:
        """Return the options as those of the batch method, checked."""
        return SmootherOptions(
            **self.fit, field_strength=self.field_strength, clock_drift=self.clock_drift, **self.known
        )

    @property
    def fit(self) -> dict[str, Any]:
        """Return the options that a fit of the batch method takes."""
        return {name: getattr(self, name) for name in _OF_BATCH}

    @property
    def known(self) -> dict[str, Any]:
        """Return the prior knowledge as options of the batch method."""
        return {} if self.prior is None else {"prior": self.prior, "hard_iron_walk": self.prior_walk}

    @property
    def reject(self) -> bool:
        """Return whether disturbed windows are downweighted."""
        return self.robust is not False

    def free(self, parameters: Array) -> np.ndarray:
        """Return (p,) bool: the estimated parameters of θ (p,); a misalignment is held between two refits."""
        free = np.arange(len(parameters)) < PARAMETERS
        free[DELAY] = self.delay is None
        return free

    @property
    def walks(self) -> tuple[tuple[slice, float], ...]:
        """Return the parameters that walk at random, and by how much per √h."""
        every = ((HARD_IRON, self.hard_iron_walk), (BIAS, self.gyro_bias_walk))
        return tuple((rows, walk) for rows, walk in every if walk)
