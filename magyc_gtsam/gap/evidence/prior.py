"""What is believed before the data, in one place: each constant with its unit and the reason for it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array


def _octaves() -> Array:
    return 2.0 ** np.arange(-2.0, 6.0)


@dataclass(frozen=True, eq=False)
class Prior:
    """Beliefs, and how far the search follows what is unlikely.

    Attributes:
        scales: of an effect's values, in units of the smallest that matters, each octave as likely as the other:
            from what no motion shows to what no sensor has.
        named: odds of one more name of the catalogue against stopping: one of two recordings has something missing,
            three of four times it is in the catalogue of 22.
        unknown: odds of something that is in no catalogue, in all: the fourth time.
        form: share of the power of what is named that its form may miss. No real effect is of its catalogue form to
            better than a fifth in amplitude (Kennedy and O'Hagan's model discrepancy).
        profile_field, profile_rate: T and rad/s, what matters of a profile without a name.
        modes: of a random walk; what is beyond them is 3 % of it.
        depth, beam: names in one set, and tried beside each.
        nodes, most: sets that are fitted, and with those in which rivals were exchanged.
        close: nats behind the best set, from which none is followed.
        certain: nats for what is seen at once, or not at all.
    """

    scales: Array = field(default_factory=_octaves)
    named: float = float(np.log(0.75 / 22))
    unknown: float = float(np.log(0.25))
    form: float = 0.04
    profile_field: float = 0.3e-6
    profile_rate: float = 1e-3
    modes: int = 24
    depth: int = 4
    nodes: int = 10
    most: int = 16
    beam: int = 3
    close: float = 12.0
    certain: float = 12.0


PRIOR = Prior()
