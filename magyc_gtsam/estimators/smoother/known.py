"""Facts about θ from an earlier calibration and the field at the place, and the test of the data against them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.dip import dip_of, known_dip
from magyc_gtsam.estimators.smoother.fit import Fit, inverse_information
from magyc_gtsam.estimators.smoother.noise_levels import misfit
from magyc_gtsam.estimators.smoother.options import FIELD_SIGMA, SmootherOptions
from magyc_gtsam.estimators.smoother.skew import on_skew
from magyc_gtsam.estimators.smoother.vertical import MODEL
from magyc_gtsam.factors.chain.chain_values import PARAMETERS, SKEW
from magyc_gtsam.factors.chain.facts import Fact, IronFact, LinearFact, StrengthFact, field_strength, quadratic
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import ENTRIES, vech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Recording

_FLOOR = np.r_[np.full(6, 1e-5), np.full(3, 1e-9)]  # least sigmas of a prior, 1 and T
_CONTRADICTS = 31.8  # squared Mahalanobis distance: the 99.99 % point of χ² of eight degrees of freedom
ENOUGH = "this motion is enough with"  # start of the sentence on facts that compensate for too little motion


@dataclass(frozen=True)
class _Place:
    """How often the field of the place is not the world's, indoors and beside iron, and by how much of it (1σ).

    The share was chosen on ships and level vehicles with a strength off by 3 to 10 %, of 120 of which 61 were trusted
    beyond 3 sigmas without it and 32 with it; 48 with the right strength have sigmas within 4 %.
    """

    share: float = 0.02
    off: float = 0.1


_PLACE = _Place()


class PriorKnowledge(NamedTuple):
    """Prior knowledge from the options.

    Attributes:
        facts: on the first thirteen parameters.
        skew: fact on the misalignment, if the earlier calibration has one.
        soft_iron, hard_iron: a start, vech (6,) of determinant 1 and (3,) T.
        note: remark for the message; "" if there is none.
    """

    facts: tuple[Fact, ...] = ()
    skew: LinearFact | None = None
    soft_iron: Array | None = None
    hard_iron: Array | None = None
    note: str = ""


def known_of(options: SmootherOptions) -> PriorKnowledge:
    """Return the prior knowledge of θ in the options.

    Raises:
        MagycError: a prior without covariance, or in raw counts.
    """
    prior = options.prior
    if prior is None:
        return PriorKnowledge()
    scale, slope = field_strength(vech(prior.soft_iron))  # ∛det, 1 if no field strength was given
    covariance = _covariance(prior, options)
    shape = vech(prior.soft_iron) / scale
    onto = np.eye(9)
    onto[:6, :6] = (np.eye(6) - np.outer(shape, slope)) / scale
    root = _root(onto @ covariance @ onto.T + _change_covariance(shape, options))
    facts: list[Fact] = [IronFact(shape, np.array(prior.hard_iron), root)]
    note = ""
    place = options.place
    if place is not None and place.strength is not None:
        relative = math.sqrt(max(float(slope @ covariance[:6, :6] @ slope), 0.0)) / scale
        if not _scaled(prior):
            # Its scale is the instrument's own; it is known as well as its field strength agrees with the place's.
            measured = prior.field_strength
            relative = np.inf if measured is None else abs(math.log(measured / place.strength))
        if relative < 0.1:
            mean = place.strength * scale
            facts.append(StrengthFact(mean, float(np.hypot(place.strength_sigma * scale, mean * relative))))
        if relative > 0.01:
            note = (
                "the strength of the field tells little: the earlier calibration was made without one, so its scale "
                "is not known (give it the strength or the place as well)"
            )
    return PriorKnowledge(tuple(facts), _skew(prior, options), shape, np.array(prior.hard_iron), note)


def _scaled(prior: Calibration) -> bool:
    """Return whether a calibration's soft iron has the scale of a known field."""
    configured = prior.configuration.get("field_strength", prior.configuration.get("field"))
    return configured is not None or abs(float(np.linalg.det(prior.soft_iron)) - 1) > 1e-6


def _covariance(prior: Calibration, options: SmootherOptions) -> Array:
    """Return the covariance (9, 9) of soft and hard iron."""
    if prior.magnetic_field_unit == "counts":
        raise MagycError("prior: it is of raw counts, and the recording is in tesla; calibrate both in one unit")
    if prior.covariance is not None:
        return np.array(prior.covariance[:9, :9])
    if not (options.hard_iron_walk and options.soft_iron_walk):
        raise MagycError(
            f"prior: a calibration by {prior.method!r} has no covariance; say how far it may be off (hard_iron_walk= "
            "and soft_iron_walk=), or take one by the smoother"
        )
    return np.zeros((9, 9))


def _change_covariance(shape: Array, options: SmootherOptions) -> Array:
    """Return the covariance (9, 9) of changes since, of the soft iron of determinant 1 and the hard iron."""
    sigma = np.hypot(_FLOOR, np.r_[np.full(6, options.soft_iron_walk), np.full(3, options.hard_iron_walk)])
    _, slope = field_strength(shape)
    kept = np.eye(9)
    kept[:6, :6] -= np.outer(shape, slope)
    return (kept * sigma**2) @ kept.T


def _root(covariance: Array) -> Array:
    """Return a root (k, 9) of the pseudo-inverse, rootᵀ root = covariance⁺; the unknown scale reduces k by one."""
    scale = np.sqrt(np.diag(covariance))
    value, vector = np.linalg.eigh(covariance / np.outer(scale, scale))
    kept = value > 1e-9 * value[-1]
    result: Array = (vector[:, kept] / np.sqrt(value[kept])).T / scale
    return result


def _skew(prior: Calibration, options: SmootherOptions) -> LinearFact | None:
    """Return the earlier calibration's fact on the misalignment; ε is minus the term's rotation of the rate."""
    terms = [term for term in prior.terms if term.name == "misalignment"]
    if not terms or options.misalignment == 0:
        return None
    covariance = terms[0].covariance + (options.soft_iron_walk**2 + 1e-10) * np.eye(3)
    return LinearFact(
        np.arange(SKEW.start, SKEW.stop), -terms[0].value, np.linalg.cholesky(np.linalg.inv(covariance)).T
    )


def is_worse(fit: Fit, alone: Fit, options: SmootherOptions) -> bool:
    """Return whether the data and the prior fit together worse than by chance, at the noise of the data alone."""
    if len(fit.chain.windows) != len(alone.chain.windows):  # shorter ones, since one of them rejects many
        return True
    noise = alone.chain.noise
    from_prior, _ = known_of(options).facts[0].residual(fit.state.parameters)
    worse = (misfit(fit, noise) - misfit(alone, noise)) / alone.colour + float(from_prior @ from_prior)
    return worse > _CONTRADICTS


def contradictions(alone: Calibration, options: SmootherOptions, sufficient: bool) -> list[str]:
    """Return a sentence on the parameters in which the data alone and the prior contradict each other, or nothing.

    Args:
        alone: the calibration of the same recording without the prior; directions that it does not determine cannot
            contradict.
        options: with the prior, widened by the changes allowed since.
        sufficient: whether the data need no prior.
    """
    fact = known_of(options).facts[0]
    assert isinstance(fact, IronFact)
    if alone.covariance is None:
        return []
    away, slope = fact.away(np.concatenate([vech(alone.soft_iron), alone.hard_iron]))
    # The facts' root has no row for the scale, which both calibrations leave out.
    before = np.linalg.pinv(fact.root, rcond=1e-12)
    before = before @ before.T
    total = before + slope @ alone.covariance[:9, :9] @ slope.T
    counted = total.copy()
    counted[:6, :6] += np.outer(fact.shape, fact.shape)  # excludes the scale, which neither determines
    root = _root(counted)
    if float(np.sum((root @ away) ** 2)) < _CONTRADICTS:
        return []
    known, ratio = np.sqrt(np.diag(before)), np.abs(away) / np.sqrt(np.diag(total))
    worst = [int(k) for k in np.argsort(-ratio)[:3] if ratio[k] > 0.5 * ratio.max()]
    named = "; ".join(
        f"{_difference_text(k, float(away[k]), float(known[k]))} ({ratio[k]:.1f} sigmas)" for k in worst
    )
    walks = sorted({"soft_iron_walk" if k < 6 else "hard_iron_walk" for k in worst})
    if sufficient:
        remedy = "believe the data, which need no prior to be enough: omit it, or allow for a change"
    else:
        remedy = (
            "the instrument changed, or the field varies here: allow for a change, or record more motion elsewhere"
        )
    return [f"the data contradict the earlier calibration: {named}; {remedy} ({' and '.join(walks)})"]


def doubtful_strength(parameters: Array, covariance: Array, options: SmootherOptions) -> tuple[list[str], Array]:
    """Return a sentence if the field's strength contradicts prior and data, and what an error of it adds.

    Without the fact its residual r at the posterior would be r / (1 − v), of variance 1 / (1 − v), where v is the
    variance of the fact's quantity by the posterior over that by the fact. In a share of places (`_PLACE`) the strength
    is off by more, and θ elsewhere: the square of that distance is added by the probability that the data show of it.

    Args:
        parameters, covariance: posterior of θ, (13,) and (13, 13), which contains the fact.
        options: with the prior, which gives the strength its scale, and the place.

    Returns:
        The sentence, if there is one, and the addition (13, 13) to the covariance.
    """
    fact = next((fact for fact in known_of(options).facts if isinstance(fact, StrengthFact)), None)
    none: list[str] = []
    if fact is None:
        return none, np.zeros_like(covariance)
    (residual,), (slope,) = fact.residual(parameters)
    along = covariance @ slope
    left = 1 - float(slope @ along)
    if left <= 0:
        return none, np.zeros_like(covariance)
    assert options.known_strength is not None
    wider = 1 / left + (_PLACE.off * fact.mean / fact.sigma) ** 2  # variances without the fact, of r / (1 − v)
    nats = 0.5 * (residual**2 / left - (residual / left) ** 2 / wider - math.log(wider * left))
    likelier = math.exp(min(nats, 50.0))
    shown = _PLACE.share * max(likelier - 1, 0.0) / (1 + _PLACE.share * likelier)
    moved = residual / left
    distance = moved * (1 - 1 / (wider * left)) * along
    addition = shown * np.outer(distance, distance)
    if abs(residual) < MODEL.contradicts * math.sqrt(left):
        return none, addition
    there, sigma = 1e6 * options.known_strength, 1e6 * options.known_strength * fact.sigma / fact.mean
    said = (
        f"the field is {there + sigma * moved:.1f} ± {sigma * math.sqrt(1 / left - 1):.2g} µT strong by the earlier "
        f"calibration, {there:.1f} µT at the place ({abs(residual) / math.sqrt(left):.1f} sigmas): omit the place, as "
        "the field indoors and beside iron is not the world's, or allow for a change of the iron (field=, "
        "hard_iron_walk=)"
    )
    return [said], addition


def _difference_text(k: int, away: float, sigma: float) -> str:
    if k < 6:
        return f"soft iron {ENTRIES[k]} by {100 * away:+.2f} %, known to {100 * sigma:.2g} %"
    return f"hard iron {'xyz'[k - 6]} by {1e6 * away:+.2f} µT, known to {1e6 * sigma:.2g} µT"


_MATRIX = 2e-3  # typical sigma of each element of a matrix from an earlier calibration
_OPEN = 1e-3  # T, sigma of an unknown hard iron


def typical_matrix(parameters: Array) -> IronFact:
    """Return the fact that an earlier calibration typically gives: the matrix of θ, with an unknown hard iron."""
    strength, _ = field_strength(parameters[:6])
    sigma = np.concatenate([np.full(6, _MATRIX), np.full(3, _OPEN)])
    return IronFact(parameters[:6] / strength, parameters[6:9], np.diag(1 / sigma))


def remedies(
    fit: Fit, factor: float, enough: Callable[[Array], bool], options: SmootherOptions, recording: Recording
) -> list[str]:
    """Return a sentence on facts that would compensate for too little motion, the cheapest first.

    Each has the sigma that the sensors' noise would leave; what the model may lack is known only with the facts.

    Args:
        fit: at its minimum.
        factor: by which the data's information is divided.
        enough: whether a covariance (13, 13) of θ is small enough.
        options: with the facts that are known already.
        recording: determines whether a vertical is available.
    """
    parameters = fit.state.parameters[:PARAMETERS]
    strength, _ = field_strength(parameters[:6])
    matrix, place = typical_matrix(parameters), StrengthFact(strength, FIELD_SIGMA)
    dip = () if dip_of(fit) is not None else known_dip(recording, fit)
    ways: tuple[tuple[str, str, tuple[Fact, ...]], ...] = (
        ("place and date", "field=", dip),
        ("an earlier calibration of the instrument", "prior=", (matrix,)),
        ("an earlier calibration, place and date", "prior=, field=", (matrix, place)),
    )
    if options.prior is not None:  # with the prior's scale known, the field strength is informative
        known = options.known_strength is not None or not _scaled(options.prior)
        ways = () if known else (("place and date", "field=", (place, *dip)),)
    facts_given = tuple(fact for fact in fit.chain.facts if not on_skew(fact))
    given = quadratic(facts_given, fit.state.parameters)[2]
    every = quadratic(fit.chain.facts, fit.state.parameters)[2]
    data = ((fit.reduced.information - every) / factor + given)[:PARAMETERS, :PARAMETERS]
    found = []
    for name, options_of, facts in ways:
        if not facts:
            continue
        information = data + quadratic(facts, parameters)[2]
        covariance = inverse_information(information, fit.free[:PARAMETERS])
        if enough(covariance):
            worst = 1e6 * np.sqrt(max(float(np.linalg.eigvalsh(covariance[6:9, 6:9])[-1]), 0.0))
            found.append(f"{name} ({options_of}: hard iron ±{worst:.2g} µT by sensor noise)")
    return [f"{ENOUGH} {', or with '.join(found)}"] if found else []
