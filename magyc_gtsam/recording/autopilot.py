"""Where an autopilot keeps the parameters of the sensors of a log, and in which axes it applies them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from magyc_gtsam.factors.errors import MagycError

_LARGEST = 2**32  # beyond any identifier of a device
_UNTURNED = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_TOLERANCE = 1e-6  # of R Rᵀ − I


@dataclass(frozen=True)
class Place:
    """The parameters of one sensor.

    Attributes:
        slot: number of the parameters, from 0: CAL_MAG0 is 0; COMPASS_OFS is 0 and COMPASS_OFS2 is 1.
        device: identifier to be written with them, of a sensor that has no slot yet; None leaves the present one.
        axes: (3, 3), from the axes in which the firmware applies the parameters to those of the recording.
        mounting: (3, 3), by which it turns the readings before it applies them; an export with a rotation includes it.
        custom: number of the custom rotation that ArduPilot can turn it by, from 1; 0 if the log does not tell.
        fixed: why the vehicle cannot turn it by parameters of its own; "" if it can, or the log does not tell.
        thermal: why it cannot be given a correction for its temperature; "" if it can, or the log does not tell.
        to_clear: names of parameters that correct the sensor on the vehicle, and not in the recording: an export sets
            them to 0, if it has no value for them.
        problem: why no parameters can be written; "" if they can.

    Raises:
        MagycError: a value is not of these.
    """

    slot: int = 0
    device: int | None = None
    axes: tuple[tuple[float, ...], ...] = _UNTURNED
    mounting: tuple[tuple[float, ...], ...] = _UNTURNED
    custom: int = 0
    fixed: str = ""
    thermal: str = ""
    to_clear: tuple[str, ...] = ()
    problem: str = ""

    def __post_init__(self) -> None:
        whole = [self.slot] if self.device is None else [self.slot, self.device]
        if any(not isinstance(n, int) or isinstance(n, bool) or not 0 <= n < _LARGEST for n in whole):
            raise MagycError(f"autopilot: slot and device must be whole numbers from 0, got {whole!r:.60}")
        for name in ("problem", "fixed", "thermal"):
            if not isinstance(getattr(self, name), str):
                raise MagycError(f"autopilot: {name} must be a text, got {getattr(self, name)!r:.60}")
        if self.custom not in (0, 1, 2):
            raise MagycError(f"autopilot: custom must be 0, 1 or 2, got {self.custom!r:.60}")
        if isinstance(self.to_clear, str) or not all(isinstance(name, str) for name in self.to_clear):
            raise MagycError(f"autopilot: to_clear must be names, got {self.to_clear!r:.60}")
        object.__setattr__(self, "to_clear", tuple(self.to_clear))
        for name in ("axes", "mounting"):
            object.__setattr__(self, name, _rows(name, getattr(self, name)))


def _rows(name: str, given: Any) -> tuple[tuple[float, ...], ...]:
    try:
        matrix = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape != (3, 3) or not np.allclose(matrix @ matrix.T, np.eye(3), rtol=0, atol=_TOLERANCE):
        raise MagycError(f"autopilot: {name} must be a rotation (3, 3), got {given!r:.60}")
    return tuple(map(tuple, matrix.tolist()))


@dataclass(frozen=True)
class Autopilot:
    """The parameters of a log's magnetometer and gyroscope.

    Attributes:
        firmware: the export target that has them, "px4" or "ardupilot"; "" if the log does not say.
        magnetometer, gyroscope: the place of each.
        powers: {channel of the log: (type, unit)} of what the firmware can multiply a compass's motor parameters by:
            the value of COMPASS_MOTCT or CAL_MAG_COMP_TYP for it, and the value of the channel at 1 A or full throttle.
        thermometers: {channel of the log: "magnetometer" or "gyroscope", whose own it is, or ""}.
        compensation: the value of COMPASS_MOTCT or CAL_MAG_COMP_TYP at the end of the log, of all compasses.
        others: names of the motor parameters of the vehicle's other compasses that are set.
        offset_sigma: (3,) T, of the mean offset that was taken out of the readings of the recording.
    """

    firmware: str
    magnetometer: Place = field(default_factory=Place)
    gyroscope: Place = field(default_factory=Place)
    powers: Mapping[str, tuple[int, float]] = field(default_factory=dict)
    thermometers: Mapping[str, str] = field(default_factory=dict)
    compensation: int = 0
    others: tuple[str, ...] = ()
    offset_sigma: tuple[float, ...] = (0.0, 0.0, 0.0)

    def to_dict(self) -> dict[str, Any]:
        """Return the places as JSON types."""
        places = {name: asdict(getattr(self, name)) for name in ("magnetometer", "gyroscope")}
        for place in places.values():
            place |= {name: [list(row) for row in place[name]] for name in ("axes", "mounting")}
            place["to_clear"] = list(place["to_clear"])
        return {
            "firmware": self.firmware,
            **places,
            "powers": {name: [int(kind), float(unit)] for name, (kind, unit) in self.powers.items()},
            "thermometers": dict(self.thermometers),
            "compensation": self.compensation,
            "others": list(self.others),
            "offset_sigma": list(self.offset_sigma),
        }

    @classmethod
    def from_dict(cls, data: Any) -> Autopilot:
        """Return the places that `to_dict` described.

        Raises:
            MagycError: a value is missing or not of these.
        """
        try:
            if not isinstance(data, Mapping) or not isinstance(data["firmware"], str):
                raise TypeError("firmware is missing")
            powers = {str(name): (int(kind), float(unit)) for name, (kind, unit) in data.get("powers", {}).items()}
            if not all(kind in (1, 2, 3) and 0 < unit < np.inf for kind, unit in powers.values()):
                raise TypeError(f"powers {powers!r:.60}")
            return cls(
                data["firmware"],
                Place(**data["magnetometer"]),
                Place(**data["gyroscope"]),
                powers,
                {str(name): str(sensor) for name, sensor in data.get("thermometers", {}).items()},
                int(data.get("compensation", 0)),
                tuple(str(name) for name in data.get("others", ())),
                tuple(float(sigma) for sigma in data.get("offset_sigma", (0.0, 0.0, 0.0))),
            )
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise MagycError(f"autopilot: damaged entry ({error}); calibrate the log again") from None


def without_parameters(problem: str) -> Autopilot:
    """Return the places of sensors for which no parameters can be written, for a reason."""
    return Autopilot("", Place(problem=problem), Place(problem=problem))


def ardupilot_offset(slot: int) -> str:
    """Return the name of the offset of ArduPilot's gyroscope number `slot`, from 0, without its axis."""
    if slot < 3:
        return "INS_GYROFFS" if slot == 0 else f"INS_GYR{slot + 1}OFFS"
    return f"INS{slot + 1}_GYROFFS"
