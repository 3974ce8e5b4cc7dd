"""The calibration itself."""

from __future__ import annotations

import importlib
import json
import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.calibration.limits import check
from magyc_gtsam.calibration.signals import as_signals, given_signals, vectors
from magyc_gtsam.export import do_not_use, export, parts_of
from magyc_gtsam.factors.effects.corrections import corrected_field, corrected_rate, shifted
from magyc_gtsam.factors.effects.forms import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.observability import Observability
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.storage.mapping import dump_yaml, load_mapping
from magyc_gtsam.storage.whole_file import write_text

_PLAUSIBLE = (8e-6, 175e-6)  # T, of a calibrated field: the Earth's, with the scale unknown by 2.5 either way
_FORMAT = "magyc-gtsam calibration 1"


@dataclass(frozen=True, eq=False, repr=False)
class Calibration:
    """Soft iron, hard iron and gyroscope bias: m = soft_iron · u + hard_iron, w = ω + gyro_bias.

    Attributes:
        soft_iron: (3, 3), det 1 unless a field strength was given.
        hard_iron: (3,) T.
        gyro_bias: (3,) rad/s, None where the method does not estimate it.
        covariance: (12, 12) of vech(soft_iron) row by row, hard_iron, gyro_bias, or (9, 9) where gyro_bias is
            None; None where the method has none. Its rank is less by one where det soft_iron = 1 fixed the scale.
            All of the error: the sensors' noise, and what the model does not explain.
        noise_covariance: the sensors' part of `covariance` alone, likewise; None where the method does not tell them
            apart.
        delay: s by which the magnetometer lags the gyroscope; 0 if fixed or not estimated.
        delay_sigma: s, standard deviation of `delay`; None if fixed or not estimated.
        terms: extra effects beyond the twelve parameters; empty for the base model.
        converged: whether the method's own stopping rule was met and the result is observable.
        message: why the method stopped, or why the result must not be trusted.
        method: its name in `magyc_gtsam.methods()`.
        noise: standard deviation per sample: {"magnetic_field": T, "angular_rate": rad/s}.
        field_strength: T, strength of the calibrated field; measured unless it was given.
        observability: what the motion determined well and what not; None where unknown.
        diagnostics: the method's own numbers (cost, iterations, weights, …), JSON types only.
        configuration: the options the method ran with, enough to run it again.
    """

    soft_iron: Array
    hard_iron: Array
    gyro_bias: Array | None = None
    covariance: Array | None = None
    noise_covariance: Array | None = field(default=None, kw_only=True)
    delay: float = 0.0
    delay_sigma: float | None = None
    terms: tuple[Term, ...] = ()
    converged: bool = True
    message: str = ""
    method: str = ""
    noise: Mapping[str, float] = field(default_factory=dict)
    field_strength: float | None = None
    observability: Observability | None = None
    diagnostics: Mapping[str, Any] = field(default_factory=dict)
    configuration: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        put = object.__setattr__
        freedoms = 9 if self.gyro_bias is None else 12
        if self.covariance is None:  # a part of nothing
            put(self, "noise_covariance", None)
        square = (freedoms, freedoms)
        shapes = {"soft_iron": (3, 3), "hard_iron": (3,), "gyro_bias": (3,), "covariance": square}
        shapes["noise_covariance"] = square
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is None and name in ("gyro_bias", "covariance", "noise_covariance"):
                continue
            try:
                array = np.array(value, dtype=np.float64)
            except (TypeError, ValueError):
                raise MagycError(f"calibration: {name} must be {shape} finite numbers, got {value!r}") from None
            if array.shape != shape or not np.isfinite(array).all():
                raise MagycError(f"calibration: {name} must be {shape} finite numbers, got {array.tolist()}")
            array.flags.writeable = False
            put(self, name, array)
        if abs(np.linalg.det(self.soft_iron)) < 1e-12:
            raise MagycError("calibration: soft_iron is singular, so it cannot be applied")
        for name in ("noise", "diagnostics", "configuration"):
            value = getattr(self, name)
            if not isinstance(value, Mapping):
                raise MagycError(f"calibration: {name} must be names with values, got {value!r}")
            put(self, name, MappingProxyType(dict(value)))

    def apply(self, magnetic_field: ArrayLike | Recording, **signals: Any) -> Array:
        """Calibrated field soft_iron⁻¹ (m − hard_iron), its terms taken out: (N, 3) or (3,) T in and out.

        Args:
            magnetic_field: the field, or a whole recording, which has whatever the terms need.
            signals: what terms need where only the field is given, row by row: time (N,) s, angular_rate and
                acceleration (N, 3), channels {name: (N,) or (N, k)}. With a time, a `timing` term is undone too.

        Raises:
            MagycError: a wrong shape, or a term needs a signal that is not there.

        Warns:
            UserWarning: the strength of the result is in the median outside of 8 to 175 µT.
        """
        return self._plausible(self.corrected(magnetic_field, **signals))

    def corrected(self, magnetic_field: ArrayLike | Recording, **signals: Any) -> Array:
        """As `apply`, without the warning: for fields whose strength is judged or shown."""
        given = given_signals(magnetic_field, "magnetic_field", signals)
        m = vectors("magnetic_field", given.pop("magnetic_field"))
        if not self.terms:
            return cast(Array, (m - self.hard_iron) @ np.linalg.inv(self.soft_iron).T)
        rows = np.atleast_2d(m)
        at = as_signals(len(rows), given)
        if at.rate is not None and self.gyro_bias is not None:
            at = replace(at, rate=corrected_rate(at.rate, self.gyro_bias, self.terms, at))
        field = corrected_field(rows.T, self.soft_iron, self.hard_iron, self.terms, at)
        if given.get("time") is not None:
            field = shifted(at.time, field, self.terms)
        return field.T.reshape(m.shape)

    def _plausible(self, field: Array) -> Array:
        """The field, with a warning where its strength cannot be the Earth's."""
        strength = np.linalg.norm(np.atleast_2d(field), axis=1)
        median = float(np.median(strength)) if len(strength) else np.nan
        in_tesla = self.configuration.get("magnetic_field_unit") != "counts"
        if in_tesla and not _PLAUSIBLE[0] <= median <= _PLAUSIBLE[1] and np.isfinite(median):
            warnings.warn(
                f"apply: the calibrated field is {median * 1e6:.3g} µT in the median, outside of 8 to 175 µT; "
                "is it in tesla, raw, and from the instrument that was calibrated?",
                stacklevel=3,
            )
        return field

    def apply_gyroscope(self, angular_rate: ArrayLike | Recording, **signals: Any) -> Array:
        """Calibrated angular rate w − gyro_bias, its terms taken out: (N, 3) or (3,) rad/s in and out.

        A recording and `signals` as in `apply`.
        """
        if self.gyro_bias is None:
            raise MagycError(f"method {self.method!r} estimates no gyroscope bias, so there is none to apply")
        given = given_signals(angular_rate, "angular_rate", signals)
        w = vectors("angular_rate", given.pop("angular_rate"))
        if not self.terms:
            return w - self.gyro_bias
        rows = np.atleast_2d(w)
        return corrected_rate(rows.T, self.gyro_bias, self.terms, as_signals(len(rows), given)).T.reshape(w.shape)

    @property
    def recording(self) -> Recording | None:
        """What `calibrate` made it from; None after loading, pickling or `dataclasses.replace`."""
        found: Recording | None = self.__dict__.get("_recording")
        return found

    def made_from(self, recording: Recording) -> Calibration:
        """The same, knowing its recording, for `plot` and `report`."""
        object.__setattr__(self, "_recording", recording)
        return self

    def plot(self, recording: Recording | None = None) -> Any:
        """The field before and after, as a matplotlib figure; `recording` where `self.recording` is None.

        Raises:
            MagycError: the recording is not known.
        """
        return _notebook().plot_calibration(self, recording)

    def report(self, path: str | os.PathLike[str], recording: Recording | None = None) -> Path:
        """Write the page (.html), or its figures (.pdf); `recording` where `self.recording` is None.

        Raises:
            MagycError: the recording is not known.
        """
        written: Path = _notebook().report(self, path, recording)
        return written

    def __repr__(self) -> str:
        state = "trusted" if self.trusted else "not to be trusted"
        iron = ", ".join(f"{value * 1e6:.2f}" for value in self.hard_iron)
        return f"Calibration({self.method!r}, {state}, hard iron ({iron}) µT)"

    def _repr_html_(self) -> str:
        text: str = _notebook().html_of(self)
        return text

    @property
    def trusted(self) -> bool:
        """Whether the method and the motion both say that the result can be used."""
        return self.converged and (self.observability is None or self.observability.observable)

    @property
    def sigma(self) -> Mapping[str, Array]:
        """Standard deviations: soft_iron (3, 3), hard_iron (3,), gyro_bias (3,) if any; empty without covariance."""
        if self.covariance is None:
            return {}
        deviation = np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))
        soft_iron = np.empty((3, 3))
        upper = np.triu_indices(3)
        soft_iron[upper] = deviation[:6]
        soft_iron.T[upper] = deviation[:6]
        sigma = {"soft_iron": soft_iron, "hard_iron": deviation[6:9]}
        return sigma if self.gyro_bias is None else sigma | {"gyro_bias": deviation[9:]}

    def export(self, target: str, *, force: bool = False, per_motor: bool = False) -> str:
        """Parameters to paste into "px4", "ardupilot", "vectornav" or "ros"; see `magyc_gtsam.export`.

        Args:
            target: whose parameters.
            force: of a result that must not be trusted, give the values as comments, under DO NOT USE and the reason.
            per_motor: the channels of a current were the outputs, 0 to 1, of motors 1 to 4, by the order of their
                names; ArduPilot compensates for these motor by motor.

        Raises:
            MagycError: the result must not be trusted (without `force`), or the target cannot hold it.
        """
        if not self.trusted:
            if not force:
                raise MagycError(
                    f"the result must not be trusted, so nothing is exported: {self.message or 'not observable'}; "
                    "record again, or see the values as comments (force=True)"
                )
            trusted = replace(self, converged=True, observability=None)
            return do_not_use(self.message or "not observable", trusted.export(target, per_motor=per_motor))
        if self.configuration.get("magnetic_field_unit") == "counts":
            raise MagycError("the calibration is of raw counts, which no instrument takes; calibrate in tesla")
        parts = parts_of(self.terms, self.hard_iron, self.gyro_bias, target, per_motor)
        return export(target, self.soft_iron, **parts._asdict(), compass=self.configuration.get("compass", 1))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self).from_dict, (self.to_dict(),)

    def to_dict(self) -> dict[str, Any]:
        """All fields as JSON types."""
        result: dict[str, Any] = {"format": _FORMAT}
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, np.ndarray):
                value = value.tolist()
            elif isinstance(value, MappingProxyType):
                value = dict(value)
            elif isinstance(value, Observability):
                value = value.to_dict()
            elif f.name == "terms":
                value = [term.to_dict() for term in value]
            result[f.name] = value
        return result

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Calibration:
        """The inverse of `to_dict`."""
        if data.get("format") != _FORMAT:
            raise MagycError(f"not a calibration: format is {data.get('format')!r}, expected {_FORMAT!r}")
        known = {f.name for f in fields(cls)}
        missing = {"soft_iron", "hard_iron"} - data.keys()
        if missing:
            raise MagycError(f"calibration without {' and '.join(sorted(missing))}")
        values = {k: v for k, v in data.items() if k in known}
        if values.get("observability") is not None:
            values["observability"] = Observability.from_dict(values["observability"])
        values["terms"] = tuple(Term.from_dict(term) for term in values.get("terms") or ())
        return cls(**values)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write YAML (.yaml, .yml) or JSON (.json), bit for bit, replacing the file in one step."""
        path = Path(path)
        write_text(path, _dump(path.suffix, self.to_dict()))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Calibration:
        """Read what `save` wrote.

        Raises:
            MagycError: no such file, or not a calibration.
        """
        path = Path(path)
        data = load_mapping(path, "calibration")
        try:
            if data.get("format") == _FORMAT and {"soft_iron", "hard_iron"} <= data.keys():
                check(data)
            return cls.from_dict(data)
        except MagycError as error:
            raise MagycError(f"{path}: {shortened(error)}") from None
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            reason = f"{type(error).__name__}: {shortened(error)}"
            raise MagycError(f"{path}: a damaged calibration ({reason})") from None


def _notebook() -> Any:
    """What draws, which lies above this module and is imported where it is asked for."""
    return importlib.import_module("magyc_gtsam.report.notebook")


def _dump(suffix: str, data: dict[str, Any]) -> str:
    if suffix == ".json":
        return json.dumps(data, indent=2) + "\n"
    if suffix in (".yaml", ".yml"):
        return dump_yaml(data)
    raise MagycError(f"a calibration is saved as .yaml or .json, not as {suffix or 'a file without suffix'!r}")
