"""What decides in a comparison over many logs, each with its unit and the measurement behind it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ManyModel:
    """The prior of the effects, and from where a name is given.

    Attributes:
        sizes: (squared sigmas of one log) prior variances of an effect's values, all as likely: from what one log
            hardly shows to what is plain in it.
        shares: of the logs that have an effect of the place or the day, all as likely.
        sure: nats, from which something is missing. The strongest of all hypotheses over ten clean logs has −1.9 to
            0.7 nats (9 such sets of wide and moderate motion).
        lead: nats, by which the strongest name must be ahead, or the next is as good.
        moments: nats, likewise between jumps, drifts and passed objects: the forms of a moment are only alike, and a
            jump of a quarter of a published one is held by a drift of ten logs with 3 to 8 nats more.
        generic: nats, and share of its own, by which a family without a name must be ahead of all names.
        remain: share of what was explained that may remain, for effects are not quite of the catalogue's form.
        few: share of the logs up to which what no name explains is these logs' own.
        most: effects, at which a search ends.
        longest: s, correlation time from which noise that hangs together is a drift of something unknown.
        one_way: share of it along one axis, from which it is no noise.
        alone: nats from which one log alone names an effect on the noise.
        has_it: probability from which a log gets an effect of the place; plain: from which what no name explains is a
            log's own.
        mostly: share of the logs, in which a value must be possible.
        least: logs that can be compared.
        settled: nats for and against what is seen or not seen at once: exchanged axes, held values, coarse steps.
    """

    sizes: tuple[float, ...] = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
    shares: tuple[float, ...] = (0.1, 0.5, 0.9)
    sure: float = 3.0
    lead: float = 3.0
    moments: float = 10.0
    generic: tuple[float, float] = (3.0, 0.05)
    remain: float = 0.08
    few: float = 0.34
    most: int = 5
    longest: float = 4.0
    one_way: float = 0.75
    alone: float = 6.0
    has_it: float = 0.5
    plain: float = 0.9
    mostly: float = 0.5
    least: int = 2
    settled: float = 20.0


MODEL = ManyModel()
MOMENTS = ("hard-iron-step", "hard-iron-drift", "local-anomaly")  # at times of a log; they have no one value
OF_THE_PLACE = (*MOMENTS, "field-gradient")  # whatever their values are
OF_THE_INSTRUMENT = ("saturation",)  # its value is a level, relative to what a log read
