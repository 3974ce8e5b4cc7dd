"""Why `crassidis` fails at σ = 0.05 in the review's Fig. 5: the samples' order. `python benchmarks/review_order.py`."""

from __future__ import annotations

import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.metrics import model, model_cost, scores
from magyc_gtsam.study.review import RATE, STRENGTH, draw

RUNS = 40


def main() -> None:
    """Accuracy 1/ρ and robustness in the order of Algorithm 8, pole to pole, and in random order."""
    for sigma in (0.005, 0.05):
        for told in (None, 0.05, 0.2):
            for order in ("pole to pole", "random"):
                costs, trivial = [], []
                for seed in range(RUNS):
                    data = draw(seed, noise=sigma)
                    rows = np.arange(len(data.y))
                    if order == "random":
                        rows = np.random.default_rng(seed).permutation(rows)
                    recording = mg.Recording(np.arange(len(rows)) / RATE, data.y[rows] * STRENGTH)
                    options = {} if told is None else {"noise": (told * STRENGTH, 1.0)}
                    trivial.append(model_cost(np.eye(3), np.zeros(3), data.matrix, data.offset))
                    try:
                        found = mg.calibrate(recording, "crassidis", field_strength=STRENGTH, **options)
                    except mg.MagycError:
                        costs.append(np.inf)
                        continue
                    matrix, offset = model(found)
                    costs.append(model_cost(matrix / STRENGTH, offset / STRENGTH, data.matrix, data.offset))
                score = scores(costs, trivial, np.zeros(RUNS))
                noise = "0.02 assumed" if told is None else f"{told:g} told"
                print(f"σ = {sigma:g}, {noise}, {order}: 1/ρ {score.accuracy:.3g}, robust {score.robustness:.0%}")


if __name__ == "__main__":
    main()
