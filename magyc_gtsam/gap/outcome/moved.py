"""Parameters that the effects moved, and parameters of a given calibration that the data contradict."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.result import Moved
from magyc_gtsam.gap.rules import RULES

_PARAMETERS = (("soft_iron", "%", 1e2), ("hard_iron", "µT", 1e6), ("gyro_bias", "mrad/s", 1e3))
_BIAS = "gyro bias"


def moved(before: Calibration, after: Calibration) -> tuple[Moved, ...]:
    """Return the parameters of the base model that the effects moved, the largest move in sigmas first."""
    return _beyond(RULES.moved, _parameters(before, after))


def against(given: Calibration, refitted: Calibration) -> tuple[Moved, ...]:
    """Return the parameters and term values of a given calibration that the data contradict, largest first."""
    return _beyond(RULES.contradicted, [*_parameters(given, refitted, given), *_terms(given, refitted)])


def contradiction(rows: Sequence[Moved]) -> str:
    """Return `against` in words; empty if only the gyroscope's bias differs, which changes from day to day."""
    lasting = [row for row in rows if not row.name.startswith(_BIAS)]
    if not lasting:
        return ""
    worst = lasting[0]
    more = f" and {len(lasting) - 1} more" if len(lasting) > 1 else ""
    off = f"{worst.after - worst.before:.3g}".replace("-", "−")
    return (
        f"the calibration given does not fit these data, {worst.name} is off by {off} {worst.unit} "
        f"({abs(worst.sigmas):.0f} sigmas){more}, and was fitted anew; "
    )


def _beyond(limit: float, rows: Sequence[Moved] | Iterator[Moved]) -> tuple[Moved, ...]:
    return tuple(sorted((r for r in rows if abs(r.sigmas) > limit), key=lambda row: -abs(row.sigmas)))


def _parameters(before: Calibration, after: Calibration, uncertain: Calibration | None = None) -> Iterator[Moved]:
    """Return all parameters of both, with the sigmas of `after`, combined with those of `uncertain` if given."""
    for name, unit, scale in _PARAMETERS:
        one, two = getattr(before, name), getattr(after, name)
        if one is None or two is None:
            continue
        sigma = np.hypot(after.sigma[name], 0.0 if uncertain is None else uncertain.sigma.get(name, 0.0)) * scale
        for at in [(i, j) for i in range(3) for j in range(i, 3)] if one.ndim == 2 else [(i,) for i in range(3)]:
            label = f"{name.replace('_', ' ')} {''.join('xyz'[i] for i in at)}"
            yield Moved(label, float(one[at]) * scale, float(two[at]) * scale, float(sigma[at]), unit)


def _terms(given: Calibration, refitted: Calibration) -> Iterator[Moved]:
    """Return the values of the given terms, in the order in which the model contains them."""
    known = [term for term in given.terms if term.side is not None and term.name != "tone"]
    for old, new in zip(known, refitted.terms, strict=False):
        term = TERMS[old.name]
        sigma = np.hypot(old.sigma, new.sigma) * term.scale
        for i, part in enumerate(term.names(len(old.value))):
            values = float(old.value[i]) * term.scale, float(new.value[i]) * term.scale
            label = f"{term.label}, {part}" if len(old.value) > 1 else term.label
            yield Moved(label, *values, float(sigma[i]), term.unit)
