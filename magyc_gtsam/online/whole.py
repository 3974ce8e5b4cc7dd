"""Everything that is kept, fitted as the batch method fits a log."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from magyc_gtsam.estimators.chain_fit import Fit
from magyc_gtsam.estimators.chain_search import fit_field_chain, preintegrate, short_term_noise, shortened
from magyc_gtsam.factors.preintegration import Preintegration
from magyc_gtsam.recording import Array, Recording

_MOVED = 3.0  # total spread of the field, in its short-term noise, below which nothing turned


def fit_whole(
    recording: Recording, start: Array | None, options: Mapping[str, Any]
) -> tuple[Fit, Fit | None, Preintegration]:
    """The fit, a close rival, and the windows; from `start` (13,), or from several starts.

    Raises:
        MagycError: axes that disagree, or data too short.
    """
    fit, rival = fit_field_chain(recording, start=start, **options)
    samples = preintegrate(recording, options["window"], options["turn"])
    if len(samples.starts) != len(fit.chain.windows):  # disturbed stretches were found, so shorter windows taken
        samples = preintegrate(recording, shortened(options["window"]), options["turn"])
    return fit, rival, samples


def nothing_turned(recording: Recording) -> str:
    """Why a fit would be in vain; empty where the field varied by more than its noise."""
    field = recording.magnetometer.value
    spread, noise = float(np.sqrt(field.var(axis=0).mean())), short_term_noise(recording).magnetometer
    return "" if spread > _MOVED * noise else "too little motion: nothing turned yet"
