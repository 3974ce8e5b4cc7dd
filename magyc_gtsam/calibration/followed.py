"""The channels of other data that the terms of a calibration follow: those with whose names they were found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from magyc_gtsam.factors.effects.changes import referenced
from magyc_gtsam.factors.effects.signals import kinds, rows_by_kind, rows_of, stands_in
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import listed
from magyc_gtsam.recording import Array


def followed(channels: Mapping[str, Array], terms: Sequence[Term]) -> dict[str, Array]:
    """Return channels without those that count as one of a kind that a term follows, and are another quantity.

    A throttle is no current, though it stands for one in a log that has none. The data may hold a channel under
    another name than the log in which the term was found.

    Args:
        channels: {name: (n,) or (n, k)}.
        terms: of a calibration; those that do not know the names of their channels take what is of the kind.

    Raises:
        MagycError: another quantity, or another channel of the log, stands where a term's own was.
    """
    kept = dict(channels)
    for term in terms:
        kind, names = term.kind, term.channels
        if kind is None or not names:
            continue
        instead = stands_in(names[0], kind)
        of_kind = [name for name in kept if kind in kinds(name)]
        others = [name for name in of_kind if stands_in(name, kind) != instead]
        if len(others) < len(of_kind):
            kept = {name: value for name, value in kept.items() if name not in others}
        rows = rows_by_kind(kept).get(kind, ())
        known = {row for name in of_kind for row in rows_of(name, channels[name])} & set(names)
        counted = [i for i in referenced(names, term.setting) if i < len(rows)]
        if any(stands_in(row, kind) != instead for row in rows) or (
            known and any(rows[i] != names[i] for i in counted)
        ):
            raise MagycError(
                f"the term {term.name!r} of the calibration follows {listed(names)}, and the data have "
                f"{listed(rows)} instead; the recording must have the same channels as the one that was calibrated"
            )
    return kept


def of_one_quantity(channels: Mapping[str, Array], instead: dict[str, bool]) -> dict[str, Array]:
    """Return the channels of one of several logs, without those that are another quantity than in the logs before.

    Args:
        channels: {name: (n,) or (n, k)}.
        instead: {kind: whether something stands for it} in the logs before; completed by this one.
    """
    for kind, rows in rows_by_kind(channels).items():
        instead.setdefault(kind, stands_in(rows[0], kind))
    return {
        name: value
        for name, value in channels.items()
        if all(stands_in(name, kind) == instead.get(kind, False) for kind in kinds(name))
    }
