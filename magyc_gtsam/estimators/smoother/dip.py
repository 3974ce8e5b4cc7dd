"""The known dip of the ambient field as a fact on the angle of the chain's directions below the horizontal.

Over the windows n, with g_n the field's direction and p_n the vertical in the integrated world,

    y(θ) = mean_n arcsin(−g_n(θ) · p_n) ~ N(dip, σ²),   σ² = σ_place² + σ_scatter² + σ_vertical².
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.options import DIP_SIGMA, FIELD_SIGMA, PlaceField
from magyc_gtsam.estimators.smoother.skew import with_angles
from magyc_gtsam.estimators.smoother.vertical import (
    UprightFact,
    independent,
    near,
    upright,
    vertical_of,
    vertical_sigma,
)
from magyc_gtsam.recording import Recording


@dataclass(frozen=True, eq=False, kw_only=True)
class DipFact(UprightFact):
    """The fact y(θ) ~ N(dip, σ²) at a `place` with a known dip."""

    place: PlaceField
    name = "dip"

    @property
    def sentence(self) -> str:
        """See `UprightFact`."""
        assert self.place.dip is not None
        here, there = np.degrees([self.measured, self.place.dip])
        return (
            f"the field dips by {here:.1f}° here and by {there:.1f}° at the place ({self.contradiction:.1f} sigmas), "
            "which is not used: indoors and beside iron the field is not the world's, so calibrate in the open or omit "
            "the dip"
        )

    def linearised(self, fit: Fit) -> DipFact:
        """See `UprightFact`."""
        found = upright(self.vertical, fit)
        if found is None:
            return self
        up, counts, turn = found
        g, dip = fit.state.direction, self.place.dip
        assert dip is not None
        sine = -np.einsum("in,in->n", g, up)
        if not self.vertical.signed and np.median(sine[counts]) * dip < 0:
            up, sine = -up, -sine
        angle = np.arcsin(np.clip(sine, -1.0, 1.0))
        slope = -1 / np.sqrt(np.maximum(1 - sine**2, 1e-4))  # dy/d(g · p)
        weight = counts * near(angle, counts) * fit.weights.window
        weight = weight / weight.sum()
        measured = float(weight @ angle)
        scatter = float(weight @ (angle - measured) ** 2)
        across = g - np.einsum("in,in->n", g, up) * up
        lever = np.einsum("n,in,ijn->j", weight * slope, across, turn)
        spread = scatter / independent(fit.chain.windows)
        sigma = float(np.sqrt(self.place.dip_sigma**2 + spread + vertical_sigma(self.vertical, lever) ** 2))
        return self.at_minimum(fit, weight * slope * up, measured, dip, sigma)


def dip_fact(recording: Recording, place: PlaceField | None) -> tuple[DipFact, ...]:
    """Return the fact, not yet linearised; empty if the dip is unknown or the recording has no vertical."""
    if place is None or place.dip is None:
        return ()
    found = vertical_of(recording)
    return () if found is None else (DipFact(vertical=found, place=place),)


def dip_of(fit: Fit) -> DipFact | None:
    """Return the dip fact of a fit, or None."""
    return next((fact for fact in fit.chain.facts if isinstance(fact, DipFact)), None)


def known_dip(recording: Recording, fit: Fit) -> tuple[DipFact, ...]:
    """Return a hypothetical fact that the fit's own dip is known with the sigma of a place.

    The result is empty if the recording has no vertical.
    """
    place = PlaceField(1.0, FIELD_SIGMA, 0.0, DIP_SIGMA)
    linear = (fact.linearised(fit) for fact in dip_fact(recording, place))
    parameters = with_angles(fit.state.parameters)
    return tuple(replace(fact, value=0.0, at=parameters) for fact in linear if fact.used)
