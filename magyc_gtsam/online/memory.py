"""What the online smoother remembers beside the samples, and how that is written down."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.clock_drift import Drift
from magyc_gtsam.factors.field_chain import Noise
from magyc_gtsam.online.summary import Summary
from magyc_gtsam.online.values import Change
from magyc_gtsam.recording import Array

FIRST = 12  # windows before the first fit
_COUNTS = ("front_at", "tail", "done", "given_up", "next_sweep", "next_search", "settled", "stable", "undecided")


class Estimate(NamedTuple):
    """θ (13,), its covariance (13, 13) without colour; of the last sweep the noise levels, the colour of the residuals,
    and the degrees of freedom from which the gyroscope's noise was estimated."""

    parameters: Array
    covariance: Array
    noise: Noise
    colour: float
    noise_freedom: float


@dataclass
class Memory:
    """All that decides the future of the smoother, but for the samples.

    Attributes:
        past, head: summaries of the windows given up, and of all windows up to the tail.
        front: where parameters walk, the summary of all windows up to number `front_at`, walked until then.
        tail, done: numbers of the tail's first window and of the first window not yet taken.
        given_up: windows in the past.
        next_sweep, next_search: windows kept at which everything is fitted afresh, from several starts.
        estimate: what the last fit said; None before the motion determined anything.
        origin: (4,) bias and delay at which the gyroscope was integrated in the last sweep.
        swept: θ and its sigmas (2, 13) at the last sweep.
        report: the result of the last sweep.
        settled: the head joins the past as it grows.
        stable: converged.
        undecided: something happened in the tail that may yet turn out to be a step.
        problem: why there is no estimate.
        changes: steps found; their `after` is left open.
        drift: what the clocks did until the last sweep.
        clock_start: s, the magnetometer's first stamp, from which a drift that is known is taken out.
    """

    past: Summary | None = None
    head: Summary | None = None
    front: Summary | None = None
    front_at: int = 0
    tail: int = 0
    done: int = 0
    given_up: int = 0
    next_sweep: int = FIRST
    next_search: int = FIRST
    estimate: Estimate | None = None
    origin: Array = field(default_factory=lambda: np.zeros(4))
    swept: Array | None = None
    report: Calibration | None = None
    settled: bool = False
    stable: bool = False
    undecided: bool = False
    problem: str = ""
    changes: list[Change] = field(default_factory=list)
    drift: Drift | None = None
    clock_start: float = np.nan

    def to_arrays(self) -> dict[str, Array]:
        """Everything, for `from_arrays`."""
        result: dict[str, Array] = {"counts": np.array([int(getattr(self, name)) for name in _COUNTS])}
        result["origin"] = self.origin
        result["words"] = np.array(json.dumps([self.problem, _data(self.report)]))
        for name, summary in (("past", self.past), ("head", self.head), ("front", self.front)):
            if summary is not None:
                result |= {f"{name}/{k}": v for k, v in summary._asdict().items()}
        if self.estimate is not None:
            result["estimate"] = np.vstack([self.estimate.parameters, self.estimate.covariance])
            result["levels"] = np.array([*self.estimate.noise, self.estimate.colour, self.estimate.noise_freedom])
        if self.swept is not None:
            result["swept"] = self.swept
        if self.drift is not None:
            rate, sigma, moved, delay, known = self.drift
            result["drift"] = np.array([rate, sigma, moved, *delay, known])
        result["clock_start"] = np.array(self.clock_start)
        rows = [[c.time, c.time_sigma, *c.step, *c.step_sigma] for c in self.changes]
        result["changes"] = np.array(rows).reshape(-1, 8)
        result["before"] = np.array(json.dumps([_data(c.before) for c in self.changes]))
        return result

    @classmethod
    def from_arrays(cls, state: Mapping[str, Array]) -> Memory:
        """The inverse of `to_arrays`, bit for bit."""
        counts = dict(zip(_COUNTS, (int(v) for v in state["counts"]), strict=True))
        problem, report = json.loads(str(state["words"]))
        result = cls(
            **counts | {name: bool(counts[name]) for name in ("settled", "stable", "undecided")},  # type: ignore[arg-type]
            problem=problem,
            report=_calibration(report),
            origin=state["origin"],
            swept=state.get("swept"),
            clock_start=float(state["clock_start"]),
        )
        if "drift" in state:
            rate, sigma, moved, first, last, known = state["drift"].tolist()
            result.drift = Drift(rate, sigma, moved, (first, last), known)
        for name in ("past", "head", "front"):
            if f"{name}/parameters" in state:
                setattr(result, name, Summary(*(state[f"{name}/{k}"] for k in Summary._fields)))
        if "estimate" in state:
            magnetometer, gyroscope, *rest = (float(v) for v in state["levels"])
            result.estimate = Estimate(
                state["estimate"][0].copy(), state["estimate"][1:].copy(), Noise(magnetometer, gyroscope), *rest
            )
        before = json.loads(str(state["before"]))
        for row, data in zip(state["changes"], before, strict=True):
            result.changes.append(
                Change(float(row[0]), float(row[1]), row[2:5].copy(), row[5:8].copy(), _calibration(data), None)
            )
        return result


def _data(calibration: Calibration | None) -> dict[str, object] | None:
    return None if calibration is None else calibration.to_dict()


def _calibration(data: dict[str, object] | None) -> Calibration | None:
    return None if data is None else Calibration.from_dict(data)
