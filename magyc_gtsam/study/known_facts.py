"""One recording of the study of prior knowledge: an earlier calibration and the place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.engine import Row
from magyc_gtsam.estimators import calibrate
from magyc_gtsam.estimators.smoother.dip import known_dip
from magyc_gtsam.estimators.smoother.known import known_of
from magyc_gtsam.estimators.smoother.options import DIP_SIGMA, FIELD_SIGMA, SmootherOptions
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.online import OnlineCalibrator
from magyc_gtsam.recording import Recording
from magyc_gtsam.simulation import Simulation, simulate
from magyc_gtsam.study.efficiency import cramer_rao, error

FACTS = ("alone", "+ matrix", "+ strength", "+ dip", "online + matrix", "online + strength")
_EARLIER = 990_001  # first seed of the earlier calibrations, one per run
_OFFSET, _ROUGH = 0.1, 0.3  # m/s², constant offset and noise of an accelerometer's axis
_MOVED = 100e-6  # T, by which the hard iron may have changed since the earlier calibration


class KnownPlaceCase(NamedTuple):
    """A simulation with the operator's knowledge of the place.

    Attributes:
        simulation: the simulation, without errors of the accelerometer.
        recording: its recording, with errors of the accelerometer.
        truth: the true calibration.
        dip: true dip, rad.
        field: (strength, dip) for `calibrate`, with errors drawn from the world model's sigmas.
    """

    simulation: Simulation
    recording: Recording
    truth: Calibration
    dip: float
    field: tuple[float, float]


def placed(motion: str, duration: float, seed: int) -> KnownPlaceCase:
    """Return a simulation with random errors of the accelerometer and of the world model."""
    simulation = simulate(motion, duration, seed=seed)
    random = np.random.default_rng([seed, 17])
    north, east, down = simulation.field
    dip = float(np.arctan2(down, np.hypot(north, east)))
    force = simulation.recording.acceleration
    assert force is not None
    force = force + _OFFSET * random.normal(size=3) + _ROUGH * random.normal(size=force.shape)
    strength = simulation.truth.field_strength
    assert strength is not None
    field = strength + FIELD_SIGMA * random.normal(), dip + DIP_SIGMA * random.normal()
    return KnownPlaceCase(
        simulation, replace(simulation.recording, acceleration=force), simulation.truth, dip, field
    )


@cache
def _earlier(seed: int) -> Calibration:
    return calibrate(simulate("wide", seed=_EARLIER + seed).recording, misalignment=0)


def fact_row(motion: str, duration: float, seed: int) -> dict[str, Row]:
    """Return a row for each way of `FACTS`, of one recording of `duration` s."""
    run = placed(motion, duration, seed)
    recording = replace(run.recording, attitude=None)
    matrix: dict[str, Any] = {"prior": _earlier(seed), "misalignment": 0}
    ways: Mapping[str, Mapping[str, Any]] = {
        "alone": {"misalignment": 0},
        "+ matrix": matrix | {"hard_iron_walk": _MOVED},
        "+ strength": matrix | {"hard_iron_walk": _MOVED, "field": (run.field[0], None)},
        "+ dip": matrix | {"hard_iron_walk": _MOVED, "field": run.field},
    }
    rows = {}
    for way, options in ways.items():
        rows[way] = _hard_iron(calibrate(recording, **options), run.truth) | {
            "bound": _bound(run, recording, options)
        }
    for way, field in (("matrix", None), ("strength", (run.field[0], None))):
        online = OnlineCalibrator(**matrix, hard_iron_walk=_MOVED, field=field)
        online.update(recording.time, recording.magnetic_field, recording.angular_rate)
        calibration = online.calibration
        assert calibration is not None
        rows[f"online + {way}"] = _hard_iron(calibration, run.truth) | {"bound": rows[f"+ {way}"]["bound"]}
    return rows


def _bound(run: KnownPlaceCase, recording: Recording, options: Mapping[str, Any]) -> float:
    """Return the mean of the hard iron's variance by the Cramér–Rao bound with the knowledge in the options, T²."""
    chosen = SmootherOptions(**options)
    facts = known_of(chosen).facts
    if chosen.place is not None and chosen.place.dip is not None:
        facts = (*facts, *known_dip(recording, fit_field_chain(recording)))
    return float(np.trace(cramer_rao(run.simulation, facts)[6:9, 6:9])) / 3


def matrix_row(motion: str, percent: float, seed: int) -> dict[str, Row]:
    """Return a row of the way "wrong": a known place, and an earlier matrix stretched by `percent` in a random
    direction.
    """
    run = placed(motion, 60.0 if motion == "tiny" else 600.0, seed)
    shape = np.random.default_rng([seed, 23]).normal(size=(3, 3))
    shape = shape + shape.T - np.trace(shape + shape.T) / 3 * np.eye(3)
    shape *= percent / 100 / np.abs(np.linalg.eigvalsh(shape)).max()
    earlier = _earlier(seed)
    root = earlier.soft_iron @ (np.eye(3) + shape)
    wrong = replace(earlier, soft_iron=0.5 * (root + root.T))
    recording = replace(run.recording, attitude=None)
    options: Mapping[str, Any] = {"prior": wrong, "hard_iron_walk": _MOVED, "field": run.field, "misalignment": 0}
    bound = {"bound": _bound(run, recording, options)}
    return {"wrong": _hard_iron(calibrate(recording, **options), run.truth) | bound}


def _hard_iron(calibration: Calibration, truth: Calibration) -> Row:
    away = error(calibration, truth)[6:9]
    assert calibration.covariance is not None
    assert calibration.noise_covariance is not None
    block, of_sensors = calibration.covariance[6:9, 6:9], calibration.noise_covariance[6:9, 6:9]
    return {
        "error": float(np.mean(away**2)),
        "stated": float(np.trace(block)) / 3,
        "ratio": float(away @ np.linalg.solve(block, away)) / 3,
        "of_sensors": float(away @ np.linalg.solve(of_sensors, away)) / 3,
        "refused": float(not calibration.trusted),
    }
