"""What `find_gap` named as a factor for a graph of the user's own."""

from __future__ import annotations

from dataclasses import replace

import gtsam

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.chain_search import preintegrate
from magyc_gtsam.factors.effect_factor import effect_chain_factor
from magyc_gtsam.factors.effects import FORMS, Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.field_chain import Noise
from magyc_gtsam.gap.problem import Problem
from magyc_gtsam.gap.twin import Twin
from magyc_gtsam.gap.validation import as_model
from magyc_gtsam.recording import Recording


def term_factor(
    recording: Recording,
    calibration: Calibration,
    term: Term,
    keys: tuple[int, int, int, int],
    *,
    window: float = 1.0,
    soft_iron_unit: float = 1e-6,
    field_unit: float = 1e-6,
) -> gtsam.CustomFactor:
    """A factor over a whole recording on soft iron, hard iron, gyroscope bias and the value of one term.

    Its columns are those of `calibration` on this recording; the calibration's delay is held.

    Args:
        recording: the data.
        calibration: what `find_gap` returned, or any with noise and field strength; its other terms are not in the
            factor.
        term: of the catalogue but a timing, which is `field_chain_factor`'s own variable. Its value's unit is SI.
        keys: of soft iron, hard iron, gyroscope bias and value, as in `effect_chain_factor`.
        window: s.
        soft_iron_unit, field_unit: T per unit of the keys.

    Raises:
        MagycError: a term that is no effect on a reading, or that needs a channel which the recording lacks.
    """
    if term.side is None or term.name == "timing":
        raise MagycError(f"term {term.name!r}: no factor of its own; a delay is a variable of field_chain_factor")
    problem = Problem.of(recording, preintegrate(recording, window))
    twin = Twin.of(problem, as_model(problem, replace(calibration, terms=())))
    form = FORMS[term.name]
    on_rate = form.side == "gyroscope"
    columns = form.columns(twin.gyroscope if on_rate else twin.windows, term.setting)
    return effect_chain_factor(
        *keys,
        problem.samples,
        columns,
        Noise(calibration.noise["magnetic_field"], calibration.noise["angular_rate"]),
        side="gyroscope" if on_rate else "magnetometer",
        delay=calibration.delay,
        soft_iron_unit=soft_iron_unit,
        field_unit=field_unit,
    )
