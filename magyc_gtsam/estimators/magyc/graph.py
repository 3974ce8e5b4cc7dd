"""The factor graph of MAGYC-IFG (section III-C), which adds one window at a time and updates the estimate after each.

There are two implementations with the same estimate. As published, iSAM2 keeps two factors per window on one state,
and therefore relinearises all of them at every update: time and memory grow. Compressed, one factor represents all
residuals (7) exactly and is replaced at every update: time and memory stay constant.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gtsam
import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.magyc.derivative_windows import LEAST_WINDOWS
from magyc_gtsam.estimators.magyc.options import IncrementalOptions
from magyc_gtsam.estimators.magyc.state import KEYS, NAMES, MagycState, calibration_of, initial_values, scale_prior
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.gyro_derivative import CompressedGyroDerivative, gyro_derivative_factor
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.runners.incremental import Incremental
from magyc_gtsam.runners.status import IncrementalResult, Status

LAST_SHARE = 0.2
_MOST = 1024  # running sums kept; exact up to that many estimates, then to a 500th of the series


class EstimateHistory:
    """The mean over the last fifth of a growing series, which the paper reports, in constant memory.

    It holds running sums of the estimates (width,), thinned as their number grows.

    Args:
        width: number of elements of an estimate.
    """

    def __init__(self, width: int) -> None:
        self._counts = np.zeros(1)
        self._sums = np.zeros((1, width))
        self._count, self._sum, self._every = 0, np.zeros(width), 1

    def __len__(self) -> int:
        return self._count

    def add(self, estimate: Array) -> None:
        """Add the next estimate."""
        self._count += 1
        self._sum = self._sum + estimate
        if self._count % self._every == 0:
            self._counts = np.append(self._counts, self._count)
            self._sums = np.vstack([self._sums, self._sum])
        if len(self._counts) > _MOST:
            self._every *= 2
            kept = self._counts % self._every == 0
            self._counts, self._sums = self._counts[kept], self._sums[kept]

    def mean(self) -> Array:
        """Return the mean (width,) over the last fifth, which includes at least the last estimate."""
        since = self._count - max(int(LAST_SHARE * self._count), 1)
        place = int(np.searchsorted(self._counts, since, side="right")) - 1
        result: Array = (self._sum - self._sums[place]) / (self._count - self._counts[place])
        return result

    def state(self) -> Mapping[str, Array]:
        """Return the state for `restore`."""
        return {
            "counts": self._counts,
            "sums": self._sums,
            "last": np.array([self._count, self._every, *self._sum]),
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        self._counts, self._sums = state["counts"], state["sums"]
        self._count, self._every, self._sum = int(state["last"][0]), int(state["last"][1]), state["last"][2:]


_RENEWED = 64  # windows after which iSAM2 restarts at its estimate, which bounds the windows in its state
_PARTS = [3, 6]  # where to split a window (9,) into field, derivative and rate


class MagycGraph:
    """The graph, its estimate, and the mean over the last fifth of the estimates, which the paper reports.

    Args:
        options: the options; None takes the defaults.
    """

    def __init__(self, options: IncrementalOptions | None = None) -> None:
        self.options = IncrementalOptions() if options is None else options
        self._held: tuple[int, ...] = ()  # handles of the compressed factor and its prior
        self._waiting: list[Array] = []  # windows not yet in iSAM2
        self._windows: list[Array] = []  # (9,) each; if compressed, only those since the restart
        self._residuals = CompressedGyroDerivative.empty()
        self._values = initial_values()
        self._history = EstimateHistory(12)
        self._result = IncrementalResult(Status.INDETERMINATE, f"fewer than {LEAST_WINDOWS} windows so far")
        self._renew()

    def add(self, magnetic_field: Array, derivative: Array, angular_rate: Array) -> IncrementalResult:
        """Add the next window, (3,) gauss, gauss/s and rad/s, and update the estimate."""
        if self._since_renewal == _RENEWED:
            self._renew()
        window = np.concatenate([magnetic_field, derivative, angular_rate])
        self._windows.append(window)
        self._waiting.append(window)
        self._since_renewal += 1
        self._residuals = self._residuals.update(magnetic_field, derivative, angular_rate)
        if len(self) < LEAST_WINDOWS:
            return self._result
        self._result = self._step()
        if self._result.updated:
            self._values = self._runner.values
            estimate = _parameters(MagycState.of(self._values))
            if estimate is not None:
                self._history.add(estimate)
        return self._result

    def _step(self) -> IncrementalResult:
        options = self.options
        if options.compressed:
            factors = [
                self._residuals.factor(*KEYS, options.residual_sigma),
                scale_prior(options.prior, options.prior_sigma, len(self)),
            ]
        else:
            factors = [
                factor
                for m, derivative, w in (np.split(window, _PARTS) for window in self._waiting)
                for factor in (
                    gyro_derivative_factor(*KEYS, m, derivative, w, options.residual_sigma, robust=options.robust),
                    scale_prior(options.prior, options.prior_sigma),
                )
            ]
        result = self._runner.update(factors, self._values, remove=self._held)
        if result.updated:
            self._waiting = []
            if self.options.compressed:
                self._held = result.factors
        return result

    def _renew(self) -> None:
        """Restart iSAM2 at its own estimate, where all factors are linearised at every step anyway."""
        self._runner = Incremental(self.options.optimizer, names=NAMES)
        self._held = ()
        if self.options.compressed:
            self._windows = []
        self._waiting = list(self._windows)
        self._since_renewal = 0
        self._at_renewal = (self._residuals, self._values)

    def __len__(self) -> int:
        return self._residuals.samples

    @property
    def result(self) -> IncrementalResult:
        """The result of the last update."""
        return self._result

    @property
    def message(self) -> str:
        """The progress in words."""
        result = self._result
        last = f"the last moved the estimate by {result.step:.1g}" if result.updated else result.message
        return f"{len(self)} windows, {last}"

    @property
    def residuals(self) -> CompressedGyroDerivative:
        """All residuals (7) so far, equally weighted."""
        return self._residuals

    @property
    def state(self) -> MagycState:
        """The current (C, d, b)."""
        return MagycState.of(self._values)

    def current(self) -> Array | None:
        """Return (12,) vech(soft iron) at determinant 1, hard iron T and gyroscope bias; None if C is not valid."""
        return _parameters(self.state) if len(self._history) else None

    def mean(self) -> Array | None:
        """Return the mean over the last 20 % of the estimates, which the paper reports; None without estimates."""
        return self._history.mean() if len(self._history) else None

    def estimate(self) -> Array | None:
        """Return the estimate that the options ask for, `mean` or `current`."""
        return self.mean() if self.options.estimate == "mean" else self.current()

    def calibration(self, parameters: Array, recording: Recording, **diagnostics: Any) -> Calibration:
        """Return the calibration by the estimate `parameters`, assessed on a recording, with more diagnostics."""
        updated = self._result.updated
        return calibration_of(
            parameters,
            self.state.covariance(self._residuals) if updated else None,
            recording,
            method="magyc-ifg",
            message=self.message,
            converged=updated,
            field_strength=self.options.field_strength,
            diagnostics={"status": str(self._result.status)} | diagnostics,
            configuration=self.options.configuration,
        )

    def saved(self) -> Mapping[str, Array]:
        """Return the complete state, for `restore`."""
        residuals, values = self._at_renewal
        return {
            "windows": np.array(self._windows).reshape(-1, 9),
            "since_renewal": np.array(self._since_renewal),
            "triangular": residuals.triangular,
            "samples": np.array(residuals.samples),
            "values": np.concatenate([values.atVector(key) for key in KEYS]),
            **{f"history/{name}": value for name, value in self._history.state().items()},
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `saved`, bit for bit, on a new graph with the same options."""
        windows = list(state["windows"])
        since = len(windows) - int(state["since_renewal"])
        self._windows = windows[:since]
        self._residuals = CompressedGyroDerivative(state["triangular"], int(state["samples"]))
        self._values = gtsam.Values()
        for key, value in zip(KEYS, np.split(state["values"], [6, 9]), strict=True):
            self._values.insert(key, value)
        self._renew()
        for window in windows[since:]:
            self.add(*np.split(window, _PARTS))
        self._history.restore(
            {k.removeprefix("history/"): v for k, v in state.items() if k.startswith("history/")}
        )


def _parameters(state: MagycState) -> Array | None:
    """Return the parameters (12,); None if the soft iron is singular or not positive definite."""
    try:
        parameters = state.parameters
    except MagycError:
        return None
    return parameters if np.linalg.eigvalsh(unvech(parameters[:6]))[0] > 0 else None
