"""How well a model and a recording agree, and where they do not: values only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from magyc_gtsam.recording import Array


@dataclass(frozen=True, eq=False)
class GapMap:
    """Where the gap is: the misfit over one variable.

    Attributes:
        over: "time", "frequency", "heading", "pitch", "rate", "temperature", "current" or "field strength" (of the
            reading that the model predicts: the reading itself holds the misfit that is to be shown).
        unit: of the variable: "s", "Hz", "°", "rad/s", ….
        centre: (n,) of the bins.
        level: (n,) root mean square of the innovations in sigmas; 1 where the model is right.
        band: (n, 2) where 99 % of the levels lie if the model is right.
        share: (n,) share of the samples in the bin.
    """

    over: str
    unit: str
    centre: Array
    level: Array
    band: Array
    share: Array

    @property
    def worst(self) -> float:
        """The largest level over its upper band."""
        return float((self.level / self.band[:, 1]).max(initial=0.0))


@dataclass(frozen=True)
class Line:
    """A line in the spectrum of the innovations: Hz, amplitude T, and −ln p of its height."""

    frequency: float
    amplitude: float
    evidence: float


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """Prediction of the field over `horizon` seconds by the gyroscope alone.

    Attributes:
        horizon: s.
        time: (n,) s, when the prediction was due.
        error: (n, 3) T, measured − predicted.
        sigma: (n, 3) T, what the twin expects of it.
        rms, floor: T, root mean squares of the two.
    """

    horizon: float
    time: Array
    error: Array
    sigma: Array
    rms: float
    floor: float

    @property
    def excess(self) -> float:
        """T², variance beyond the twin's floor."""
        return max(self.rms**2 - self.floor**2, 0.0)


@dataclass(frozen=True, eq=False)
class Metrics:
    """How well a model and a recording agree.

    Attributes:
        held_out: log-likelihood per window on blocks that were not fitted, nats.
        open_loop: the 20 s prediction against its floor.
        whiteness: ratio of the innovations' autocorrelation to what white noise would show; 1 is white.
        lines: what stands out of the innovations' spectrum, strongest first.
        heading: deg, standard deviation of heading against the reference attitude; None without one.
        noise: standard deviations per sample that the model needs: magnetic_field T, angular_rate rad/s.
        maps: where the gap is.
    """

    held_out: float
    open_loop: OpenLoop
    whiteness: float
    lines: tuple[Line, ...]
    heading: float | None
    noise: Mapping[str, float]
    maps: tuple[GapMap, ...]
