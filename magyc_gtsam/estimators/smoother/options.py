"""The options of the field smoother, batch and online, with their validation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.gauge import check_field_strength, check_noise
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.units import LIMITS

MOST_DRIFT = 0.1  # s/s, largest plausible drift of a clock
MOST_SKEW = np.radians(45.0)
MOST_SCALE = 0.1  # largest prior sigma of a gyroscope's scale; larger errors mean a wrong unit
MOST_DELAY = LIMITS.delay  # s, of one that is given, and of one that is estimated and trusted
MOST_HARD_IRON_WALK = 1.0  # T
MOST_SOFT_IRON_WALK = 10.0
FIELD_SIGMA = 150e-9  # T, sigma of the World Magnetic Model's strength by its error budget
DIP_SIGMA = np.radians(0.2)  # sigma of its dip
HEADING_SIGMA = np.radians(1.0)  # of a sensor's x axis relative to that of its vehicle, with careful mounting

Pair = tuple[float, float]


@dataclass(frozen=True)
class PlaceField:
    """The field at the place: strength T and dip rad (below the horizontal), with sigmas; None if not to be used."""

    strength: float | None
    strength_sigma: float
    dip: float | None
    dip_sigma: float


@dataclass(frozen=True)
class KnownHeading:
    """A channel with the heading of the sensor's x axis, sigma (rad) of its mean over a log, and declination (rad)."""

    channel: str
    sigma: float
    declination: float


@dataclass(frozen=True, kw_only=True)
class SmootherOptions:
    """The options of the smoother.

    Attributes:
        field_strength: T, strength of the true field; sets the scale of the soft iron. None: det = 1.
        noise: (magnetometer T, gyroscope rad/s) per sample; None estimates both.
        robust: whether to reject disturbed windows; None means True.
        delay: s by which the magnetometer lags; None estimates it, a number fixes it.
        window: s, longest window.
        turn: rad, largest rotation inside a window; None chooses it from the spread of the data.
        clock_drift: s/s that the magnetometer's clock gains on the gyroscope's, corrected in its stamps from the first
            row on. A remaining drift is detected, and a result that it harms is not trusted.
        misalignment: "auto" lets the data decide whether to correct a misalignment of the two chips; a number is the
            prior standard deviation of each angle in rad, with which it is always estimated; 0 fixes it at zero.
        gyroscope_scale: prior standard deviation (1) of the scale error of each of the gyroscope's axes, which is
            estimated as the term `gyro-scale`; 0 fixes it at zero. Typical sensors have 0.01.
        prior: an earlier calibration of the same instrument, with covariance (or the result of its `to_dict`).
        hard_iron_walk: T, standard deviation of the change of each axis of the hard iron since the prior.
        soft_iron_walk: standard deviation of the change of each element of the soft iron (determinant 1) since.
        field: (strength T, dip rad) at the place, or ((strength, sigma), (dip, sigma)); either may be None. The
            strength sets the scale of the soft iron and, with a prior, informs the fit; the dip informs the fit if the
            recording has an accelerometer or an attitude.
        heading: name of the channel that holds the heading of the sensor's x axis, degrees clockwise from north, or
            (name, sigma rad) with the sigma of its mean over the log (default 1°). It informs the yaw component of the
            misalignment, and needs an accelerometer.
        declination: rad, of the field at the place, east positive; 0 if that heading is from magnetic north.

    Raises:
        MagycError: an option is out of range.
    """

    field_strength: float | None = None
    noise: Pair | None = None
    robust: bool | None = None
    delay: float | None = None
    window: float = 1.5
    turn: float | None = None
    clock_drift: float = 0.0
    misalignment: float | Literal["auto"] = "auto"
    gyroscope_scale: float = 0.0
    prior: Calibration | None = None
    hard_iron_walk: float = 0.0
    soft_iron_walk: float = 0.0
    field: Any = None
    heading: Any = None
    declination: float = 0.0

    def __post_init__(self) -> None:
        check_field_strength(self.field_strength)
        check_noise(self.noise)
        if not (self.robust is None or isinstance(self.robust, bool | np.bool_)):
            raise MagycError(
                f"robust: {self.robust!r} is neither True nor False; this method has one rejection of its own, kernels "
                "such as 'huber' are for the methods magyc-bfg and magyc-ifg"
            )
        _number("window", self.window, 0.0, 60.0, "s")
        _number("clock_drift", self.clock_drift, -MOST_DRIFT, MOST_DRIFT, "s/s")
        if self.turn is not None:
            _number("turn", self.turn, 0.0, np.pi, "rad")
        if self.delay is not None:
            _number("delay", self.delay, -MOST_DELAY, MOST_DELAY, "s")
        if not (isinstance(self.misalignment, str) and self.misalignment == "auto"):
            _number("misalignment", self.misalignment, -1e-15, MOST_SKEW, "rad, or 'auto'")
        _number("gyroscope_scale", self.gyroscope_scale, -1e-15, MOST_SCALE, "")
        _number("hard_iron_walk", self.hard_iron_walk, -1e-15, MOST_HARD_IRON_WALK, "T")
        _number("soft_iron_walk", self.soft_iron_walk, -1e-15, MOST_SOFT_IRON_WALK, "")
        if self.prior is None and (self.hard_iron_walk or self.soft_iron_walk):
            raise MagycError(
                "hard_iron_walk=, soft_iron_walk=: they say what may have changed since an earlier calibration; give "
                "it (prior=)"
            )
        if isinstance(self.prior, Mapping):
            object.__setattr__(self, "prior", Calibration.from_dict(self.prior))
        if self.prior is not None and not isinstance(self.prior, Calibration):
            raise MagycError(
                f"prior: an earlier Calibration is needed, got {type(self.prior).__name__}; Calibration.load reads one"
            )
        if self.field is not None and self.field_strength is not None:
            raise MagycError("field and field_strength: both set the strength of the field; give one of them")
        _number("declination", self.declination, -np.pi, np.pi, "rad")
        if self.declination and self.heading is None:
            raise MagycError("declination: it is of no use without a heading from true north; give it (heading=)")
        _ = self.place, self.known_heading

    @property
    def reject(self) -> bool:
        """Whether disturbed windows are down-weighted."""
        return self.robust is not False

    @property
    def place(self) -> PlaceField | None:
        """The value of `field` with its sigmas."""
        if self.field is None:
            return None
        wrong = MagycError(
            f"field: {self.field!r} is neither (strength T, dip rad) nor ((strength, sigma), (dip, sigma))"
        )
        if isinstance(self.field, PlaceField):
            return self.field
        if isinstance(self.field, str):
            raise wrong
        try:
            strength, dip = self.field
            strength, sigma = strength if np.ndim(strength) else (strength, FIELD_SIGMA)
            dip, dip_sigma = dip if np.ndim(dip) else (dip, DIP_SIGMA)
        except (TypeError, ValueError):
            raise wrong from None
        check_field_strength(strength)
        if strength is None and dip is None:
            raise wrong
        _number("field: the sigma of the strength", sigma, 0.0, 1e-4, "T")
        if dip is not None:
            _number("field: the dip", dip, -np.pi / 2 - 1e-9, np.pi / 2 + 1e-9, "rad")
            _number("field: the sigma of the dip", dip_sigma, 0.0, np.pi, "rad")
            dip = float(dip)
        return PlaceField(None if strength is None else float(strength), float(sigma), dip, float(dip_sigma))

    @property
    def known_heading(self) -> KnownHeading | None:
        """The value of `heading` with its sigma."""
        if self.heading is None:
            return None
        named = isinstance(self.heading, str)
        if not named and (not isinstance(self.heading, (tuple, list)) or len(self.heading) != 2):
            raise MagycError(f"heading: {self.heading!r} is neither the name of a channel nor (name, sigma rad)")
        name, sigma = (self.heading, HEADING_SIGMA) if named else self.heading
        if not isinstance(name, str):
            raise MagycError(f"heading: {name!r} is not the name of a channel")
        _number("heading: its sigma", sigma, 0.0, np.pi, "rad")
        return KnownHeading(name, float(sigma), float(self.declination))

    @property
    def known_strength(self) -> float | None:
        """T, the field strength that sets the scale of the soft iron."""
        place = self.place
        return self.field_strength if place is None else place.strength

    @property
    def strength_sigma(self) -> float:
        """T, standard deviation of `known_strength`."""
        place = self.place
        return 0.0 if place is None or place.strength is None else place.strength_sigma

    @property
    def configuration(self) -> Mapping[str, Any]:
        """The chosen options as JSON types, sufficient to repeat the run."""
        chosen = {each.name: getattr(self, each.name) for each in _FIELDS}
        result = {name: value for name, value in chosen.items() if value is not None or name in ("delay", "turn")}
        for name in ("clock_drift", "gyroscope_scale", "hard_iron_walk", "soft_iron_walk", "declination"):
            if not result[name]:
                del result[name]
        result["robust"] = self.reject
        if self.noise is not None:
            result["noise"] = list(self.noise)
        place = self.place
        if place is not None:
            result["field"] = [[place.strength, place.strength_sigma], [place.dip, place.dip_sigma]]
        heading = self.known_heading
        if heading is not None:
            result["heading"] = [heading.channel, heading.sigma]
        if self.prior is not None:
            before = {name: value for name, value in self.prior.configuration.items() if name != "prior"}
            shorter = {"diagnostics": {"recordings": list(self.prior.fitted_to)}, "configuration": before}
            result["prior"] = self.prior.to_dict() | shorter
        return result


def _number(name: str, value: Any, low: float, high: float, unit: str) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)) or not low < value < high:
        least = "at least 0" if -1e-9 < low < 0 else f"above {low:g}"  # such a limit lets 0 itself through
        raise MagycError(f"{name} must be {least} and below {high:g} {unit}".rstrip() + f", got {value!r}")


_FIELDS = fields(SmootherOptions)
