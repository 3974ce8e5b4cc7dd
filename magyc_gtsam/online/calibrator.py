"""`OnlineCalibrator`: takes samples singly or in blocks and returns a calibration at any time."""

from __future__ import annotations

import importlib
import os
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.gauge import check_field_strength
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.lazy import requires_gtsam
from magyc_gtsam.factors.one_thread import one_thread
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.observability import cells
from magyc_gtsam.online.arguments import scalar, vector
from magyc_gtsam.online.chance_repeats import ChanceRepeats
from magyc_gtsam.online.engine import Change, Engine, Progress, refusal, with_faults, with_left_out
from magyc_gtsam.online.intake import Intake
from magyc_gtsam.online.locked import locked
from magyc_gtsam.recording import Array, Samples
from magyc_gtsam.recording.fingerprint import RunningFingerprint, first_shared
from magyc_gtsam.recording.stamps import seconds
from magyc_gtsam.sensor_faults.faults import SensorFaults
from magyc_gtsam.storage.array_file import expect_layout, read_arrays, write_arrays
from magyc_gtsam.storage.json_types import json_types

_ENGINES = {  # method → "module:class"; the class takes the method's options as keywords
    "smoother": "magyc_gtsam.online.smoother:OnlineSmoother",
    "magyc-ifg": "magyc_gtsam.online.magyc_ifg:IncrementalMagyc",
}
_TOGETHER = 16  # number of single samples that are processed together
_MOST_DIRECTIONS = 2000  # largest number of samples whose directions count as visited
_FORMAT = "magyc-gtsam online state 22"


class OnlineCalibrator:
    """Calibrates while the vehicle moves, with time per update and memory independent of the mission's length.

        online = OnlineCalibrator()
        online.update(time, magnetic_field, angular_rate)   # one sample or a block, again and again
        online.calibration, online.converged, online.progress.sentence
        online.save("online.npz"); online = OnlineCalibrator.load("online.npz")

    Several threads may use it at the same time.

    Args:
        method: "smoother" (maximum likelihood) or "magyc-ifg" (the MAGYC paper's incremental factor graph).
        options: options of the method; they become part of the saved state.

    Raises:
        MagycError: the method or an option is unknown.
    """

    def __init__(self, method: str = "smoother", **options: Any) -> None:
        if not isinstance(method, str) or method not in _ENGINES:
            raise MagycError(f"method: {method!r:.60} is not one of {', '.join(_ENGINES)}")
        module, name = _ENGINES[method].split(":")
        with requires_gtsam(f"method {method!r}"):
            engine = getattr(importlib.import_module(module), name)
        unknown = sorted(options.keys() - engine.options)
        if unknown:
            there = ", ".join(sorted(engine.options))
            raise MagycError(f"method {method!r} has no option {', '.join(map(repr, unknown))}; it has {there}")
        check_field_strength(options.get("field_strength"))
        self._lock = threading.RLock()
        self.method = method
        # The state file needs an earlier calibration as JSON types.
        self.options = json_types(options, finite=False)
        self._engine: Engine = engine(**options)
        self._intake = Intake(options.get("gyroscope_axes", "x,y,z"))
        self._repeats = ChanceRepeats()
        self._faults = SensorFaults()
        self._samples = RunningFingerprint()
        self._read: Calibration | None = None  # the calibration that was read since the last sample
        earlier = self.options.get("prior") or {}
        self._before: list[str] = list(earlier.get("diagnostics", {}).get("recordings", ()))
        self._waiting: list[tuple[float, Array, Array]] = []  # single samples not yet taken

    @locked
    def update(
        self, time: ArrayLike, magnetic_field: ArrayLike | None = None, angular_rate: ArrayLike | None = None
    ) -> None:
        """Take one sample or a block.

        Sensors with separate stamps are passed in separate calls (`update(t, field)`, `update(t, angular_rate=rate)`),
        or with rows of NaN where a sensor has no sample. A sensor may start late or pause, but while only one sensor
        has samples, only the last minute of them is kept. The stamps of each sensor must ascend; a sample whose stamp
        repeats or is late is left out and counted (`progress.left_out`). Single samples are taken sixteen at a time, or
        when a result is read, so that an error may be raised up to sixteen samples late.

        Args:
            time: s, scalar or (N,); or datetime64, datetime or pandas stamps, which become s since 1970.
            magnetic_field: T, (3,) or (N, 3).
            angular_rate: rad/s, (3,) or (N, 3).

        Raises:
            MagycError: shapes or units are wrong, or a clock was set back. No sample of the block is taken then.
        """
        if isinstance(time, (float, int)) or np.ndim(time := seconds("time", time)) == 0:
            stamp = scalar("time", time)
            self._waiting.append(
                (stamp, vector("magnetic_field", magnetic_field), vector("angular_rate", angular_rate))
            )
            if len(self._waiting) >= _TOGETHER:
                self._catch_up()
            return
        try:
            self._catch_up()
        finally:  # an error of earlier samples must not cost the block
            self._take(time, magnetic_field, angular_rate)

    def _catch_up(self) -> None:
        """Take the single samples that are waiting.

        Raises:
            MagycError: some cannot be taken, as where a clock was set back; the others are.
        """
        if not self._waiting:
            return
        rows, self._waiting = self._waiting, []
        started = np.isfinite(self._intake.until).any()
        try:
            taken = self._intake.take(*(np.array(column) for column in zip(*rows, strict=True)))
        except MagycError as problem:
            if started:  # before the first sample, a wrong unit is in all of them
                for row in rows:
                    with suppress(MagycError):
                        self._take(*(np.array([each]) for each in row))
            raise problem from None
        self._pass_on(*taken)

    def _take(self, time: ArrayLike, magnetic_field: ArrayLike | None, angular_rate: ArrayLike | None) -> None:
        self._pass_on(*self._intake.take(time, magnetic_field, angular_rate))

    @one_thread
    def _pass_on(self, magnetometer: Samples, gyroscope: Samples) -> None:
        self._read = None
        self._samples.take(magnetometer.value)
        fresh, repeated = self._repeats.take(magnetometer)
        passed, gyroscope = self._faults.take(fresh, gyroscope, repeated)
        self._engine.update(self._repeats.put_back(passed, self._faults.magnetometer.pending), gyroscope)

    @property
    def _counted_twice(self) -> str:
        """Why the earlier calibration must not be used; "" if it has no samples of this run."""
        if not self._before or first_shared(self._samples.text, self._before) is None:
            return ""
        return "the earlier calibration has samples of this run, which count twice: start anew without it (prior=)"

    @property
    @locked
    @one_thread
    def calibration(self) -> Calibration | None:
        """The current estimate with covariance, `converged` and `message`; None before there is one.

        Its verdict, `trusted`, is that of the batch method on the samples so far. Use it where it is trusted and
        `OnlineCalibrator.converged` is true: before, the estimate may still change.
        """
        self._catch_up()
        if self._read is not None:
            return self._read
        calibration = with_left_out(self._engine.calibration(), self._faults, self._intake.duration)
        if calibration is None:
            return None
        of_these = {"recordings": [*self._before, self._samples.text]}
        calibration = replace(calibration, diagnostics={**calibration.diagnostics, **of_these})
        twice = self._counted_twice
        self._read = replace(calibration, converged=False, message=twice) if twice else calibration
        return self._read

    @property
    @locked
    @one_thread
    def converged(self) -> bool:
        """Whether the estimate has settled: it was trusted at the last refit, which changed it little.

        It costs nothing at every sample; `calibration.trusted` takes the newest samples into account as well.
        """
        self._catch_up()
        settled = self._engine.converged() and not self._intake.silence
        return settled and not refusal(self._faults) and not self._counted_twice

    @property
    @locked
    @one_thread
    def progress(self) -> Progress:
        """The progress, the weak directions and the motion that helps."""
        self._catch_up()
        progress = replace(self._engine.progress(), coverage=self._coverage())
        progress = with_faults(self._intake.counted(progress), self._faults)
        twice = self._counted_twice
        return replace(progress, converged=False, sentence=twice) if twice else progress

    def _coverage(self) -> float:
        """Return the share of 60 equal cells of the sphere that the calibrated field visited."""
        calibration, field = self._engine.calibration(), self._engine.field()
        if calibration is None:
            return 0.0
        direction = calibration.corrected(field[:: max(len(field) // _MOST_DIRECTIONS, 1)])
        direction /= np.maximum(np.linalg.norm(direction, axis=1), 1e-300)[:, None]
        return float(cells(direction).mean())

    @property
    @locked
    def field(self) -> Array:
        """A copy of the magnetometer samples (n, 3) T that are kept, or of a part of them."""
        self._catch_up()
        return self._engine.field().copy()

    @property
    @locked
    def changes(self) -> tuple[Change, ...]:
        """The steps in hard iron found so far, oldest first."""
        self._catch_up()
        return self._engine.changes()

    @property
    @locked
    def taken_until(self) -> tuple[float, float]:
        """The stamps, s, of the last sample taken of magnetometer and gyroscope; −inf before the first.

        A saved run continues after these stamps.
        """
        self._catch_up()
        return self._intake.until

    @property
    @locked
    def fingerprint(self) -> str:
        """The fingerprint of the magnetometer samples so far; see `magyc_gtsam.recording.fingerprint`."""
        self._catch_up()
        return self._samples.text

    @locked
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the whole state to one file, replacing it atomically, so that an interruption loses no saved state."""
        self._catch_up()
        header = {"format": _FORMAT, "method": self.method, "options": self.options}
        write_arrays(path, header, self._state())

    @property
    def _parts(self) -> dict[str, Engine | Intake | ChanceRepeats | SensorFaults | RunningFingerprint]:
        """The parts whose states together are that of the calibrator."""
        return {
            "engine": self._engine,
            "intake": self._intake,
            "repeats": self._repeats,
            "faults": self._faults,
            "samples": self._samples,
        }

    def _state(self) -> dict[str, Array]:
        return {
            f"{part}/{name}": value for part, owner in self._parts.items() for name, value in owner.state().items()
        }

    @locked
    def __reduce__(self) -> tuple[Any, ...]:  # copies and pickles as `save` and `load` do
        self._catch_up()
        return OnlineCalibrator._restored, (self.method, self.options, self._state())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> OnlineCalibrator:
        """Return the calibrator that `save` wrote; it continues bit for bit like an uninterrupted run.

        Raises:
            MagycError: the file does not exist, or is not a saved state of this version.
        """
        what = "the state of an online calibration"
        header, state = read_arrays(path, _FORMAT, what, "OnlineCalibrator.load")
        method, options = header.get("method"), header.get("options")
        if not isinstance(method, str) or not isinstance(options, dict):
            raise MagycError(f"{path}: not {what} (no method or options in it)")
        try:
            # Reading the progress reveals a state whose shapes match but whose values do not. It may change the state,
            # so the result is restored again.
            cls._restored(method, options, state).progress  # noqa: B018
            return cls._restored(method, options, state)
        except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
            raise MagycError(
                f"{path}: the state of method {method!r} in it is incomplete or damaged ({shortened(error)}); "
                "remove the file and start a new run"
            ) from None

    @classmethod
    def _restored(cls, method: str, options: Mapping[str, Any], state: Mapping[str, Any]) -> OnlineCalibrator:
        result = cls(method, **options)
        expect_layout(result._state(), state)
        for part, owner in result._parts.items():
            owner.restore({k.removeprefix(f"{part}/"): v for k, v in state.items() if k.startswith(f"{part}/")})
        expect_layout(state, result._state())
        return result
