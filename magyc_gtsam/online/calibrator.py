"""`OnlineCalibrator`: samples in, one at a time or in blocks; a calibration out at any moment."""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.gauge import check_field_strength
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.lazy import requires_gtsam
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.one_thread import one_thread
from magyc_gtsam.online import state_file
from magyc_gtsam.online.engine import Change, Engine, Progress
from magyc_gtsam.online.faults import refusal, with_faults, with_left_out
from magyc_gtsam.online.intake import Intake, vector
from magyc_gtsam.recording import Array
from magyc_gtsam.sensor_faults.faults import SensorFaults

_ENGINES = {  # method → "module:class"; the class takes the method's options as keywords
    "smoother": "magyc_gtsam.online.smoother:OnlineSmoother",
    "magyc-ifg": "magyc_gtsam.online.magyc_ifg:IncrementalMagyc",
}

_TOGETHER = 16  # single samples taken at a time


class OnlineCalibrator:
    """Calibrates while the vehicle moves; time per update and memory do not grow with the mission.

        online = OnlineCalibrator()
        online.update(time, magnetic_field, angular_rate)   # one sample or a block, again and again
        online.calibration, online.converged, online.progress.sentence
        online.save("online.npz"); online = OnlineCalibrator.load("online.npz")

    Args:
        method: "smoother" (maximum likelihood) or "magyc-ifg" (the MAGYC paper's incremental factor graph).
        options: the method's own, online in the saved state.

    Raises:
        MagycError: unknown method or option.
    """

    def __init__(self, method: str = "smoother", **options: Any) -> None:
        if method not in _ENGINES:
            raise MagycError(f"method: {method!r} is not one of {', '.join(_ENGINES)}")
        module, name = _ENGINES[method].split(":")
        with requires_gtsam(f"method {method!r}"):
            engine = getattr(importlib.import_module(module), name)
        allowed = engine.__init__.__kwdefaults__ or {}
        unknown = sorted(options.keys() - allowed.keys())
        if unknown:
            raise MagycError(
                f"method {method!r} has no option {', '.join(map(repr, unknown))}; it has {', '.join(sorted(allowed))}"
            )
        check_field_strength(options.get("field_strength"))
        self.method = method
        # An earlier calibration is kept as its JSON types, for the state file.
        self.options = {k: v.to_dict() if isinstance(v, Calibration) else v for k, v in options.items()}
        self._engine: Engine = engine(**options)
        self._intake = Intake()
        self._faults = SensorFaults()
        self._waiting: list[tuple[float, Array, Array]] = []  # single samples, taken together

    def update(
        self, time: ArrayLike, magnetic_field: ArrayLike | None = None, angular_rate: ArrayLike | None = None
    ) -> None:
        """Take one sample or a block.

        Sensors with stamps of their own come in calls of their own, the other argument left None
        (`update(t, field)`, `update(t, angular_rate=rate)`), or as rows of NaN where a sensor has no sample. A
        sensor may start late or pause, but of what one sensor measures alone only the last minute is kept. Each
        sensor's stamps must ascend; a sample whose stamp repeats or is late by less than a second is left out and
        counted (`progress.left_out`). Single samples are taken sixteen at a time, or when something is read; so an
        error may be raised that many samples late.

        Args:
            time: s, scalar or (N,).
            magnetic_field: T, (3,) or (N, 3).
            angular_rate: rad/s, (3,) or (N, 3).

        Raises:
            MagycError: wrong shapes or units, or a clock that was set back. Nothing of the block is taken then.
        """
        if isinstance(time, (float, int)) or np.ndim(time) == 0:
            stamp = float(np.asarray(time, dtype=np.float64))
            self._waiting.append(
                (stamp, vector("magnetic_field", magnetic_field), vector("angular_rate", angular_rate))
            )
            if len(self._waiting) >= _TOGETHER:
                self._catch_up()
            return
        self._catch_up()
        self._take(time, magnetic_field, angular_rate)

    def _catch_up(self) -> None:
        """Take the single samples that wait."""
        if self._waiting:
            rows, self._waiting = self._waiting, []
            self._take(*(np.array(column) for column in zip(*rows, strict=True)))

    @one_thread
    def _take(self, time: ArrayLike, magnetic_field: ArrayLike | None, angular_rate: ArrayLike | None) -> None:
        magnetometer, gyroscope = self._intake.take(time, magnetic_field, angular_rate)
        self._engine.update(*self._faults.take(magnetometer, gyroscope, self._intake.repeated))

    @property
    @one_thread
    def calibration(self) -> Calibration | None:
        """The current estimate with its covariance, `converged` and `message`; None before there is one."""
        self._catch_up()
        return with_left_out(self._engine.calibration(), self._faults, self._intake.duration)

    @property
    @one_thread
    def converged(self) -> bool:
        """Whether the estimate may be used: its covariance is within limits and it has stood still."""
        self._catch_up()
        return self._engine.converged() and not refusal(self._faults)

    @property
    @one_thread
    def progress(self) -> Progress:
        """How far it is, what is weak, and the motion that helps."""
        self._catch_up()
        return with_faults(self._intake.counted(self._engine.progress()), self._faults)

    @property
    def field(self) -> Array:
        """(n, 3) T, the magnetometer's samples that are kept, or a part of them; a copy."""
        self._catch_up()
        return self._engine.field().copy()

    @property
    def changes(self) -> tuple[Change, ...]:
        """Steps in hard iron found so far, oldest first."""
        self._catch_up()
        return self._engine.changes()

    @property
    def taken_until(self) -> tuple[float, float]:
        """s, stamps of the last sample taken of magnetometer and gyroscope; −inf before the first.

        Where a run that was saved goes on: samples up to these are in it.
        """
        self._catch_up()
        return self._intake.until

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the whole state to one file, replacing it in one step: a kill at any moment loses nothing saved."""
        self._catch_up()
        state_file.write(path, self.method, self.options, self._state())

    def _state(self) -> dict[str, Array]:
        parts = {
            "engine": self._engine.state(),
            "intake": self._intake.state(),
            "faults": self._faults.state(),
        }
        return {f"{part}/{name}": value for part, state in parts.items() for name, value in state.items()}

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> OnlineCalibrator:
        """Continue from what `save` wrote, bit for bit like a run that was never interrupted.

        Raises:
            MagycError: no such file, not a saved state, or one of another version.
        """
        method, options, state = state_file.read(path)
        try:
            # What fits together only in its shapes shows when it is asked; on another one, since asking may fit.
            cls._restored(method, options, state).progress  # noqa: B018
            result = cls._restored(method, options, state)
        except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
            raise MagycError(
                f"{path}: the state of method {method!r} in it is incomplete or damaged ({shortened(error)}); "
                "remove it and begin a new one"
            ) from None
        return result

    @classmethod
    def _restored(cls, method: str, options: Mapping[str, Any], state: Mapping[str, Any]) -> OnlineCalibrator:
        result = cls(method, **options)
        state_file.compare(result._state(), state)
        parts = (("engine/", result._engine), ("intake/", result._intake), ("faults/", result._faults))
        for part, owner in parts:
            owner.restore({k.removeprefix(part): v for k, v in state.items() if k.startswith(part)})
        state_file.compare(state, result._state())
        return result
