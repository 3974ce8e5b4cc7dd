"""What the user of the online smoother may choose, checked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from magyc_gtsam.estimators.smoother import check_options
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.field_chain import DELAY, PARAMETERS
from magyc_gtsam.online.summary import BIAS, HARD_IRON


@dataclass(frozen=True)
class Settings:
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

    def __post_init__(self) -> None:
        check_options(self.noise, self.robust, self.delay, self.window, self.turn, self.clock_drift)
        if self.angular_rate_is not in ("instant", "interval-mean"):
            raise MagycError(f"angular_rate_is: {self.angular_rate_is!r} is neither 'instant' nor 'interval-mean'")
        for name, least in (("hard_iron_walk", 0.0), ("gyro_bias_walk", 0.0), ("horizon", 120.0)):
            value = getattr(self, name)
            if isinstance(value, (bool, str)) or not least <= value < np.inf:
                raise MagycError(f"{name}: {value!r} is no number of {least:g} or more")

    @property
    def fit(self) -> dict[str, Any]:
        """The options of the batch method."""
        return {name: getattr(self, name) for name in ("noise", "robust", "delay", "window", "turn")}

    @property
    def reject(self) -> bool:
        """Whether disturbed windows are weighed down."""
        return self.robust is not False

    @property
    def free(self) -> np.ndarray:
        """(13,) bool, the parameters that are estimated."""
        free = np.ones(PARAMETERS, dtype=bool)
        free[DELAY] = self.delay is None
        return free

    @property
    def walks(self) -> tuple[tuple[slice, float], ...]:
        """Which parameters walk, and by how much per √h."""
        every = ((HARD_IRON, self.hard_iron_walk), (BIAS, self.gyro_bias_walk))
        return tuple((rows, walk) for rows, walk in every if walk)
