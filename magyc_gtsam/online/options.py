"""What the user of the online smoother may choose, checked."""

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
    """The options of `OnlineSmoother`, which says what they mean."""

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
        """The options of the batch method, checked."""
        own: dict[str, Any] = {
            "field_strength": self.field_strength,
            "clock_drift": self.clock_drift,
        }
        return SmootherOptions(**self.fit, **own, **self.known)

    @property
    def fit(self) -> dict[str, Any]:
        """The options of the batch method."""
        return {name: getattr(self, name) for name in _OF_BATCH}

    @property
    def known(self) -> dict[str, Any]:
        """What is known beforehand, as the batch method takes it."""
        return {} if self.prior is None else {"prior": self.prior, "hard_iron_walk": self.prior_walk}

    @property
    def reject(self) -> bool:
        """Whether disturbed windows are weighed down."""
        return self.robust is not False

    def free(self, parameters: Array) -> np.ndarray:
        """(p,) bool, of θ (p,) the parameters that are estimated; a skew is held between two refits."""
        free = np.arange(len(parameters)) < PARAMETERS
        free[DELAY] = self.delay is None
        return free

    @property
    def walks(self) -> tuple[tuple[slice, float], ...]:
        """Which parameters walk, and by how much per √h."""
        every = ((HARD_IRON, self.hard_iron_walk), (BIAS, self.gyro_bias_walk))
        return tuple((rows, walk) for rows, walk in every if walk)
