"""Which rule takes out a skew between the chips best, and what no rule can reach: a linear model of five motions.

    python benchmarks/skew_rules.py [--samples 400]

With θ split into the skew ε and the rest, the error of the rest is that of twelve parameters, and, independent of it,
its slope by ε times what is left of ε. What the data say of ε is one Gaussian of its three angles. Each rule is judged
on the same draws of it: the heading over a level turn over the better of twelve and fifteen parameters, at skews of 0
to 1.5° in random directions, and the hard iron of aligned chips over that with twelve.

The bound: for weights on these cells, the weighted sum of the squared ratios is smallest for the Bayes rule, so that no
rule keeps all ratios below what that sum says; the weights that say most are found by cutting planes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linprog

from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.estimators.smoother.skew import Profile, SkewPosterior, profile_of, widened
from magyc_gtsam.estimators.smoother.skew_prior import AUTOMATIC, SkewPrior
from magyc_gtsam.heading_uncertainty import turn_of
from magyc_gtsam.study.known import MOTIONS, SKEWS, skewed

NOISE = (1e-6, 5e-3)  # T and rad/s per sample
SIZES = np.radians(SKEWS)
RECORDINGS = range(500, 508)  # seeds
LIMITS = (1.005, 1.01, 1.02, 1.05)  # of the hard iron of aligned chips
RULES = {
    "twelve parameters": replace(AUTOMATIC, probable=2.0),
    "without a threshold, aligned 0.5": replace(AUTOMATIC, probable=-1.0, aligned=0.5),
    "without a threshold, aligned 0.65": replace(AUTOMATIC, probable=-1.0, aligned=0.65),
    "without a threshold, aligned 0.8": replace(AUTOMATIC, probable=-1.0, aligned=0.8),
    "from 0.5 on, aligned 0.65": replace(AUTOMATIC, probable=0.5),
    "from 0.3 on, aligned 0.65 (present)": AUTOMATIC,
    "from 0.3 on, aligned 0.8": replace(AUTOMATIC, aligned=0.8),
}

Rule = Callable[[int], np.ndarray]  # from the number of a skew to what is taken out (n, 3), rad


@dataclass(frozen=True)
class Log:
    """What a recording says of ε: information (3, 3); squared errors of heading (rad²) and hard iron (T²) with twelve
    parameters; and what ε left adds to them, as quadratic forms (3, 3)."""

    information: np.ndarray
    heading: float
    hard_iron: float
    on_heading: np.ndarray
    on_hard_iron: np.ndarray

    @classmethod
    def of(cls, motion: str, seed: int) -> Log:
        simulation = skewed(motion, 0.0, seed)
        fit = fit_field_chain(simulation.recording, noise=NOISE, robust=False, misalignment=0)
        profile = profile_of(widened(fit, AUTOMATIC), 1.0)
        truth, covariance = simulation.truth, fit.covariance[:9, :9]
        turn = turn_of(simulation.recording, truth)
        slopes = turn.slopes(truth.soft_iron)
        slopes[:, :6] /= truth.field_strength
        by_skew = slopes @ profile.gain[:9] - turn.turned
        return cls(
            profile.information,
            float(np.mean(np.einsum("na,ab,nb->n", slopes, covariance, slopes))),
            float(np.trace(covariance[6:9, 6:9])) / 3,
            by_skew.T @ by_skew / len(by_skew),
            profile.gain[6:9].T @ profile.gain[6:9] / 3,
        )


class Draws:
    """Skews of each size and what the data say of them, n a recording of one motion."""

    def __init__(self, motion: str, samples: int) -> None:
        self.motion, self.samples = motion, samples
        self.logs = [Log.of(motion, seed) for seed in RECORDINGS]
        random = np.random.default_rng(0)
        shape = len(self.logs) * samples, 3
        way = random.normal(size=shape)
        noise = random.normal(size=shape)
        self.information = np.repeat([log.information for log in self.logs], samples, axis=0)
        self.on_heading = np.repeat([log.on_heading for log in self.logs], samples, axis=0)
        self.on_hard_iron = np.repeat([log.on_hard_iron for log in self.logs], samples, axis=0)
        roots = np.repeat(
            [np.linalg.cholesky(np.linalg.inv(log.information)) for log in self.logs], samples, axis=0
        )
        self.truth = SIZES[:, None, None] * way / np.linalg.norm(way, axis=1)[:, None]
        self.seen = self.truth + np.einsum("nij,nj->ni", roots, noise)
        self.heading = np.mean([log.heading for log in self.logs])
        self.hard_iron = np.mean([log.hard_iron for log in self.logs])
        free = [np.trace(log.on_heading @ np.linalg.inv(log.information)) for log in self.logs]
        twelve = [self.heading + quadratic(self.on_heading, each) for each in self.truth]
        self.better = np.minimum(twelve, self.heading + np.mean(free))
        self.shells = [[shell(self.information, seen, size) for size in SIZES] for seen in self.seen]

    def squares(self, rule: Rule) -> np.ndarray:
        """(5,) squared ratios: the heading at each size, and the hard iron of aligned chips."""
        left = [rule(k) - truth for k, truth in enumerate(self.truth)]
        heading = [self.heading + quadratic(self.on_heading, each) for each in left]
        hard_iron = self.hard_iron + quadratic(self.on_hard_iron, left[0])
        return np.append(heading / self.better, hard_iron / self.hard_iron)

    def shipped(self, prior: SkewPrior) -> Rule:
        """What `calibrate` takes out with a prior."""

        def taken(information: np.ndarray, seen: np.ndarray) -> np.ndarray:
            found = SkewPosterior.of(
                Profile(information, information @ seen, np.zeros((13, 3)), np.zeros(13)), prior
            )
            return found.resolved if found.probability > prior.probable else np.zeros(3)

        return lambda k: np.array([taken(*each) for each in zip(self.information, self.seen[k], strict=True)])

    def bayes(self, weights: np.ndarray) -> Rule:
        """The rule with the least weighted sum of `squares`."""
        loss = [weight / better * self.on_heading for weight, better in zip(weights, self.better, strict=False)]
        loss[0] = loss[0] + weights[-1] / self.hard_iron * self.on_hard_iron

        def taken(k: int) -> np.ndarray:
            likelihood = np.array([found[0] for found in self.shells[k]])
            share = np.exp(likelihood - likelihood.max(axis=0))
            matrix = np.einsum("sn,snij->nij", share, loss)
            pull = np.einsum("sn,snij,snj->ni", share, loss, [found[1] for found in self.shells[k]])
            floor = 1e-12 * np.trace(matrix, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-300 * np.eye(3)
            return np.linalg.solve(matrix + floor, pull[..., None])[..., 0]

        return taken

    def bound(self, hard_iron: float, rounds: int = 60) -> float:
        """What no rule keeps all four ratios of the heading below while that of the hard iron is at most so much."""
        weights, best, found = np.full(5, 0.2), -np.inf, []
        for number in range(rounds):
            squares = self.squares(self.bayes(np.maximum(weights, 1e-6))) - np.append(np.zeros(4), hard_iron**2)
            found.append(squares)
            best = max(best, weights @ squares)
            planes = np.column_stack([-np.array(found), np.ones(len(found))])
            bounds = [(0, 1)] * 4 + [(0, 20), (None, None)]
            solved = linprog([0] * 5 + [-1], planes, np.zeros(len(found)), [[1] * 4 + [0, 0]], [1], bounds).x
            if solved[5] - best < 1e-3:
                break
            weights = solved[:5] if number % 2 == 0 else 0.5 * (solved[:5] + weights)
        return float(np.sqrt(best))


def quadratic(forms: np.ndarray, angle: np.ndarray) -> float:
    """The mean of angleᵀ form angle."""
    return float(np.mean(np.einsum("ni,nij,nj->n", angle, forms, angle)))


def shell(information: np.ndarray, seen: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Logarithm of the likelihood (n,) of what is seen, and the mean of ε (n, 3), if ε has this size in any direction.

    The sphere is summed up around the direction that is seen, as far as seven sigmas reach.
    """
    if size == 0:
        return -0.5 * np.einsum("ni,nij,nj->n", seen, information, seen), np.zeros_like(seen)
    reach = np.minimum(np.pi, 7 / np.sqrt(np.linalg.eigvalsh(information)[:, 0]) / size)
    node, weight = np.polynomial.legendre.leggauss(20)
    polar = 0.5 * (node + 1) * reach[:, None]
    weight = 0.5 * weight * reach[:, None] * np.sin(polar)
    around = np.arange(16) * np.pi / 8
    pole = seen / np.linalg.norm(seen, axis=1)[:, None]
    side = np.cross(pole, np.eye(3)[np.abs(pole).argmin(axis=1)])
    side /= np.linalg.norm(side, axis=1)[:, None]
    other = np.cross(pole, side)
    circle = np.cos(around)[:, None] * side[:, None] + np.sin(around)[:, None] * other[:, None]
    points = size * (
        np.cos(polar)[:, :, None, None] * pole[:, None, None] + np.sin(polar)[:, :, None, None] * circle[:, None]
    )
    away = points - seen[:, None, None]
    nats = -0.5 * np.einsum("ntpi,nij,ntpj->ntp", away, information, away, optimize=True)
    top = nats.max(axis=(1, 2))
    share = np.exp(nats - top[:, None, None]) * weight[:, :, None] / 32
    total = share.sum(axis=(1, 2))
    return top + np.log(total), np.einsum("ntp,ntpi->ni", share, points) / total[:, None]


def main() -> None:
    """Print the ratios of each rule, and the bounds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=400, help="of each recording, eight a motion")
    motions = [Draws(motion, parser.parse_args().samples) for motion in MOTIONS]
    print(
        f"heading at {', '.join(f'{size:g}' for size in SKEWS)}° over the better of 12 and 15; hard iron if aligned"
    )
    for name, prior in RULES.items():
        print(f"\n{name}")
        for draws in motions:
            *heading, hard_iron = np.sqrt(draws.squares(draws.shipped(prior)))
            print(f"  {draws.motion:9}", *(f"{each:6.2f}" for each in heading), f"  {hard_iron:.3f}")
    print("\nno rule keeps the heading below, with a hard iron of aligned chips of at most")
    print(" " * 10, *(f"{limit:6.3f}" for limit in LIMITS))
    for draws in motions:
        print(f"  {draws.motion:9}", *(f"{draws.bound(limit):6.2f}" for limit in LIMITS))


if __name__ == "__main__":
    main()
