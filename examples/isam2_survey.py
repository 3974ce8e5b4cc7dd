"""Magnetometer calibration inside an odometry–inertial graph in iSAM2, on a simulated survey.

The graph of vehicle.py has poses X, velocities V and biases B, joined by inertial factors and odometry. The
calibration adds a block of samples every 2 s, as a native factor, and a node A, H of soft and hard iron every
30 s. Prints the heading error with and without the magnetometer, and draws it in the PNG file given.
"""

import sys
from pathlib import Path

import gtsam
import matplotlib.pyplot as plt
import numpy as np
from gtsam.symbol_shorthand import A, B, H, V, X
from vehicle import RATE, Vehicle

from magyc_gtsam.factors import (
    KeyframeBuffer,
    NativeFactors,
    hard_iron_walk,
    keyframe_field_factor,
    soft_iron_walk,
)

BLOCK, NODE = 4, 60  # keyframes
UNIT = 50e-6  # T per unit of the hard iron: then a unit of it turns the field as much as a radian
NO_IRON = np.array([1.0, 0, 0, 1, 0, 1])  # vech of the identity


def survey(
    duration: float = 240.0, seed: int = 1, magnetometer: bool = True
) -> tuple[dict[str, float], np.ndarray]:
    """Run the survey; errors of the heading and, at the end, of the hard iron; and the heading error over time."""
    vehicle = Vehicle("dive", duration, seed)
    settings = gtsam.ISAM2Params()
    settings.setFactorization("QR")
    settings.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(0.01))
    isam, native, buffer, node = gtsam.ISAM2(settings), NativeFactors(), KeyframeBuffer(), 0

    graph, values = vehicle.start()
    if magnetometer:
        graph.addPriorVector(A(0), NO_IRON, gtsam.noiseModel.Isotropic.Sigma(6, 0.3))
        graph.addPriorPoint3(H(0), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, 1.0))
        values.insert(A(0), NO_IRON)
        values.insert(H(0), np.zeros(3))
    isam.update(graph, values)

    for k in range(1, len(vehicle.poses)):
        pose, velocity = isam.calculateEstimatePose3(X(k - 1)), isam.calculateEstimateVector(V(k - 1))
        bias = isam.calculateEstimateConstantBias(B(k - 1))
        graph, values = vehicle.step(k, pose, velocity, bias)
        if not magnetometer:
            isam.update(graph, values)
            continue
        for time, rate, field in vehicle.samples(k):
            buffer.add_rate(time, rate)
            buffer.add_field(time, field)
        if k % NODE == 0:
            elapsed = NODE * vehicle.every / RATE
            graph.push_back(soft_iron_walk(A(node), A(k), elapsed, 1e-3))
            graph.push_back(hard_iron_walk(H(node), H(k), elapsed, 0.1e-6, field_unit=UNIT))
            values.insert(A(k), isam.calculateEstimateVector(A(node)))
            values.insert(H(k), isam.calculateEstimatePoint3(H(node)))
            node = k
        if k % BLOCK == 0:
            block = buffer.close(vehicle.recording.time[k * vehicle.every], bias.gyroscope())
            factor = keyframe_field_factor(
                X(k), A(node), H(node), block, 1e-6, gyro_bias_key=B(k), field=vehicle.field, field_unit=UNIT
            )
            graph.push_back(factor)
        native.update(isam, graph, values)

    estimate = isam.calculateEstimate()
    result = {"heading, degrees": vehicle.heading_error(estimate, len(vehicle.poses) // 2)}
    if magnetometer:
        hard_iron = isam.calculateEstimatePoint3(H(node)) * UNIT
        result["hard iron, µT"] = float(np.linalg.norm(hard_iron - vehicle.simulation.truth.hard_iron) * 1e6)
        result["its sigma, µT"] = float(np.sqrt(np.trace(isam.marginalCovariance(H(node)))) * UNIT * 1e6)
    return result, vehicle.heading_errors(estimate)


def main(figure: Path = Path("isam2_survey.png"), duration: float = 240.0) -> str:
    """Run the survey with and without the magnetometer, save the figure, and compare the two in a sentence."""
    (found, error), (without, drift) = survey(duration), survey(duration, magnetometer=False)
    drawing, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
    for label, values in (("without magnetometer", drift), ("calibrated in the graph", error)):
        axes.plot(np.linspace(0, duration, len(values)), values, label=label)
    axes.set(xlabel="Time (s)", ylabel="Heading error (°)")
    axes.legend()
    drawing.savefig(figure)
    plt.close(drawing)
    heading = f"heading error {found['heading, degrees']:.2f}° with the magnetometer calibrated in the graph"
    iron = f"the hard iron is off by {found['hard iron, µT']:.2f} µT (1σ {found['its sigma, µT']:.2f} µT)"
    return f"{heading}, {without['heading, degrees']:.2f}° without it; {iron}"


if __name__ == "__main__":
    print(main(*map(Path, sys.argv[1:])))
