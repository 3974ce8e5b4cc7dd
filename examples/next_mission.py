"""Yesterday's calibration carried into today's mission.

Yesterday's log is calibrated and saved. Today it enters the graph as one native prior on soft and hard iron,
with all its correlations, loosened by a random walk over the night. Today's mission hardly turns, so that it
could not be calibrated on its own data.
"""

import tempfile
from pathlib import Path

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, H, V, X
from vehicle import Vehicle

import magyc_gtsam as mg
from magyc_gtsam.factors import (
    KeyframeField,
    calibration_prior,
    hard_iron_walk,
    keyframe_field_factor,
    soft_iron_walk,
    unvech,
)

NIGHT = 14 * 3600.0  # s
NO_IRON = np.array([1.0, 0, 0, 1, 0, 1])  # vech of the identity


def yesterday(folder: Path) -> Path:
    """Calibrate yesterday's dive and save it; the true field's strength fixes the scale."""
    simulation = mg.simulate("dive", 300.0, 20, 7)
    calibration = mg.calibrate(simulation.recording, field_strength=float(np.linalg.norm(simulation.field)))
    calibration.save(folder / "yesterday.yaml")
    return folder / "yesterday.yaml"


def main(duration: float = 60.0, seed: int = 3, carried: bool = True) -> dict[str, float]:
    """Smooth today's first minute with yesterday's calibration as a prior, or with a vague one."""
    vehicle = Vehicle("survey", duration, seed, every=20)
    recording, truth = vehicle.recording, vehicle.simulation.truth
    graph, values = vehicle.start()
    soft_iron, hard_iron = NO_IRON, np.zeros(3)
    if carried:
        with tempfile.TemporaryDirectory() as folder:
            old = mg.Calibration.load(yesterday(Path(folder)))
        graph.push_back(calibration_prior(A(0), H(0), old.soft_iron, old.hard_iron, old.covariance))
        graph.push_back(soft_iron_walk(A(0), A(1), NIGHT, 5e-4))
        graph.push_back(hard_iron_walk(H(0), H(1), NIGHT, 0.05e-6))
        soft_iron, hard_iron = old.soft_iron[np.triu_indices(3)], old.hard_iron * 1e6
        values.insert(A(0), soft_iron)
        values.insert(H(0), hard_iron)
    else:
        graph.addPriorVector(A(1), soft_iron, gtsam.noiseModel.Isotropic.Sigma(6, 0.3))
        graph.addPriorPoint3(H(1), hard_iron, gtsam.noiseModel.Isotropic.Sigma(3, 50.0))
    values.insert(A(1), soft_iron)
    values.insert(H(1), hard_iron)

    for k in range(1, len(vehicle.poses)):
        more, new = vehicle.step(
            k, values.atPose3(X(k - 1)), values.atVector(V(k - 1)), values.atConstantBias(B(0))
        )
        graph.push_back(more)
        values.insert(new)
        rows = slice((k - 1) * vehicle.every, k * vehicle.every + 1)
        block = KeyframeField.from_samples(
            (recording.time[rows][1:], recording.magnetic_field[rows][1:]),
            (recording.time[rows], recording.angular_rate[rows]),
            recording.time[k * vehicle.every],
        )
        graph.push_back(keyframe_field_factor(X(k), A(1), H(1), block, 1e-6, field=vehicle.field))
    values = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()

    # Tomorrow's prior, if the graph is not to be kept: today's marginal on A and H, native and picklable.
    joint = gtsam.Marginals(graph, values).jointMarginalCovariance([A(1), H(1)]).fullMatrix()
    unit = np.r_[np.ones(6), np.full(3, 1e-6)]
    tomorrow = calibration_prior(
        A(1), H(1), unvech(values.atVector(A(1))), values.atPoint3(H(1)) * 1e-6, joint * unit * unit[:, None]
    )
    return {
        "heading, degrees": vehicle.heading_error(values),
        "hard iron, µT": float(np.linalg.norm(values.atPoint3(H(1)) - truth.hard_iron * 1e6)),
        "rows of tomorrow's prior": float(tomorrow.dim()),
    }


if __name__ == "__main__":
    print("with yesterday's calibration:", main())
    print("without it:", main(carried=False))
