"""The estimates of the online smoother so far, and their form as arrays for the state file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.model_error.component import Component
from magyc_gtsam.estimators.model_error.model_error import ModelError
from magyc_gtsam.estimators.smoother.clock_drift import Drift
from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.online.engine import Change
from magyc_gtsam.online.marginal import Marginal
from magyc_gtsam.recording import Array

FIRST = 12  # windows before the first fit
_FLAGS = ("settled", "stable", "undecided", "waiting")
_COUNTS = ("front_at", "tail", "done", "given_up", "next_refit", "next_search", *_FLAGS)


class Estimate(NamedTuple):
    """An estimate of the parameters, with the noise levels of the last refit.

    Attributes:
        parameters, covariance: θ (p,), p = 16 if a misalignment was decided, and (p, p) without colour.
        noise: noise levels of the last refit.
        colour: correlation factor of its residuals.
        noise_freedom: degrees of freedom from which the gyroscope's noise was estimated.
    """

    parameters: Array
    covariance: Array
    noise: SensorNoise
    colour: float
    noise_freedom: float


@dataclass
class Belief:
    """Everything except the samples that determines the future results of the smoother.

    Attributes:
        past, head: marginals of the windows whose samples were dropped, and of all windows up to the tail.
        front: marginal of all windows up to number `front_at`, if parameters walk at random.
        tail, done: numbers of the tail's first window and of the first window not yet taken.
        given_up: number of windows in the past.
        next_refit, next_search: numbers of windows at which all are fitted again, and without the estimate as a start.
        estimate: the last estimate; None before the motion determines one.
        origin: (4,) bias and delay at which the gyroscope was integrated in the last refit.
        refitted: θ and its sigmas (2, p) at the last refit.
        report: the calibration of the last refit.
        settled: whether the head joins the past as it grows.
        stable: whether the estimate has converged.
        undecided: whether the tail may contain a step.
        waiting: whether a refit waits for its decision, because the step would be large.
        problem: why there is no estimate; "" if there is one.
        doubt: why the last refit rejected a misalignment that the data suggest.
        contradictions: of the earlier calibration by the data, at the last refit.
        unexplained: model error at the last refit; None before, and if parameters walk.
        changes: the steps found; their `after` is not set.
        drift: drift of the clocks until the last refit.
        clock_start: first stamp of the magnetometer, s, from which a known drift is removed.
    """

    past: Marginal | None = None
    head: Marginal | None = None
    front: Marginal | None = None
    front_at: int = 0
    tail: int = 0
    done: int = 0
    given_up: int = 0
    next_refit: int = FIRST
    next_search: int = FIRST
    estimate: Estimate | None = None
    origin: Array = field(default_factory=lambda: np.zeros(4))
    refitted: Array | None = None
    report: Calibration | None = None
    settled: bool = False
    stable: bool = False
    undecided: bool = False
    waiting: bool = False
    problem: str = ""
    doubt: str = ""
    contradictions: list[str] = field(default_factory=list)
    unexplained: ModelError | None = None
    changes: list[Change] = field(default_factory=list)
    drift: Drift | None = None
    clock_start: float = np.nan

    def to_arrays(self) -> dict[str, Array]:
        """Return everything as arrays for `from_arrays`."""
        result: dict[str, Array] = {"counts": np.array([int(getattr(self, name)) for name in _COUNTS])}
        result["origin"] = self.origin
        reports = _calibration_to_json(self.report), _error_to_json(self.unexplained)
        result["words"] = np.array(json.dumps([self.problem, self.doubt, self.contradictions, *reports]))
        for name, marginal in (("past", self.past), ("head", self.head), ("front", self.front)):
            if marginal is not None:
                result |= {f"{name}/{k}": v for k, v in marginal._asdict().items()}
        if self.estimate is not None:
            result["estimate"] = np.vstack([self.estimate.parameters, self.estimate.covariance])
            result["levels"] = np.array([*self.estimate.noise, self.estimate.colour, self.estimate.noise_freedom])
        if self.refitted is not None:
            result["refitted"] = self.refitted
        if self.drift is not None:
            rate, sigma, moved, delay, known = self.drift
            result["drift"] = np.array([rate, sigma, moved, *delay, known])
        result["clock_start"] = np.array(self.clock_start)
        rows = [[c.time, c.time_sigma, *c.step, *c.step_sigma] for c in self.changes]
        result["changes"] = np.array(rows).reshape(-1, 8)
        result["before"] = np.array(json.dumps([_calibration_to_json(c.before) for c in self.changes]))
        return result

    @classmethod
    def from_arrays(cls, state: Mapping[str, Array]) -> Belief:
        """Return the belief that `to_arrays` described, bit for bit."""
        counts = dict(zip(_COUNTS, (int(v) for v in state["counts"]), strict=True))
        problem, doubt, contradictions, report, unexplained = json.loads(str(state["words"]))
        result = cls(
            **counts | {name: bool(counts[name]) for name in _FLAGS},  # type: ignore[arg-type]
            problem=problem,
            doubt=doubt,
            contradictions=contradictions,
            report=_calibration_from_json(report),
            unexplained=_error_from_json(unexplained),
            origin=state["origin"],
            refitted=state.get("refitted"),
            clock_start=float(state["clock_start"]),
        )
        if "drift" in state:
            rate, sigma, moved, first, last, known = state["drift"].tolist()
            result.drift = Drift(rate, sigma, moved, (first, last), known)
        for name in ("past", "head", "front"):
            if f"{name}/parameters" in state:
                setattr(result, name, Marginal(*(state[f"{name}/{k}"] for k in Marginal._fields)))
        if "estimate" in state:
            magnetometer, gyroscope, *colour_and_freedom = (float(v) for v in state["levels"])
            result.estimate = Estimate(
                state["estimate"][0].copy(),
                state["estimate"][1:].copy(),
                SensorNoise(magnetometer, gyroscope),
                *colour_and_freedom,
            )
        before = json.loads(str(state["before"]))
        for row, data in zip(state["changes"], before, strict=True):
            result.changes.append(
                Change(
                    float(row[0]),
                    float(row[1]),
                    row[2:5].copy(),
                    row[5:8].copy(),
                    _calibration_from_json(data),
                    None,
                )
            )
        return result


def _error_to_json(error: ModelError | None) -> dict[str, object] | None:
    if error is None:
        return None
    kinds = {"components": error.components, "possible": error.possible}
    stored = {
        name: [{**vars(c), "covariance": c.covariance.tolist()} for c in group] for name, group in kinds.items()
    }
    return {"covariance": error.covariance.tolist(), **stored}


def _error_from_json(data: dict[str, Any] | None) -> ModelError | None:
    if data is None:
        return None
    components, possible = (
        tuple(Component(**c | {"covariance": np.array(c["covariance"])}) for c in data[name])
        for name in ("components", "possible")
    )
    return ModelError(np.array(data["covariance"]), components, possible)


def _calibration_to_json(calibration: Calibration | None) -> dict[str, object] | None:
    return None if calibration is None else calibration.to_dict()


def _calibration_from_json(data: dict[str, object] | None) -> Calibration | None:
    return None if data is None else Calibration.from_dict(data)
