"""The constants that decide what is named and corrected, in one place, each with its unit and reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Rules:
    """What decides; the code that reads a constant says how.

    They were set on earlier editions of the blind test and judged on later ones (`docs/blind_test.md`, which has the
    measurements under "Rules"). What stays beside its algorithm decides nothing: grids, numbers of iterations, and
    tolerances of rounding. What the posterior decides by is in `evidence/prior.py`, what a comparison of many logs does
    in `many/model.py`.
    """

    # What is named and corrected.
    ahead: float = 9.0  # nats of evidence from which a rival is behind
    alike: float = 0.01  # probability below which a named effect adds something beyond its rival
    # share of the entries of an axis that repeat by themselves, from which its steps are coarse
    alone_axis: float = 0.1
    as_good: float = 0.09  # of the shifts, that may explain as much
    # nats, and share, by which a generic family must be ahead of all names: form is less
    beats: tuple[float, float] = (3.0, 0.05)
    beside_colour: float = 1.4  # thresholds that a name must pass beside coloured noise
    blocks: int = 8  # of the held-out veto, at least: each half must hold some of every manoeuvre
    by_chance: float = 0.5  # of the way from a clock's variance of how long rows repeat to that of chance
    # nats by which two fitted parameters of a noise model can seem to gain (with room to spare)
    chance: float = 9.0
    changes: int = 2  # with time, that one recording may hold
    clearly: float = 1.0  # nats by which a name must be ahead of each neighbour; less is a toss-up
    coarse: float = 0.7  # step in sigmas from which quantisation counts
    coloured: float = 3.0  # standard deviations from which an autocorrelation counts
    contradicted: float = 4.0  # sigmas by which the data contradict a parameter that was given
    determined: float = 4.0  # smallest values that matter, up to which a motion determines a value
    # of a prior's deviation, up to which the data have told something of every direction
    determined_by_data: float = 0.75
    # probability of any name by chance, all candidates together, in a recording without an effect
    family_wise: float = 0.01
    field_differs: float = 0.02  # of the field: a degree of heading
    field_varies: float = 5.0  # nats: twice what clean recordings show by chance (at most 2.3)
    firm: float = 0.7  # share of what a term should explain beside whatever else is missing
    held_rows: float = 0.08  # share of rows that repeat exactly
    late: float = 0.01  # rad of a turn
    left: float = 0.2  # share of an effect's statistic that it or a rival may pick up after it
    little: float = 0.3  # share of a term's signature that a family which holds it may lack
    longest_colour: float = 4.0  # s, correlation time beyond which colour is called a drift of something unknown
    lowest_bins: int = 5  # of a tone: slower ones are drifts
    most_of: float = 0.7  # share of a wider family's statistic from which the simple delay is preferred
    most_terms: int = 5  # effects in one recording, at which a search ends
    many: int = 9  # values of one family, from which half of the data do not determine them for the other half
    mostly: float = 0.6  # share that a term must explain of what families that hold its signature could explain
    moved: float = 2.0  # sigmas from which a parameter is reported as moved
    much: float = 60.0  # statistic from which an effect is taken out before the colour is measured
    one_way: float = 0.75  # share of the colour along one axis beyond which it is no noise
    rare: float = 0.05  # share of samples up to which they are single; more is another distribution of the noise
    # share of the repeated entries that chance must leave over: axes that pause together are no hold
    repeats_left: float = 0.7
    same: float = 0.99  # squared cosine between what two explain, from which they are the same
    # share of what was explained that may remain, for effects are not quite of the catalogue's form
    shape: float = 0.08
    shared: float = 0.0001  # share of a signature that must be left beside a rival's to be tested
    slow: float = 1.0  # Hz, up to which windows of a second still show something
    span: float = 2.5  # widths within which a second bump belongs to the first
    spike: float = 4.5  # sigmas, one normal vector in six thousand
    spikes_alone: float = 0.46  # share of them, those side by side counted as one, that have no neighbour
    strong: float = 5.0  # thresholds that a term must pass where something else is missing too
    # nats, and share of the evidence, by which one that is as good as the strongest may be behind
    tie: tuple[float, float] = (3.0, 0.05)
    too_slow: float = 0.7  # of what the channel explains, that it still holds when shifted: it is too slow to tell
    trace: float = 0.03  # share of an effect's statistic below which another may be its form, whatever the name
    tried: int = 3  # names in a tie, at most
    unsure_line: float = 2.0  # nats more that a line must stand out, for the floor below it is estimated
    weak: float = 50.0  # nats, up to which what is small may be the shadow of another effect
    worth_moving: float = 0.5  # sigma, in the mean, by which the iron must move to be moved

    # Which rows and channels are used, before anything is fitted.
    window: float = (
        1.0  # s, of an innovation at most: the field and the bias stand still in it, noise averages out
    )
    pause: float = 10.0  # s, and times the spacing of a channel's own values, up to which its pause is filled
    pause_spacings: float = 5.0
    rows_left_out: float = 0.5  # share of the rows, at most, that a channel's pauses may take; else it is not used
    repeats_by_chance: float = 0.2  # step in sigmas from which values repeat by chance, and are no held samples
    rest_mean: float = 1.0  # s over which readings are averaged to see whether they move
    rest_means: int = 10  # such means that hardly differ are a rest
    rest_same: float = 0.03  # of the field's spread over the recording: less is no move
    rest_near: int = 3  # means beside a rest in which a jump belongs to it
    rest_jump: float = 0.1  # of the field's spread, beyond what the gyroscope turned
    rest_spared: float = 5.0  # s between the samples of a rest that count
    clock_age: float = 1.2  # rows by which the ages of held samples differ, if they come on a clock
    clock_hole: float = 1.5  # steps of the rows from which rows are missing
    clock_samples: int = 10  # from which a clock can be seen
    clock_beat: int = (
        4  # samples, at most, until those of a clock in step meet a row alike: a quarter of a row is open
    )
    clock_in_step: float = 0.99  # of the samples: a row that is late now and then breaks no step
    # T per sample, less than which is no noise: less than a laboratory's fluxgate has, more than rounding to single
    # precision makes; in so many % of the differences, for the others may span what is not smooth
    noiseless: float = 5e-11
    noiseless_share: float = 90.0
    cut_off: float = (
        0.25  # share of the samples, beyond which the model of saturation is sigmas off: 2 at 0.4, 4 at 0.6
    )
    blurred: float = (
        0.2  # of what the model leaves, up to which the staircase of coarse steps is too small to matter
    )

    # Single samples.
    lattice_distinct: float = 0.5  # share of the values that may differ, of readings on a lattice
    lattice_off: float = 0.02  # steps by which gaps between them may miss a multiple
    motion_held: float = 0.98  # share of the field's changes below the edge of the motion's frequencies
    motion_harmonics: float = 2.0  # times that edge, below which a line may be the motion's
    pattern: float = (
        1e-3  # share of a constant's power that uneven stamps put at a frequency, from which it is their own
    )

    # Effects and families.
    block: float = 10.0  # s, of a held-out block at most
    worth_a_look: float = 3.0  # nats from which the held-out gain of a candidate is asked for
    close_rival: float = 0.5  # share of the evidence by which a rival of another shape may be behind
    knots_apart: float = 4.0  # s between knots of a spline in time, at least
    determined_rate: float = 0.016  # to which the motion must determine a scale or an angle of a family
    one_vector: int = 3  # values, up to which the motion determines them alike, and none needs a prior of the data
    unlike_delay: float = 0.7  # times a delay, by which plates differ from it: one by 2.4, one on each axis by 0
    next_order: float = 0.03  # share by which the next order of a delay or a plate, in the speed, may be ahead
    far_from_zero: float = 30.0  # deviations, beyond which a channel's 0 says nothing about where no current flows
    clipped_loss: float = (
        0.12  # of what is beyond a level, lost where it clips; less is a slight bend, and a gain none
    )
    bent_loss: float = 0.3  # of it, lost where it saturates over a knee; less is what a cubic loses
    widest_loop: float = 0.3  # of the field's span, of a hysteresis; right names had 0.2 at most, wrong ones 0.3
    no_loop: float = 0.95  # of the widest: one fitted as wide has run into the limit
    same_row: float = 0.99  # correlation from which two rows of a channel are one

    # What could not be found.
    found_with: float = 0.9  # probability with which the smallest strength that can be told is found
    would_be_found: float = 0.8  # probability from which a candidate that was not significant is rejected
    confused: float = 0.5  # share of the trials from which another name counts as confused with it


RULES = Rules()
