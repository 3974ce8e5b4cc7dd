"""Values that describe the agreement of a model and a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from magyc_gtsam.recording import Array


@dataclass(frozen=True, eq=False)
class GapMap:
    """The misfit as a function of one variable.

    Attributes:
        over: "time", "frequency", "heading", "pitch", "rate", "temperature", "current" or "field strength" (of the
            reading that the model predicts, because the measured reading contains the misfit).
        unit: of the variable: "s", "Hz", "°", "rad/s", ….
        centre: (n,) of the bins.
        level: (n,) root mean square of the innovations in sigmas; 1 if the model is right.
        band: (n, 2) interval that contains 99 % of the levels if the model is right.
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
        """Return the largest ratio of a level to the upper limit of its band."""
        return float((self.level / self.band[:, 1]).max(initial=0.0))


@dataclass(frozen=True)
class Line:
    """A line in the spectrum of the innovations: Hz, amplitude T, and −ln p of its height."""

    frequency: float
    amplitude: float
    evidence: float


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """The prediction of the field over `horizon` seconds by the gyroscope alone.

    Attributes:
        horizon: s.
        time: (n,) s, of the predicted fields.
        error: (n, 3) T, measured − predicted.
        sigma: (n, 3) T, standard deviation of the error according to the twin.
        rms, floor: T, root mean squares of error and sigma.
    """

    horizon: float
    time: Array
    error: Array
    sigma: Array
    rms: float
    floor: float

    @property
    def excess(self) -> float:
        """Return the variance beyond the twin's floor, T²."""
        return max(self.rms**2 - self.floor**2, 0.0)


@dataclass(frozen=True, eq=False)
class Metrics:
    """The agreement of a model and a recording.

    Attributes:
        held_out: log-likelihood per window on blocks that were not fitted, nats.
        open_loop: the 20 s prediction and its floor.
        whiteness: ratio of the innovations' autocorrelation to that of white noise; 1 is white.
        lines: lines in the spectrum of the innovations, strongest first.
        heading: standard deviation of the heading against the reference attitude, deg; None without one.
        noise: standard deviations per sample that the model needs: magnetic_field T, angular_rate rad/s.
        maps: the misfit as a function of each variable.
    """

    held_out: float
    open_loop: OpenLoop
    whiteness: float
    lines: tuple[Line, ...]
    heading: float | None
    noise: Mapping[str, float]
    maps: tuple[GapMap, ...]
