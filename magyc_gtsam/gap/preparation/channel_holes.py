"""Channels with missing values: short pauses are interpolated, rows of long pauses are left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.effects.signals import kinds
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.pauses import filled


def without_channel_holes(recording: Recording) -> tuple[Recording, list[str]]:
    """Return the rows in which all channels that effects read are known, and sentences on what was left out.

    A change of a current during a pause of its channel would otherwise be taken for a step.
    """
    time, said = recording.time, []
    known = np.ones(len(time), dtype=bool)
    channels = dict(recording.channels)
    for name in filter(kinds, recording.channels):
        columns = recording.channels[name].reshape(len(time), -1).T
        if np.isfinite(columns).all():
            continue
        rows_filled = [filled(time, column) for column in columns]
        there = np.all([have for _, have in rows_filled], axis=0)
        if (known & there).mean() < 1 - RULES.rows_left_out:
            channels[name] = np.full_like(recording.channels[name], np.nan)
            said.append(f"{name}, which was logged in {there.mean():.0%} of the rows only")
            continue
        channels[name] = np.stack([column for column, _ in rows_filled]).T.reshape(recording.channels[name].shape)
        if not there.all():
            rows = np.flatnonzero(~there)
            said.append(
                f"{len(rows)} rows from {time[rows[0]]:.1f} to {time[rows[-1]]:.1f} s, in which {name} was not logged"
            )
        known &= there
    return replace(recording, channels=channels).rows(known), said
