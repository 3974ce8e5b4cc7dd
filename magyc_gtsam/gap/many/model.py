"""The constants that decide in a comparison over many logs, each with its unit and the measurement behind it."""

from __future__ import annotations

from dataclasses import dataclass

from magyc_gtsam.factors.effects.dated import DATED


@dataclass(frozen=True)
class ManyModel:
    """The thresholds for a name over many logs; the prior of the effects is that of one log (`evidence.prior`).

    What is more likely than not, a probability above one half, is taken to be so: whether an effect is the
    instrument's, whether a log has it.

    Attributes:
        shares: shares of the logs that have an effect of the place or the day, equally probable.
        sure: nats of evidence from which something is missing. The strongest of all hypotheses over ten clean logs has
            −1.9 to 0.7 nats (9 such sets of wide and moderate motion). By as much the strongest name must lead,
            otherwise the next is an alternative, and a generic family must lead all names.
        moments: nats by which a name must lead between jumps, drifts and passed objects, whose forms only approximate
            the true one: over ten logs with a jump a quarter the size of a published one, a drift has 3 to 8 nats more
            than the jump.
        generic: share of its own evidence by which a generic family must lead all names, beside `sure`.
        remain: share of the explained evidence that may remain as a rival or as no name, because effects do not quite
            have the catalogue's form.
        remain_apart: the same as an effect that is no rival: effects of twice their published strength leave 0.2 and
            0.4 % of theirs as another one, and a delay beside a current of four times its strength is 6 %.
        rivals: number of sudden effects that are fitted in place of a varying field: jumps of hard and soft iron, and a
            stay beside an object.
        few: share of the logs up to which an effect without a name is attributed to these logs alone.
        most: number of effects at which a search ends.
        alone: nats from which one log alone names an effect on the noise.
        plain: probability from which an effect without a name is attributed to a log.
        least: number of logs needed for a comparison.
        settled: nats for and against effects that are detected with certainty: exchanged axes, held values, coarse
            steps.
    """

    shares: tuple[float, ...] = (0.1, 0.5, 0.9)
    sure: float = 3.0
    moments: float = 10.0
    generic: float = 0.05
    remain: float = 0.08
    remain_apart: float = 0.01
    rivals: int = 3
    few: float = 0.34
    most: int = 5
    alone: float = 6.0
    plain: float = 0.9
    least: int = 2
    settled: float = 20.0


MODEL = ManyModel()
OF_THE_PLACE = (*DATED, "field-gradient")  # whatever their values
OF_THE_INSTRUMENT = ("saturation",)  # its value is a level relative to the readings of a log
