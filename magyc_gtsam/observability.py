"""What the motion determined, in the user's words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Weakness:
    """A direction of the parameters that the motion left weak.

    Attributes:
        what: which parameter or axis, in the user's words.
        sigma: standard deviation along that direction, in `unit`.
        limit: the deviation from which the result must not be trusted, in `unit`.
        unit: "µT", "%" or "mrad/s".
        remedy: the motion that would determine it.
    """

    what: str
    sigma: float
    limit: float
    unit: str
    remedy: str

    @property
    def sentence(self) -> str:
        """One line for terminal and page."""
        return f"{self.what} ±{self.sigma:.2g} {self.unit} (limit {self.limit:g}): {self.remedy}"


@dataclass(frozen=True)
class Observability:
    """Whether the motion determined the calibration, and what is weak.

    Attributes:
        observable: False where any weakness passes its limit.
        weak: the weak directions, worst first.
        heading_sigma: deg, largest standard deviation of heading that the calibration's own
            uncertainty causes over a level turn.
    """

    observable: bool
    weak: tuple[Weakness, ...] = ()
    heading_sigma: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """JSON types."""
        return asdict(self) | {"weak": [asdict(w) for w in self.weak]}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Observability:
        """The inverse of `to_dict`."""
        return cls(**{**data, "weak": tuple(Weakness(**w) for w in data["weak"])})
