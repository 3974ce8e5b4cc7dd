"""`Term`: one effect with its value, as a calibration holds it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.forms import EARLIER, FORMS
from magyc_gtsam.factors.effects.signals import CHANNELS, Signals
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import numbers


@dataclass(frozen=True, eq=False)
class Term:
    """One effect of a calibration, with its value.

    Attributes:
        name: name in the catalogue (`FORMS` holds the effects that change a reading; noise effects change none).
        value: (k,) in SI units (T, rad/s, s, … per unit of the channel).
        covariance: (k, k) of the value.
        setting: parameters that were searched over, and references of channels.
        channels: names of the rows of the channel that it follows, in the recording in which it was found, which
            references count; empty if they are not known, or it follows none.
    """

    name: str
    value: Array
    covariance: Array
    setting: Mapping[str, float] = dataclasses.field(default_factory=dict)
    channels: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        value = numbers(f"term {self.name!r}: value", self.value)
        covariance = numbers(f"term {self.name!r}: covariance", self.covariance)
        if value.ndim != 1 or covariance.shape != (len(value), len(value)):
            raise MagycError(
                f"term {self.name!r}: value {value.shape} and covariance {covariance.shape} do not fit together"
            )
        if not (np.isfinite(value).all() and np.isfinite(covariance).all()):
            raise MagycError(f"term {self.name!r}: value and covariance must be finite")
        if EARLIER.get(self.name) in self.setting:
            raise MagycError(
                f"term {self.name!r}: it has an earlier form (setting {EARLIER[self.name]!r}), which is not read "
                "any more; diagnose the log again with `magyc-gtsam gap`"
            )
        value.flags.writeable = covariance.flags.writeable = False
        object.__setattr__(self, "value", value)
        object.__setattr__(self, "covariance", covariance)
        object.__setattr__(self, "setting", MappingProxyType({k: float(v) for k, v in self.setting.items()}))
        if isinstance(self.channels, str) or not all(isinstance(name, str) for name in self.channels):
            raise MagycError(f"term {self.name!r}: channels must be names, got {self.channels!r:.60}")
        object.__setattr__(self, "channels", tuple(self.channels))

    @property
    def side(self) -> str | None:
        """The sensor, "magnetometer" or "gyroscope"; None for an effect that changes the noise only."""
        return FORMS[self.name].side if self.name in FORMS else None

    @property
    def subtracted(self) -> bool:
        """Whether it is subtracted from readings; a timing moves stamps, and a misalignment turns axes."""
        return self.side is not None and self.name not in ("timing", "misalignment")

    @property
    def kind(self) -> str | None:
        """The kind of channel that it follows; None without one."""
        needs = FORMS[self.name].needs if self.subtracted else ()
        return next((need for need in needs if need in CHANNELS), None)

    @property
    def remembers(self) -> bool:
        """Whether its contribution to a reading depends on other readings: a lag, a loop, a place passed by."""
        return self.name in FORMS and (FORMS[self.name].remembers or self.setting.get("lag", 0.0) > 0)

    @property
    def sigma(self) -> Array:
        """Standard deviations (k,)."""
        return np.sqrt(np.diag(self.covariance))

    def evaluate(self, signals: Signals) -> Array:
        """Return the contribution (3, n) to the reading of its sensor, in T or rad/s.

        Raises:
            MagycError: a signal or a setting that it needs is missing.
        """
        try:
            return FORMS[self.name].evaluate(signals, self.value, self.setting)
        except KeyError as missing:
            raise MagycError(
                f"term {self.name!r}: setting {missing} is missing in this calibration; diagnose the log again with "
                "`magyc-gtsam gap`"
            ) from None

    def to_dict(self) -> dict[str, Any]:
        """Return the term in JSON types."""
        return {
            "name": self.name,
            "value": self.value.tolist(),
            "covariance": self.covariance.tolist(),
            "setting": dict(self.setting),
            **({"channels": list(self.channels)} if self.channels else {}),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Term:
        """Return the term of a dictionary; the inverse of `to_dict`."""
        return cls(
            data["name"], data["value"], data["covariance"], data.get("setting") or {}, data.get("channels") or ()
        )
