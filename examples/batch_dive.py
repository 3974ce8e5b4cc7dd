"""Batch smoothing of a dive with `CombinedImuFactor` and the magnetometer, one stretch of it disturbed.

The blocks share the graph's own bias nodes, weigh every sample by itself, and enter as native factors that
are linearised again until nothing moves, so that the optimiser never calls Python.
"""

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, H, V, X
from vehicle import Vehicle

from magyc_gtsam.factors import KeyframeField, NativeFactors, keyframe_field_factor

NO_IRON = np.array([1.0, 0, 0, 1, 0, 1])  # vech of the identity


def main(duration: float = 200.0, seed: int = 2, robust: str | None = "geman-mcclure") -> dict[str, float]:
    """Smooth the dive; errors, and the hard iron's standard deviation from `Marginals`."""
    vehicle = Vehicle("dive", duration, seed, every=20)
    recording, truth = vehicle.recording, vehicle.simulation.truth
    field = np.array(recording.magnetic_field)
    field[len(field) // 2 :][:100] += [0.0, 30e-6, -20e-6]  # 5 s beside a wreck

    graph, values = vehicle.start()
    graph.addPriorVector(A(0), NO_IRON, gtsam.noiseModel.Isotropic.Sigma(6, 0.3))
    graph.addPriorPoint3(H(0), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, 50.0))  # µT
    values.insert(A(0), NO_IRON)
    values.insert(H(0), np.zeros(3))
    for k in range(1, len(vehicle.poses)):
        more, new = vehicle.step(
            k, values.atPose3(X(k - 1)), values.atVector(V(k - 1)), values.atConstantBias(B(0))
        )
        graph.push_back(more)
        values.insert(new)
        rows = slice((k - 1) * vehicle.every, k * vehicle.every + 1)
        block = KeyframeField.from_samples(
            (recording.time[rows][1:], field[rows][1:]),
            (recording.time[rows], recording.angular_rate[rows]),
            recording.time[k * vehicle.every],
        )
        graph.push_back(
            keyframe_field_factor(
                X(k), A(0), H(0), block, 1e-6, gyro_bias_key=B(k), field=vehicle.field, robust=robust
            )
        )

    graph, values = NativeFactors(tolerance=0.02).solve(graph, values)
    covariance = gtsam.Marginals(graph, values).marginalCovariance(H(0))
    return {
        "heading, degrees": vehicle.heading_error(values),
        "hard iron, µT": float(np.linalg.norm(values.atPoint3(H(0)) - truth.hard_iron * 1e6)),
        "its sigma, µT": float(np.sqrt(np.trace(covariance))),
        "gyroscope bias, mrad/s": float(
            np.linalg.norm(values.atConstantBias(B(10)).gyroscope() - truth.gyro_bias) * 1e3
        ),
    }


if __name__ == "__main__":
    print("each sample weighed:", main())
    print("all samples trusted:", main(robust=None))
