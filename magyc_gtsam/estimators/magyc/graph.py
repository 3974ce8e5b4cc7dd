"""The factor graph of MAGYC-IFG (section III-C): windows come in one at a time, an estimate is there after each.

Two ways, one estimate. As published, iSAM2 keeps two factors per window on one and the same state, and so
linearises all of them again at every update: time and memory grow. Compressed, one factor stands for all
residuals (7) exactly and is replaced by its successor: both stay constant.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gtsam
import numpy as np

from magyc_gtsam.estimators.magyc.derivative_windows import LEAST_WINDOWS
from magyc_gtsam.estimators.magyc.estimate_history import EstimateHistory
from magyc_gtsam.estimators.magyc.state import KEYS, NAMES, MagycState, Prior, initial_values, scale_prior
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.gyro_derivative import CompressedGyroDerivative, gyro_derivative_factor
from magyc_gtsam.recording import Array
from magyc_gtsam.runners.convergence import IncrementalResult
from magyc_gtsam.runners.incremental import Incremental
from magyc_gtsam.runners.isam import Method
from magyc_gtsam.runners.status import Status

_RENEWED = 64  # windows after which iSAM2 begins anew at its estimate, so that its state is these windows at most
_PARTS = [3, 6]  # of a window: field, derivative, rate


class MagycGraph:
    """The graph, its estimate, and the mean over the last fifth of the estimates that the paper reports.

    Args:
        compressed: replace one factor instead of keeping all; the estimates are the same.
        optimizer: "dogleg" (RISE, as in the paper) or "gauss-newton".
        prior: "norm" (9) or "determinant".
        residual_sigma: of (7), gauss/s.
        prior_sigma: of the prior, per window.
        robust: name of a kernel that weighs each window; not with `compressed`.

    Raises:
        MagycError: an option that is wrong.
    """

    def __init__(
        self,
        *,
        compressed: bool = True,
        optimizer: Method = "dogleg",
        prior: Prior = "norm",
        residual_sigma: float = 1e-3,
        prior_sigma: float = 1e-2,
        robust: str | None = None,
    ) -> None:
        if compressed and robust is not None:
            raise MagycError(
                "robust: a compressed factor cannot weigh its windows any more; choose compressed=False, "
                "or method 'smoother'"
            )
        scale_prior(prior, prior_sigma)  # says now what is wrong with them
        self._compressed, self._optimizer, self._prior, self._robust = compressed, optimizer, prior, robust
        self._residual_sigma, self._prior_sigma = residual_sigma, prior_sigma
        self._held: tuple[int, ...] = ()  # handles of the compressed factor and its prior
        self._waiting: list[Array] = []  # windows that are not in iSAM2 yet
        self._windows: list[Array] = []  # (9,) each; where compressed only those since the renewal
        self._residuals = CompressedGyroDerivative.empty()
        self._values = initial_values()
        self._history = EstimateHistory(12)
        self._result = IncrementalResult(Status.INDETERMINATE, f"fewer than {LEAST_WINDOWS} windows so far")
        self._renew()

    def add(self, magnetic_field: Array, derivative: Array, angular_rate: Array) -> IncrementalResult:
        """Take the next window, (3,) gauss, gauss/s and rad/s, and make a step."""
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
        if self._compressed:
            factors = [
                self._residuals.factor(*KEYS, self._residual_sigma),
                scale_prior(self._prior, self._prior_sigma, len(self)),
            ]
        else:
            sigma, kernel = self._residual_sigma, self._robust
            factors = [
                factor
                for m, derivative, w in (np.split(window, _PARTS) for window in self._waiting)
                for factor in (
                    gyro_derivative_factor(*KEYS, m, derivative, w, sigma, robust=kernel),
                    scale_prior(self._prior, self._prior_sigma),
                )
            ]
        result = self._runner.update(factors, self._values, remove=self._held)
        if result.updated:
            self._waiting = []
            if self._compressed:
                self._held = result.factors
        return result

    def _renew(self) -> None:
        """Begin iSAM2 anew at its own estimate. All factors are linearised there at every step anyway."""
        self._runner = Incremental(self._optimizer, names=NAMES)
        self._held = ()
        if self._compressed:
            self._windows = []
        self._waiting = list(self._windows)
        self._since_renewal = 0
        self._at_renewal = (self._residuals, self._values)

    def __len__(self) -> int:
        return self._residuals.samples

    @property
    def configuration(self) -> dict[str, Any]:
        """The options it was made with."""
        return {
            "optimizer": self._optimizer,
            "prior": self._prior,
            "compressed": self._compressed,
            "robust": self._robust,
            "residual_sigma": self._residual_sigma,
            "prior_sigma": self._prior_sigma,
        }

    @property
    def result(self) -> IncrementalResult:
        """What the last update did."""
        return self._result

    @property
    def message(self) -> str:
        """How far it is, in words."""
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
        """(12,) vech(soft iron) at determinant 1, hard iron T, gyroscope bias; None where C is no soft iron."""
        return _parameters(self.state) if len(self._history) else None

    def mean(self) -> Array | None:
        """Likewise, the mean over the last 20 % of the estimates: what the paper reports."""
        return self._history.mean() if len(self._history) else None

    def saved(self) -> Mapping[str, Array]:
        """Everything that decides the future, for `restore`."""
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
        """Continue from `saved`, bit for bit; on a new graph with the same options."""
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
    """(12,); None while the motion has not yet determined a soft iron."""
    try:
        parameters = state.parameters
    except MagycError:
        return None
    return parameters if np.linalg.eigvalsh(unvech(parameters[:6]))[0] > 0 else None
