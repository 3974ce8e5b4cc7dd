"""`Calibration`: the result of every method; immutable, applied to data, saved and loaded without loss."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy as np
import yaml
from numpy.typing import ArrayLike

from magyc_gtsam.export import export
from magyc_gtsam.factors.corrections import corrected_field, corrected_rate, shifted
from magyc_gtsam.factors.effects import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.signals import Signals, channels_by_kind
from magyc_gtsam.observability import Observability
from magyc_gtsam.recording import Array, Recording

_FORMAT = "magyc-gtsam calibration 1"


@dataclass(frozen=True, eq=False)
class Calibration:
    """Soft iron, hard iron and gyroscope bias: m = soft_iron · u + hard_iron, w = ω + gyro_bias.

    Attributes:
        soft_iron: (3, 3), det 1 unless a field strength was given.
        hard_iron: (3,) T.
        gyro_bias: (3,) rad/s, None where the method does not estimate it.
        covariance: (12, 12) of vech(soft_iron) row by row, hard_iron, gyro_bias, or (9, 9) where gyro_bias is
            None; None where the method has none. Its rank is less by one where det soft_iron = 1 fixed the scale.
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
        shapes = {"soft_iron": (3, 3), "hard_iron": (3,), "gyro_bias": (3,), "covariance": (freedoms, freedoms)}
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is None and name in ("gyro_bias", "covariance"):
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
        """
        given = _signals(magnetic_field, "magnetic_field", signals)
        m = _vectors("magnetic_field", given.pop("magnetic_field"))
        if not self.terms:
            return cast(Array, (m - self.hard_iron) @ np.linalg.inv(self.soft_iron).T)
        rows = np.atleast_2d(m)
        at = _as_signals(len(rows), given)
        if at.rate is not None and self.gyro_bias is not None:
            at = replace(at, rate=corrected_rate(at.rate, self.gyro_bias, self.terms, at))
        field = corrected_field(rows.T, self.soft_iron, self.hard_iron, self.terms, at)
        if given.get("time") is not None:
            field = shifted(at.time, field, self.terms)
        return field.T.reshape(m.shape)

    def apply_gyroscope(self, angular_rate: ArrayLike | Recording, **signals: Any) -> Array:
        """Calibrated angular rate w − gyro_bias, its terms taken out: (N, 3) or (3,) rad/s in and out.

        A recording and `signals` as in `apply`.
        """
        if self.gyro_bias is None:
            raise MagycError(f"method {self.method!r} estimates no gyroscope bias, so there is none to apply")
        given = _signals(angular_rate, "angular_rate", signals)
        w = _vectors("angular_rate", given.pop("angular_rate"))
        if not self.terms:
            return w - self.gyro_bias
        rows = np.atleast_2d(w)
        return corrected_rate(rows.T, self.gyro_bias, self.terms, _as_signals(len(rows), given)).T.reshape(w.shape)

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

    def export(self, target: str) -> str:
        """Parameters to paste into "px4", "ardupilot", "vectornav" or "ros"; see `magyc_gtsam.export`."""
        if self.configuration.get("magnetic_field_unit") == "counts":
            raise MagycError("the calibration is of raw counts, which no instrument takes; calibrate in tesla")
        bias, missing = self.gyro_bias, []
        for term in self.terms:
            if term.name == "axis-order" and bias is not None:
                bias = term.value.reshape(3, 3).T @ bias  # from the magnetometer's axes to the gyroscope's
            if term.side is not None or term.name == "axis-order":  # the others concern the noise
                missing.append(term.name)
        return export(target, self.soft_iron, self.hard_iron, bias, missing)

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
        text = _dump(path.suffix, self.to_dict())
        part = path.with_name(path.name + ".part")
        try:
            part.write_text(text, encoding="utf-8")
            os.replace(part, path)
        except OSError:
            part.unlink(missing_ok=True)
            raise

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Calibration:
        """Read what `save` wrote.

        Raises:
            MagycError: no such file, or not a calibration.
        """
        path = Path(path)
        try:
            text = path.read_text(encoding="utf-8")
            data = json.loads(text) if path.suffix == ".json" else yaml.safe_load(text)
        except FileNotFoundError:
            raise MagycError(f"{path}: no such file") from None
        except OSError as error:
            raise MagycError(f"{path}: cannot be read ({error.strerror})") from None
        except (json.JSONDecodeError, yaml.YAMLError, UnicodeDecodeError) as error:
            raise MagycError(f"{path}: not readable as {path.suffix or 'YAML'} ({error})") from None
        if not isinstance(data, dict):
            raise MagycError(f"{path}: not a calibration")
        try:
            return cls.from_dict(data)
        except MagycError as error:
            raise MagycError(f"{path}: {error}") from None
        except (KeyError, TypeError, ValueError) as error:
            raise MagycError(f"{path}: a damaged calibration ({type(error).__name__}: {error})") from None


def _dump(suffix: str, data: dict[str, Any]) -> str:
    if suffix == ".json":
        return json.dumps(data, indent=2) + "\n"
    if suffix in (".yaml", ".yml"):
        return yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True)
    raise MagycError(f"a calibration is saved as .yaml or .json, not as {suffix or 'a file without suffix'!r}")


def _signals(value: ArrayLike | Recording, name: str, signals: Mapping[str, Any]) -> dict[str, Any]:
    """`name` and the other signals, from a recording or as given."""
    known = ("time", "magnetic_field", "angular_rate", "acceleration", "channels")
    if isinstance(value, Recording):
        return {k: getattr(value, k) for k in known} | dict(signals)
    unknown = sorted(signals.keys() - set(known))
    if unknown:
        raise MagycError(f"apply: no signal {', '.join(map(repr, unknown))}; there are {', '.join(known)}")
    return {**signals, name: value}


def _as_signals(rows: int, given: Mapping[str, Any]) -> Signals:
    def columns(name: str) -> Array | None:
        return None if given.get(name) is None else np.atleast_2d(_vectors(name, given[name])).T

    time = np.full(rows, np.nan) if given.get("time") is None else np.asarray(given["time"], dtype=np.float64)
    channels = channels_by_kind(given.get("channels") or {})
    return Signals(
        time,
        rate=columns("angular_rate"),
        acceleration=columns("acceleration"),
        channels={kind: np.stack([_filled(time, row) for row in value]) for kind, value in channels.items()},
    )


def _filled(time: Array, row: Array) -> Array:
    """A channel without its gaps: between its samples on a line, all of it 0 where there are none."""
    known = np.isfinite(row)
    if known.all() or not np.isfinite(time).all():
        return row
    return np.interp(time, time[known], row[known]) if known.any() else np.zeros_like(row)


def _vectors(name: str, value: ArrayLike) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.ndim not in (1, 2) or array.shape[-1] != 3:
        raise MagycError(f"{name}: shape {array.shape}, expected (N, 3) or (3,)")
    return array
