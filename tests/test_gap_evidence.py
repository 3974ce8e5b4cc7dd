"""The evidence of effects: against explicit Gaussian integrals, and what is said of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator
from scipy.stats import multivariate_normal

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.gap.effects import NAMES, TERMS
from magyc_gtsam.gap.effects.term import NEARBY
from magyc_gtsam.gap.evidence.answer import answer
from magyc_gtsam.gap.evidence.beside import Beside
from magyc_gtsam.gap.evidence.candidates import COLOUR, DRIFT, Batch, Candidates
from magyc_gtsam.gap.evidence.colour import colour_of
from magyc_gtsam.gap.evidence.neighbours import neighbours, product_of
from magyc_gtsam.gap.evidence.node import FIELD_VARIATION
from magyc_gtsam.gap.evidence.posterior import NOTHING, UNKNOWN, SetWeight, marginals, normalised, summed, weights
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.tree import Tree
from magyc_gtsam.gap.evidence.weighing import weigh
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.samples.first import First
from magyc_gtsam.simulation.environment import CHANNELS

RANDOM = np.random.default_rng(3)
ROWS = 60


def normal(residual: np.ndarray, columns: np.ndarray, variance: np.ndarray, noise: float) -> float:
    """Log density of white noise and of columns with a prior."""
    covariance = noise**2 * np.eye(ROWS) + (columns.T * variance) @ columns
    return float(multivariate_normal.logpdf(residual, cov=covariance))


def stated_of(recording: mg.Recording) -> Mapping[str, float]:
    """What is said of a recording, by the evidence alone."""
    noise = short_term_noise(recording)
    return marginals(answer(First(recording, base_model(recording, None, noise)), noise, NAMES).posterior)


@pytest.mark.parametrize("noise", [1.0, 1.7])
def test_the_evidence_is_the_gaussian_integral(noise: float) -> None:
    flat, soft, own = (RANDOM.standard_normal((k, ROWS)) for k in (4, 3, 2))
    variance, wide = np.array([0.5, 2.0, 0.1]), np.full(4, 1e6)
    residual = RANDOM.standard_normal(ROWS) + own[0]
    beside = Beside.of(residual, flat, soft, variance, np.zeros(7), noise)
    batch = Batch(np.array([[0, 1]]), (own @ own.T)[None], ("time:any",), ({},), np.zeros(1))
    found = weigh(Candidates(own, np.zeros(2), (batch,)), beside)["time:any"]
    around = np.concatenate([flat, soft]), np.concatenate([wide, variance])
    nothing = normal(residual, *around, noise)
    for scale, log in zip(PRIOR.scales, found.by_scale, strict=True):
        columns, variances = np.concatenate([around[0], own]), np.concatenate([around[1], np.full(2, scale**2)])
        explicit = normal(residual, columns, variances, noise) - nothing - np.log(len(PRIOR.scales))
        assert log == pytest.approx(explicit, abs=2e-3)


def test_effects_marginalised_after_the_rest_are_marginalised_together() -> None:
    """Whether columns are marginalised at once or in two steps changes nothing; the rest alone is got back."""
    residual, flat, soft = (RANDOM.standard_normal(size) for size in (ROWS, (3, ROWS), (4, ROWS)))
    variance, score_bias, noise = RANDOM.uniform(0.1, 3, 4), RANDOM.standard_normal(7), 1.3
    at_once = Beside.of(residual, flat, soft, variance, score_bias, noise)
    rest = Beside.of(residual, flat, soft[:2], variance[:2], score_bias[:5], noise)
    after = rest.with_effects(soft[2:], variance[2:], score_bias[5:])
    other = RANDOM.standard_normal((2, ROWS))
    for one, same in ((at_once, after), (rest, after.rest())):
        assert same.square == pytest.approx(one.square)
        assert same.log_determinant == pytest.approx(one.log_determinant)
        assert same.solution()[0] == pytest.approx(one.solution()[0])
        assert same.see(other, np.ones(2)).score == pytest.approx(one.see(other, np.ones(2)).score)
        assert same.left() == pytest.approx(one.left())
    assert after.signal == pytest.approx(-soft[2:].T @ after.solution()[0][5:] / noise)


def test_a_family_may_be_the_deviation_of_the_signal_that_it_could_explain() -> None:
    """Half of it, if the signal is as far from the family as along it; what the parameters explain does not count."""
    flat, one, other, apart = np.linalg.qr(RANDOM.standard_normal((ROWS, 4)))[0].T[:, None]
    rest = Beside.of(40 * (one + other)[0], flat, flat[:0], np.zeros(0), np.zeros(1), 2.0)
    beside = rest.with_effects(one + other, np.full(1, 1e6), np.zeros(1))
    rows = np.concatenate([one + 0.5 * flat, apart, 3 * one + apart, other - apart, 0 * one, 2 * flat])
    batches = tuple(
        Batch(np.array([places]), (rows[places] @ rows[places].T)[None], (name,), ({},), np.zeros(1))
        for name, places in (
            ("time:half", [0]),
            ("time:none", [1]),
            ("time:more", [2, 3]),
            ("time:zero", [4]),
            ("time:known", [5]),
        )
    )
    found = weigh(Candidates(rows, np.zeros(6), batches), beside)
    explained = np.linalg.lstsq(rows[2:].T, (one + other)[0], rcond=None)[0] @ rows[2:]
    shares = {"time:half": 1.0, "time:none": 0.0, "time:more": float(explained @ explained)}
    shares |= {"time:zero": 0.0, "time:known": 0.0}  # no columns, and columns that the parameters explain
    for name, share in shares.items():
        assert found[name].contained == pytest.approx(20.0**2 * share, rel=1e-3, abs=1e-6)


def test_what_is_marginalised_has_its_mean_and_covariance() -> None:
    flat, soft = RANDOM.standard_normal((2, ROWS)), RANDOM.standard_normal((2, ROWS))
    variance, noise = np.array([0.5, 2.0]), 1.3
    residual = RANDOM.standard_normal(ROWS)
    value, covariance = Beside.of(residual, flat, soft, variance, np.zeros(4), noise).solution()
    rows = np.concatenate([flat, soft])
    information = rows @ rows.T / noise**2 + np.diag(np.concatenate([np.zeros(2), 1 / variance]))
    np.testing.assert_allclose(covariance, np.linalg.inv(information), rtol=1e-6)
    np.testing.assert_allclose(value, -np.linalg.solve(information, rows @ residual / noise**2), rtol=1e-6)


def test_an_estimate_has_no_negative_variance_where_rounding_leaves_no_information() -> None:
    """As of three values of a drift under a constant acceleration; the root of one was not a number."""
    flat, own = RANDOM.standard_normal((1, ROWS)), RANDOM.standard_normal((3, ROWS))
    beside = Beside.of(RANDOM.standard_normal(ROWS), flat, flat[:0], np.zeros(0), np.zeros(1))
    batch = Batch(np.arange(3)[None], (own @ own.T)[None], ("cubic",), ({},), np.zeros(1))
    found = weigh(Candidates(own, np.zeros(3), (batch,)), beside)["cubic"]
    for information in (np.diag([4.0, 1.0, -1e-5]), np.zeros((3, 3))):
        value, covariance = replace(found, information=information, score=np.array([2.0, 1.0, 3.0])).estimate
        known = np.diag(information) > 0
        np.testing.assert_allclose(np.diag(covariance)[known], 1 / np.diag(information)[known])
        assert not value[~known].any()
        assert not covariance[~known].any()


def test_probabilities_are_of_all_sets() -> None:
    posterior = {((), False): 0.2, (("timing",), False): 0.5, (("cubic", "timing"), True): 0.3}
    assert marginals(posterior) == pytest.approx({"timing": 0.8, UNKNOWN: 0.3, "cubic": 0.3, NOTHING: 0.2})


def test_a_share_is_kept_for_what_no_set_holds() -> None:
    """However much the data say for one of them; what is decided from a limit on can still be attained."""
    stated = marginals(normalised({((), True): 0.0, ((), False): 1000.0}))
    assert stated == pytest.approx({NOTHING: 1 - PRIOR.unforeseen, UNKNOWN: PRIOR.unforeseen})
    assert PRIOR.named_from < 1 - PRIOR.unforeseen
    assert PRIOR.unforeseen < PRIOR.improbable


def test_a_larger_share_is_kept_where_the_field_varies() -> None:
    """Of an effect in the place of the names, beside the field; a name may still be sure enough to be given."""
    stated = marginals(normalised({((FIELD_VARIATION, "cubic", "spikes"), False): 0.0}))
    certain = 1 - PRIOR.unforeseen
    sure = certain * (1 - PRIOR.unforeseen_in_room)
    assert stated == pytest.approx(
        {FIELD_VARIATION: certain, "cubic": sure, "spikes": sure, UNKNOWN: 1 - sure, NOTHING: 0.0}
    )
    assert PRIOR.named_from < PRIOR.missing_from < sure


@pytest.mark.parametrize("seen", [None, 100.0])
def test_many_names_at_once_may_be_one_unknown_cause(seen: float | None) -> None:
    """Any of them together, if something unknown is seen; effects on single samples are not among them."""
    names = ("cubic", "eddy-plane", "hysteresis", "tone")
    stated = marginals(normalised(summed([SetWeight(names, 0.0, seen, dict.fromkeys(names, 100.0))])))
    share = 1 - PRIOR.unforeseen
    assert stated["cubic"] == pytest.approx(share if seen is None else 0.5 * share)  # 4 of 8 subsets contain it
    assert stated["tone"] == pytest.approx(share)


@pytest.mark.parametrize("seen", [None, 100.0])
def test_a_varying_field_stays_if_no_unknown_cause_is_seen(seen: float | None) -> None:
    names = (FIELD_VARIATION, "cubic", "hysteresis")
    stated = marginals(normalised(summed([SetWeight(names, 0.0, seen, dict.fromkeys(names, 100.0))])))
    share = 1 - PRIOR.unforeseen
    assert stated[FIELD_VARIATION] == pytest.approx(share if seen is None else 0.5 * share, rel=0.05)


@pytest.mark.parametrize("seen", [None, 500.0])
def test_correlated_noise_may_be_a_part_of_what_is_unknown(seen: float | None) -> None:
    """As probably as not; of a log in which nothing is unknown it is not."""
    names = tuple(sorted((COLOUR, FIELD_VARIATION)))
    stated = marginals(normalised(summed([SetWeight(names, 0.0, seen, {COLOUR: 0.0, FIELD_VARIATION: 100.0})])))
    share = (1 - PRIOR.unforeseen) * (1 - PRIOR.unforeseen_in_room)
    assert stated[COLOUR] == pytest.approx(share if seen is None else 0.5 * share, rel=0.05)


def test_a_small_unknown_effect_is_no_part_of_a_large_name() -> None:
    """It must explain more than the name may deviate from its form."""
    least = PRIOR.form * 1000.0
    small, large = (
        marginals(normalised(summed([SetWeight(("hysteresis",), 0.0, seen, {"hysteresis": 1000.0})])))[
            "hysteresis"
        ]
        for seen in (0.9 * least, 1.1 * least)
    )
    assert small > 0.97
    assert large < 0.7


def test_a_product_pays_for_the_time_of_its_jump() -> None:
    """In place of a jump, its product with another signal is at the jump's time, which was searched for as well."""
    recording = mg.simulate("wide", 120, seed=3, effects=(("hard-iron-step", 1.0),)).recording
    tree = Tree(base_model(recording, None, short_term_noise(recording)), ("hard-iron-step",))
    node = tree.nodes[()]
    step = node.found["hard-iron-step"]
    assert step.search > 3
    for family in neighbours("hard-iron-step", step.setting):
        free = weigh(Candidates.of(node.fit.twin, (), [family]), node.beside)[family.name]
        paid = node.found[family.name]
        assert paid.log == pytest.approx(free.log - step.search)
        np.testing.assert_allclose(paid.by_scale, free.by_scale - step.search)


def test_a_tree_follows_what_is_likely() -> None:
    recording = mg.simulate("wide", 120, seed=9, effects=[("timing", 2.0)]).recording
    noise = short_term_noise(recording)
    tree = Tree(base_model(recording, None, noise), ("timing", "cubic", "hard-iron-step"))
    assert tree.best.names == ("timing",)
    assert len(tree.nodes) <= PRIOR.nodes
    value, _ = tree.best.fit.value_of(0)
    assert value[0] == pytest.approx(0.08, abs=0.01)


def test_what_is_weak_may_be_a_part_of_something_unknown() -> None:
    """A lag of fast turns alone is no delay of all turns; a strong delay, beside which nothing is left, is one."""
    recording = mg.simulate("multi", 120, seed=3).recording
    field, turn = recording.magnetic_field, recording.angular_rate
    assert turn is not None
    speed = np.linalg.norm(turn, axis=1, keepdims=True)
    slope = np.cross(field - field.mean(axis=0), turn)
    fast = 0.09 * slope * (speed / np.sqrt((speed**2).mean())) ** 2
    delayed = mg.simulate("multi", 120, seed=3, effects=[("timing", 3.0)]).recording
    candidates = ["timing", "eddy-plane", "gyro-scale", "misalignment", "cubic"]
    late, odd = (
        mg.find_gap(log, candidates=candidates).probabilities
        for log in (delayed, mg.Recording(recording.time, field - fast, turn))
    )
    assert late["timing"] > 0.95
    assert late[UNKNOWN] < 0.1
    assert odd[UNKNOWN] > 0.9
    assert odd.get("timing", 0.0) < 0.5


def test_an_effect_with_a_large_product_is_another_effect() -> None:
    """A lag that grows with the speed of turn is described by a delay and the delay's product with the speed."""
    recording = mg.simulate("multi", 120, seed=4).recording
    field, turn = recording.magnetic_field, recording.angular_rate
    assert turn is not None
    speed = np.linalg.norm(turn, axis=1, keepdims=True)
    growing = 0.15 * np.cross(field - field.mean(axis=0), turn) * (0.5 + speed / np.sqrt((speed**2).mean()))
    late = mg.Recording(recording.time, field - growing, turn)
    tree = Tree(base_model(late, None, short_term_noise(late)), ("timing",))
    assert ("timing",) in tree.nodes
    for node in tree.nodes.values():  # nothing else that is unknown explains it
        for name in [name for name in node.found if name != "timing" and product_of(name) is None]:
            del node.found[name]
    stated = marginals(normalised(summed(weights(tree))))
    assert stated[UNKNOWN] > 0.9
    assert stated["timing"] < 0.1


def test_colour_beside_white_noise_is_weighed_as_its_density() -> None:
    """Against the exact density of the power and time that it has, less what the average over all costs."""
    random, n, time, share = np.random.default_rng(5), 400, 2.0, 1.0
    lag = np.abs(np.arange(n)[:, None] - np.arange(n))
    covariance = (np.eye(n) + share * np.exp(-lag / time)) / (1 + share)
    rows = random.multivariate_normal(np.zeros(n), covariance, size=3)
    exact = float(multivariate_normal.logpdf(rows, cov=covariance).sum() + 0.5 * (rows**2).sum())
    exact += 0.5 * rows.size * np.log(2 * np.pi)
    nats = colour_of(rows.ravel()).alike
    assert exact - 12 < nats < exact + 2
    assert colour_of(random.standard_normal(3 * n)).alike < 0


def test_a_second_step_is_no_form_of_the_first() -> None:
    """It explains a fiftieth of what the first does, but at another time."""
    recording = mg.simulate("wide", 200, seed=4).recording
    since = recording.time - recording.time[0]
    steps = 30e-6 * (since > 50) + 4e-6 * (since > 140)
    field = recording.magnetic_field + steps[:, None] * np.array([1.0, 0.0, 0.0])
    stepped = replace(recording, magnetic_field=field)
    noise = short_term_noise(stepped)
    names = ("hard-iron-step", "timing", "misalignment")
    tree = answer(First(stepped, base_model(stepped, None, noise)), noise, names).tree
    best = tree.best
    terms, place_of = best.fit.model.terms, stepped.time[0]
    strong, weak = (
        [
            i
            for i, t in enumerate(terms)
            if t.name == "hard-iron-step" and abs(t.setting["time"] - place_of - at) < 2
        ]
        for at in (50, 140)
    )
    assert set(weak) & set(best.kept)
    powers = best.of_terms.powers(range(len(terms)))
    assert max(powers[i, i] for i in weak) < PRIOR.form * max(powers[i, i] for i in strong)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_saturation_is_no_cubic_beside_it(seed: int) -> None:
    """The core saturates softly, in a form that is not that of the catalogue."""
    said = stated_of(mg.simulate("wide", 200, seed=seed, effects=["saturation"]).recording)
    assert said["saturation"] > 0.9
    assert said.get("cubic", 0.0) < 0.3


@pytest.mark.parametrize(
    ("duration", "orders", "constants"),
    [(5, [0], []), (30, [0, 4], [9]), (50, [0, 4], [15]), (120, [0, 4, 12], [12, 36])],
)
def test_a_drift_is_a_line_or_slow(duration: int, orders: list[int], constants: list[float]) -> None:
    """Its modes have periods of 12 s and longer, what warms up has a time constant of half of that."""
    recording = mg.simulate("wide", duration, seed=1).recording
    twin = base_model(recording, None, short_term_noise(recording)).twin
    settings = TERMS[DRIFT].settings(twin)
    assert [one["order"] for one in settings if "constant" not in one] == orders
    assert [one["constant"] for one in settings if "constant" in one] == pytest.approx(constants, rel=0.05)
    for one in settings:
        near = TERMS[DRIFT].refined(twin, one)
        if "constant" in one:
            assert [each["constant"] for each in near] == [c for c in one["constant"] * np.array(NEARBY) if c >= 6]
        elif one["order"] == 0 and constants:
            assert near == [one, one | {"constant": pytest.approx(constants[-1], rel=0.05)}]
        else:
            assert not near


@pytest.mark.parametrize("seed", [0, 7])
def test_a_gain_that_warms_up_is_a_drift(seed: int) -> None:
    """A thermometer of the water that lags by minutes has nearly the same course; it was named instead."""
    recording = mg.simulate("wide", 300, seed=seed, effects=[("gain-drift", 2.0)], channels=CHANNELS).recording
    (effect,) = mg.find_gap(recording).effects
    assert effect.name == "gain-drift"
    assert "constant" in effect.setting


@pytest.mark.parametrize("seed", [6, 9, 10])
def test_the_modes_of_a_drift_are_chosen_anew_beside_other_effects(seed: int) -> None:
    """A walk and a delay: alone twelve modes are likelier, which follow the delay, too; beside the delay four are."""
    base = mg.simulate("wide", 120, seed=seed, delay=0.3).recording
    walk = np.random.default_rng(seed).standard_normal((9, 3)).cumsum(axis=0)
    drift = 1e-6 * PchipInterpolator(np.arange(9) * 16.0, walk)(base.time - base.time[0])
    recording = replace(base, magnetic_field=base.magnetic_field + drift - drift.mean(axis=0))
    tree = Tree(base_model(recording, None, short_term_noise(recording)), (DRIFT, "timing"))
    assert tree.best.key == (DRIFT, "timing")
    for names, order in (((DRIFT,), 12.0), ((DRIFT, "timing"), 4.0)):
        terms = tree.nodes[names].fit.model.terms
        assert [term.setting["order"] for term in terms if term.name == DRIFT] == [order]
