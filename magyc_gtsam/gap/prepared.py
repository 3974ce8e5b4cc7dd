"""A recording before the search, alone or among many: prepared, with the base model, and whether it can be tested."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.model_error.samples import flickers
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.estimators.smoother.truncated import without_truncation
from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.model.base import base_model, needs_gyroscope
from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.outcome.corrected import as_calibration
from magyc_gtsam.gap.preparation.channel_holes import without_channel_holes
from magyc_gtsam.gap.preparation.discrete import noiseless, settled
from magyc_gtsam.gap.result import Doubt
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.noise_effects import NoiseScore
from magyc_gtsam.gap.samples.tones import silenced
from magyc_gtsam.observability import Observability, assess
from magyc_gtsam.recording import Recording
from magyc_gtsam.sensor_faults.usable import Usable, without_faults

_MEND = "choose an interval without it (start=, end=), or have the sensor repaired"
_ADD_NOISE = "give the simulated sensors the noise of the real ones, or record a log"
_LOG_SAMPLES = "log its own samples with their times, or give the rows in which it is new"
_SILENT = f"a misfit has nothing to be measured against; {_ADD_NOISE}"
_PER_WINDOW = 0.5e6  # bytes of the search where the field varies; 0.3e6 without


def _expect_memory(windows: int, duration: float) -> None:
    """Raise a MagycError if the search needs more memory than the machine has."""
    needed, present = _PER_WINDOW * windows, memory()
    if needed > present:
        hours = duration / 3600 * present / needed
        raise MagycError(
            f"the gap of {duration / 3600:.1f} h takes some {needed / 1e9:.0f} GB of memory, and this machine has "
            f"{present / 1e9:.0f} GB: choose an interval of at most {hours:.1f} h (start=, end=)"
        )


def memory() -> float:
    """Return the memory of the machine, bytes; infinity where the system does not say."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # no such function on Windows
        return float("inf")


@dataclass(frozen=True, eq=False)
class Prepared:
    """A recording that is ready for the search.

    Attributes:
        usable: the recording as it was given, without faults of the sensors.
        recording: with its channels' pauses, axes, rows, known tones and truncated rates corrected.
        left_out: what was left out for its channels' pauses and truncated rates, in words.
        discrete: tests of the effects that were corrected.
        short_term: noise of the sensors from sample to sample.
        base: the fitted model without further effects.
    """

    usable: Usable
    recording: Recording
    left_out: list[str]
    discrete: tuple[NoiseScore, ...]
    short_term: SensorNoise
    base: Refit

    @classmethod
    def of(cls, recording: Recording, names: Sequence[str], calibration: Calibration | None = None) -> Prepared:
        """Prepare a recording for the candidates `names`, and fit the base model, or that of a given calibration.

        Raises:
            MagycError: no gyroscope, data that cannot be calibrated, or too long for the memory.
        """
        needs_gyroscope(recording)
        usable = without_faults(recording)
        recording, left_out = without_channel_holes(usable.recording)
        recording, discrete = settled(recording, names)
        tones = () if calibration is None else tuple(t for t in calibration.terms if t.name == "tone")
        recording = silenced(recording, tones)
        short_term = short_term_noise(recording)
        base = base_model(recording, calibration, short_term)
        recording, _, truncated = without_truncation(
            recording,
            base.twin.fit(),
            lambda again: base_model(again, calibration, short_term).twin.fit(),
            ("gyroscope",),
        )
        if truncated:
            left_out += [one.error for one in truncated]
            base = base_model(recording, calibration, short_term)
        _expect_memory(base.twin.n, recording.duration)
        return cls(usable, recording, left_out, discrete, short_term, base)

    def untestable(self) -> tuple[str, Doubt] | None:
        """Return why nothing can be tested, in full and in few words with a remedy; None if there is enough to test."""
        stuck = flickers(self.usable.recording)
        if stuck:  # as `calibrate` says; no effect of the catalogue explains such an axis
            return f"{stuck}: {_MEND}", Doubt(stuck, _MEND)
        motion = self._determined()
        if not motion.observable:
            weakest = motion.weak[0]
            doubt = Doubt(f"too little motion to determine the {weakest.what}", weakest.remedy)
            return f"too little motion: {weakest.sentence}", doubt
        if noiseless(self.recording):
            silence = f"the magnetometer has no measurable noise (under {RULES.noiseless * 1e9:.2g} nT)"
            return f"{silence}: {_SILENT}", Doubt(silence, _ADD_NOISE)
        return None

    def too_smooth(self) -> tuple[str, Doubt]:
        """Return the same where the noise from row to row cannot measure the misfit."""
        noise, misfit = self.short_term.magnetometer * 1e9, self.base.model.noise.magnetometer * 1e9
        why = (
            f"the magnetometer's noise from row to row ({noise:.1g} nT) is too small to measure a misfit of "
            f"{misfit:.0f} nT with, as that of readings that were interpolated onto the rows"
        )
        return why, Doubt("the magnetometer's readings seem to be interpolated onto the rows", _LOG_SAMPLES)

    def _determined(self) -> Observability:
        """Return what the motion determines at the noise of the sensors alone, without the misfit of an effect."""
        base = self.base
        fitted = as_calibration(replace(base, converged=False), None)  # not yet to be trusted, whatever its values
        assert fitted.covariance is not None
        assert fitted.field_strength is not None
        share = min(1.0, (self.short_term.magnetometer / base.model.noise.magnetometer) ** 2)
        covariance = share * fitted.covariance
        return assess(covariance, fitted.soft_iron, fitted.field_strength, self.recording, fitted.hard_iron)
