"""The estimates of the online smoother so far, and their form as text for the state file."""

from __future__ import annotations

import json
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
from magyc_gtsam.storage.json_types import from_typed_json, typed_json

FIRST = 12  # windows before the first fit


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

    def to_json(self) -> str:
        """Return everything as text for `from_json`."""
        return json.dumps(typed_json(vars(self), _TYPES))

    @classmethod
    def from_json(cls, text: str) -> Belief:
        """Return the belief that `to_json` described, bit for bit."""
        return cls(**from_typed_json(json.loads(text), _TYPES))


_TYPES: dict[str, Any] = {
    each.__name__: each
    for each in (Calibration, Change, Component, Drift, Estimate, Marginal, ModelError, SensorNoise)
}
