"""The class `Calibration`."""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.calibration.elsewhere import on_recording, warn_of
from magyc_gtsam.calibration.limits import checked, warn_if_implausible
from magyc_gtsam.calibration.serialization import as_mapping, as_text, constructor_arguments
from magyc_gtsam.calibration.signals import as_signals, check_axes, check_field_units, given_signals, vectors
from magyc_gtsam.export import exported
from magyc_gtsam.factors.effects.corrections import corrected_field, corrected_rate
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.observability import Observability
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.storage.files import expect_path, write_text
from magyc_gtsam.storage.mapping import load_mapping


@dataclass(frozen=True, eq=False, repr=False)
class Calibration:
    """Soft iron, hard iron and gyroscope bias: m = soft_iron · u + hard_iron, w = ω + gyro_bias.

    Attributes:
        soft_iron: (3, 3), det 1 unless a field strength was given.
        hard_iron: (3,) T.
        gyro_bias: (3,) rad/s; None if the method does not estimate it.
        covariance: (12, 12) of vech(soft_iron) row by row, hard_iron, gyro_bias, or (9, 9) if gyro_bias is None;
            None if the method gives none. It covers the sensors' noise and the model error. Its rank is one less
            where det soft_iron = 1 fixed the scale.
        noise_covariance: the part of `covariance` that is due to the sensors' noise, of the same shape; None if the
            method does not separate it.
        delay: s by which the magnetometer lags the gyroscope; 0 if fixed or not estimated.
        delay_sigma: s, standard deviation of `delay`; None if fixed or not estimated.
        terms: extra effects beyond the twelve parameters; empty for the base model.
        converged: whether the method met its stopping rule and the result is observable.
        message: why the method stopped, or why the result must not be trusted.
        method: the method's name in `magyc_gtsam.methods()`.
        noise: standard deviation per sample: {"magnetic_field": T, "angular_rate": rad/s}.
        field_strength: T, strength of the calibrated field; measured unless it was given.
        observability: which parameters the motion determined; None if unknown.
        diagnostics: numbers specific to the method (cost, iterations, weights, …), JSON types only.
        configuration: the options of the run, which `calibrate` takes back, and what describes its recording.
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
        put = object.__setattr__  # the dataclass is frozen
        if self.covariance is None:  # `noise_covariance` is a part of it
            put(self, "noise_covariance", None)
        try:
            arrays = checked(self)
        except MagycError as problem:
            raise MagycError(f"calibration: {problem}") from None
        for name, array in arrays.items():
            put(self, name, array)
        put(self, "converged", bool(self.converged))
        for name in ("noise", "diagnostics", "configuration"):
            put(self, name, MappingProxyType(dict(getattr(self, name))))

    def apply(self, magnetic_field: ArrayLike | Recording, **signals: Any) -> Array:
        """Return the calibrated field soft_iron⁻¹ (m − hard_iron), without the effects in `terms`.

        Each value belongs to its reading. A delay of the magnetometer (a `timing` term) is an error of its stamps and
        changes no value: the field of a reading is that at its stamp minus `delay`, as `magyc-gtsam apply` writes it.

        Args:
            magnetic_field: (N, 3) or (3,) T, or a whole recording, which holds the signals that `terms` need.
            signals: signals that `terms` need, unless a recording is given: time (N,) as in a `Recording`,
                angular_rate and acceleration (N, 3), channels {name: (N,) or (N, k)}.

        Returns:
            (N, 3) or (3,) T, as the input; with a `misalignment` or exchanged axes (`axis-order`) in the gyroscope's
            axes, unless one of these is reversed, so that they are not a right-handed frame.

        Raises:
            MagycError: wrong shape or lengths, a recording in another unit than the calibration (counts, tesla), or
                with `terms` its gyroscope in other axes, or a term needs a signal that is missing, or the rows before
                a single one.

        Warns:
            UserWarning: the median strength of the result is outside 8 to 175 µT; or a recording is not the one in
                which a dated term was found (a jump counts as set in, others are left out), or lacks a channel that
                a term follows for some time.
        """
        if self.terms:
            check_axes(magnetic_field, self.configuration)
        held, notes = on_recording(self, magnetic_field)
        field: Array = held._corrected(magnetic_field, signals)
        warn_of(notes)
        if self.magnetic_field_unit == "T":
            warn_if_implausible(field)
        return field

    def corrected(self, magnetic_field: ArrayLike | Recording, **signals: Any) -> Array:
        """Return the result of `apply` without its warnings, for callers that judge or show the strength."""
        return cast(Array, on_recording(self, magnetic_field)[0]._corrected(magnetic_field, signals))

    def _corrected(self, magnetic_field: ArrayLike | Recording, signals: dict[str, Any]) -> Array:
        """Return the calibrated field with all terms, whichever recording they were found in."""
        check_field_units(magnetic_field, self.magnetic_field_unit)
        given = given_signals(magnetic_field, "magnetic_field", signals)
        m = vectors("magnetic_field", given.pop("magnetic_field"))
        rows = np.atleast_2d(m)
        at = as_signals("magnetic_field", len(rows), given, self.terms)
        if not self.terms:
            return cast(Array, (m - self.hard_iron) @ np.linalg.inv(self.soft_iron).T)
        if at.rate is not None and self.gyro_bias is not None:
            at = replace(at, rate=corrected_rate(at.rate, self.gyro_bias, self.terms, at))
        return corrected_field(rows.T, self.soft_iron, self.hard_iron, self.terms, at).T.reshape(m.shape)

    def apply_gyroscope(self, angular_rate: ArrayLike | Recording, **signals: Any) -> Array:
        """Return the calibrated angular rate w − gyro_bias, without the effects in `terms`.

        Args:
            angular_rate: (N, 3) or (3,) rad/s in the axes of the recording that was calibrated, which with
                `gyroscope_axes` are not those in which the sensor delivers it; or a whole recording.
            signals: as in `apply`.

        Returns:
            (N, 3) or (3,) rad/s, as the input, in the axes of the field that `apply` returns.

        Raises:
            MagycError: the method estimates no gyroscope bias, a recording in other gyroscope axes, wrong shape or
                lengths, or a term needs a signal that is missing, or the rows before a single one.

        Warns:
            UserWarning: as `apply`, of terms.
        """
        if self.gyro_bias is None:
            raise MagycError(f"method {self.method!r} does not estimate a gyroscope bias; choose one that does")
        check_axes(angular_rate, self.configuration)
        held, notes = on_recording(self, angular_rate)
        warn_of(notes)
        given = given_signals(angular_rate, "angular_rate", signals)
        w = vectors("angular_rate", given.pop("angular_rate"))
        rows = np.atleast_2d(w)
        at = as_signals("angular_rate", len(rows), given, held.terms)
        if not held.terms:
            return cast(Array, w - held.gyro_bias)
        return corrected_rate(rows.T, held.gyro_bias, held.terms, at).T.reshape(w.shape)

    @property
    def recording(self) -> Recording | None:
        """The recording that was calibrated; None after loading, pickling or `dataclasses.replace`."""
        return cast("Recording | None", self.__dict__.get("_recording"))

    def made_from(self, recording: Recording) -> Calibration:
        """Store the recording for `plot` and `report`, and return this calibration."""
        object.__setattr__(self, "_recording", recording)
        return self

    def plot(self, recording: Recording | None = None) -> Any:
        """Draw the field before and after calibration as a matplotlib figure.

        Args:
            recording: the data to draw; None for `self.recording`.

        Raises:
            MagycError: no recording is known.
        """
        return _notebook().plot_calibration(self, recording)

    def report(self, path: str | os.PathLike[str], recording: Recording | None = None) -> Path:
        """Write the report as a page (.html) or its figures (.pdf), and return the path.

        Args:
            path: the file; or a folder, which receives report.html.
            recording: the data to report on; None for `self.recording`.

        Raises:
            MagycError: no recording is known, a name with another suffix, or the file cannot be written.
        """
        return cast(Path, _notebook().report(self, path, recording))

    @property
    def fitted_to(self) -> tuple[str, ...]:
        """The fingerprints of the recordings that it is from, its prior's too; empty if they are not known."""
        return tuple(self.diagnostics.get("recordings", ()))

    def __repr__(self) -> str:
        state = "trusted" if self.trusted else "not to be trusted"
        scale, unit = (1e6, "µT") if self.magnetic_field_unit == "T" else (1.0, "counts")
        iron = ", ".join(f"{value * scale:.2f}" for value in self.hard_iron)
        return f"Calibration({self.method!r}, {state}, hard iron ({iron}) {unit})"

    def _repr_html_(self) -> str:
        return cast(str, _notebook().html_of(self))

    @property
    def magnetic_field_unit(self) -> str:
        """Unit of the field that was calibrated, "T" or "counts"."""
        return "counts" if self.configuration.get("magnetic_field_unit") == "counts" else "T"

    @property
    def trusted(self) -> bool:
        """Whether the method converged and the motion determined the parameters."""
        return self.converged and (self.observability is None or self.observability.observable)

    @property
    def sigma(self) -> Mapping[str, Array]:
        """Standard deviations of soft_iron (3, 3), hard_iron (3,), gyro_bias (3,) if any; empty without covariance."""
        if self.covariance is None:
            return {}
        deviation = np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))
        soft_iron = np.empty((3, 3))
        upper = np.triu_indices(3)
        soft_iron[upper] = deviation[:6]
        soft_iron.T[upper] = deviation[:6]
        sigma = {"soft_iron": soft_iron, "hard_iron": deviation[6:9]}
        return sigma if self.gyro_bias is None else sigma | {"gyro_bias": deviation[9:]}

    def export(
        self, target: str, *, force: bool = False, per_motor: bool = False, battery_voltage: float | None = None
    ) -> str:
        """Return the parameters to paste into an autopilot, instrument or driver; see `magyc_gtsam.export`.

        They are those at the end of the log: with the jumps of iron and bias that `terms` hold.

        Args:
            target: "px4", "ardupilot", "vectornav" or "ros".
            force: return the values of a result that must not be trusted, too, as comments under DO NOT USE.
            per_motor: the channels of current are the outputs, 0 to 1, of motors 1 to 4 in the order of their names.
            battery_voltage: V, in the log; ArduPilot multiplies the outputs by it, so that `per_motor` needs it.

        Raises:
            MagycError: the result must not be trusted (without `force`), or the target cannot represent it.
        """
        return exported(self, target, force, per_motor, battery_voltage)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self).from_dict, (self.to_dict(),)

    def to_dict(self) -> dict[str, Any]:
        """Return all fields as JSON types."""
        return as_mapping(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Calibration:
        """Build a calibration from the result of `to_dict`.

        Raises:
            MagycError: `data` is not a calibration.
        """
        try:
            return cls(**constructor_arguments(cls, data))
        except MagycError:
            raise
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise MagycError(f"a damaged calibration ({type(error).__name__}: {shortened(error)})") from None

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write YAML (.yaml, .yml) or JSON (.json) without loss, replacing the file in one step."""
        file = expect_path("save", path)
        write_text(file, as_text(file.suffix, self.to_dict()))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Calibration:
        """Read a file that `save` wrote.

        Raises:
            MagycError: the file does not exist or is not a calibration.
        """
        data = load_mapping(expect_path("Calibration.load", path), "calibration")
        try:
            return cls.from_dict(data)
        except MagycError as error:
            raise MagycError(f"{path}: {shortened(error)}") from None


def _notebook() -> Any:
    """Import the module that draws calibrations; it lies above this one in the layers, hence not at the top."""
    return importlib.import_module("magyc_gtsam.report.notebook")
