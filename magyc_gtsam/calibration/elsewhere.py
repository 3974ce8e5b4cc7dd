"""What a calibration holds on a given recording: its dated terms belong to the recording in which they were found."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from magyc_gtsam.calibration.followed import followed
from magyc_gtsam.factors.chain.vech import SYMMETRIC_UNITS, vech
from magyc_gtsam.factors.effects.changes import referenced
from magyc_gtsam.factors.effects.dated import DATED, afterwards, lasts
from magyc_gtsam.factors.effects.forms import FORMS
from magyc_gtsam.factors.effects.signals import channels_by_kind, rows_by_kind
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.recording.fingerprint import fingerprint, first_shared
from magyc_gtsam.recording.pauses import filled, spans


class TermWarning(UserWarning):
    """A term is corrected otherwise than in the recording in which it was found, or by a channel that paused."""


def on_recording(calibration: Any, data: Any) -> tuple[Any, list[str]]:
    """Return what a calibration holds on the data to which it is applied, and sentences on what is not exact there.

    Args:
        calibration: a `Calibration`, which calls this; or None.
        data: a recording; for arrays it stays as it is, and for a recording where its own are not known.
    """
    if calibration is None or not isinstance(data, Recording):
        return calibration, []
    notes: list[str] = []
    dated = list(dict.fromkeys(term.name for term in calibration.terms if term.name in DATED))
    if dated and not calibration.fitted_to:
        notes = [
            f"{name}: the calibration does not state the recording in which it was found, outside which its times are "
            "wrong; diagnose that log again with `magyc-gtsam gap`"
            for name in dated
        ]
    elif dated and first_shared(fingerprint(data), calibration.fitted_to) is None:
        calibration, notes = elsewhere(calibration)
    return calibration, notes + _unknown_channels(data, calibration.terms)


def warn_of(notes: list[str]) -> None:
    """Warn the caller's caller of each sentence."""
    for note in notes:
        warnings.warn(f"apply: {note}", TermWarning, stacklevel=3)


def elsewhere(calibration: Any) -> tuple[Any, list[str]]:
    """Return what a calibration holds on another recording than its own, and a sentence on each term that changes.

    What jumped and stayed is in the parameters; its covariance is added to theirs, which is an upper limit, since the
    iron before a jump and the jump are anticorrelated. Other terms that are dated are left out.
    """
    if not any(term.name in DATED for term in calibration.terms):
        return calibration, []
    after = afterwards(calibration.soft_iron, calibration.hard_iron, calibration.gyro_bias, calibration.terms)
    covariance = calibration.covariance
    if covariance is not None:
        covariance = sum((_added(term, calibration) for term in after.jumps), covariance)
    result = replace(
        calibration,
        soft_iron=after.soft_iron,
        hard_iron=after.hard_iron,
        gyro_bias=after.gyro_bias,
        covariance=covariance,
        terms=tuple(term for term in after.terms if term.name not in DATED),
    )
    return result, [_said(term) for term in calibration.terms if term.name in DATED]


def _added(jump: Term, calibration: Any) -> Array:
    """Return the covariance of a jump, where the calibration's has its parameter."""
    result = np.zeros_like(calibration.covariance)
    if jump.name == "soft-iron-step":
        product = SYMMETRIC_UNITS @ calibration.soft_iron
        to_parameters = vech(0.5 * (product + np.swapaxes(product, 1, 2)))
        result[:6, :6] = to_parameters.T @ jump.covariance @ to_parameters
    elif jump.name == "hard-iron-step":
        result[6:9, 6:9] = jump.covariance
    elif calibration.gyro_bias is not None:
        result[9:, 9:] = jump.covariance
    return result


def _said(term: Term) -> str:
    if lasts(term):
        return (
            f"{term.name}: found at {term.setting['time']:.1f} s of another recording, it counts as set in for the "
            "whole of this one; a log from before the jump needs a calibration of its own"
        )
    return f"{term.name}: left out, since it belongs to the time of another recording, in which it was found"


def _unknown_channels(recording: Recording, terms: tuple[Term, ...]) -> list[str]:
    """Return a sentence on each long pause of a channel that a term follows."""
    channels = followed(recording.channels, terms)
    rows, names = channels_by_kind(channels), rows_by_kind(channels)
    said = []
    for term in terms:
        needed = FORMS[term.name].needs if term.subtracted else ()
        for kind, row in [(k, i) for k in rows if k in needed for i in referenced(rows[k], term.setting)]:
            if row >= len(rows[kind]) or not np.isfinite(rows[kind][row]).any():
                continue  # refused where the term is evaluated
            known = filled(recording.time, rows[kind][row])[1]
            said += [
                f"{names[kind][row]}: not logged from {first:.1f} to {last:.1f} s; there {term.name} is corrected by "
                "interpolated values, and the result may be wrong"
                for first, last in spans(recording.time, known)
            ]
    return said
