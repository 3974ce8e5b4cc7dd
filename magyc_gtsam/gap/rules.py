"""Constants that decide about data, effects and corrections, in one place, each with its unit and reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Rules:
    """The thresholds; the code that uses one determines how.

    They were set on earlier editions of the blind test and evaluated on later ones (`docs/blind_test.md`, which has the
    measurements under "Rules of data and effects"). Constants that decide nothing (grids, numbers of iterations,
    tolerances of rounding) are beside their algorithms. What is named is decided by the posterior, whose constants are
    in `evidence/prior.py`; those of a comparison of many logs are in `many/model.py`.
    """

    # What is tested and corrected.
    blocks: int = 8  # of the held-out test, at least, so that each half contains some of every manoeuvre
    # nats that two fitted parameters of a noise model may gain by chance (with a margin)
    chance: float = 9.0
    coarse: float = 0.7  # step in sigmas above which quantisation is an effect
    # the same for readings that are truncated: noise does not blur the jump where their sign changes; steps of a fifth
    # of the noise bend the reading so that they were called a cubic
    truncated: float = 0.2
    contradicted: float = 4.0  # sigmas above which the data contradict a parameter of a given calibration
    # sigma, relative to the prior's, up to which the data determine a direction of the values
    determined_by_data: float = 0.75
    # probability that noise alone makes any effect on the noise significant, or rejects any assumption of a simulator
    family_wise: float = 0.01
    # prior standard deviations beyond which a value is not possible; a scale that grew by 95 % per rad/s fitted a phone
    # in a pocket
    farthest: float = 4.0
    field_differs: float = 0.02  # of the field: a degree of heading
    field_varies: float = 5.0  # nats: twice the largest value of clean recordings (2.3)
    late: float = 0.01  # rad of rotation
    longest_colour: float = 4.0  # s, correlation time above which colour is a drift of unknown cause
    lowest_bins: int = 5  # of the periodogram, too slow for a tone: they are drifts
    moved: float = 2.0  # sigmas above which a parameter is reported as moved
    one_way: float = 0.75  # share of the colour along one axis above which it is not noise
    rare: float = 0.05  # share of wrong samples; a larger one is another distribution of the noise
    span: float = 2.5  # times the sum of their widths within which a second bump belongs to the first
    spike: float = 4.5  # sigmas, exceeded by one normal vector in six thousand
    spikes_alone: float = 0.46  # share of the spikes, adjacent ones counted as one, that have no neighbour
    # nats that a line loses, because the floor below it is estimated: in its level and in its odds
    unsure_line: float = 2.0
    worth_moving: float = 0.5  # root mean square change of the iron, in sigmas, above which it is changed

    # Which rows and channels are used, before the estimation.
    # s, maximum length of an innovation's window, and of a mean by which a rest is detected: field and bias are
    # constant in it, noise averages out
    window: float = 1.0
    rows_left_out: float = 0.5  # share of the rows that a channel's pauses may take; with more it is not used
    rest_means: int = 10  # number of such means that hardly differ, from which they are a rest
    rest_same: float = 0.03  # of the field's spread over the recording, below which means hardly differ
    rest_near: int = 3  # means beside a rest in which a jump belongs to it
    rest_jump: float = 0.1  # of the field's spread, beyond the rotation by the gyroscope
    rest_spared: float = 5.0  # s between the samples of a rest that are kept
    clock_age: float = 1.2  # rows, largest difference between the ages of held samples of one clock
    clock_hole: float = 1.5  # row spacings above which rows are missing
    clock_samples: int = 10  # needed to detect a clock
    # samples, longest period of a clock synchronous with the rows: a quarter of a row is uncertain
    clock_beat: int = 4
    clock_in_step: float = 0.99  # share of synchronous samples; the others allow for single late rows
    # T per sample, below which data are noise-free: less than the noise of a laboratory's fluxgate, more than rounding
    # to single precision; in this percentage of the differences, because the others may span a motion that is not
    # smooth
    noiseless: float = 5e-11
    noiseless_share: float = 90.0
    # share of clipped samples above which the saturation model is sigmas off: 2 at 0.4, 4 at 0.6
    cut_off: float = 0.25
    # of the model's residual, below which the mean rounding error of coarse steps does not matter
    blurred: float = 0.2

    # Single samples.
    lattice_distinct: float = 0.5  # share of distinct values, up to which readings may be on a lattice
    lattice_off: float = 0.02  # steps by which distances between values may deviate from a multiple
    motion_held: float = 0.98  # share of the field's changes below the edge of the motion's frequencies
    motion_harmonics: float = 2.0  # times that edge, below which a line may be due to the motion
    # times the level beside it, above which the gyroscope has a line: white noise has 6, hand motions 32 at most, a
    # simulated swell 10,000
    motion_line: float = 30.0
    # times its median, above which the periodogram of uneven times has a line, whose frequency is excluded: a ninth
    # harmonic of BROAD 01's repeated rows, called a tone, has 200; 1.5 % of the frequencies of BROAD are excluded
    pattern: float = 100.0

    # Effects and families.
    block: float = 10.0  # s, of a held-out block at most
    knots_apart: float = 4.0  # s between knots of a spline in time, at least
    one_vector: int = 3  # values; more are determined unequally by a motion, and need a prior from the data
    # smallest number of modes of an irregular drift, beside a straight line, and how many times as many the next has:
    # with 4 and 12 alone, a third of the drifts of twice a published strength were "unknown" beside the drift (edition
    # 355)
    drift_modes: int = 4
    drift_finer: int = 3
    # s, shortest period of these modes: with 7 s a jump in a log of 28 s was called a drift, with 25 s correlated noise
    # was named beside a drift in one of 51 s (edition 332); 9 to 17 s name both
    drift_period: float = 12.0
    far_from_zero: float = 30.0  # deviations above which a channel's 0 need not be the point without current
    # share lost beyond a level by clipping; a smaller loss is a slight bend, a gain is neither
    clipped_loss: float = 0.12
    bent_loss: float = 0.3  # share lost beyond a level by saturation over a knee; a cubic loses less
    # share of the delays' squares that their differences have, below which they are one delay: axes that are read one
    # after the other have 0.4; the two columns more of unequal delays took the place of BROAD 04's one delay
    unequal: float = 0.1
    # rad, root mean square rotation during a stay, at most 1, above which a field of the place is not one of the
    # vehicle: at rest before its magnet is attached BROAD 32 has 0.0001, stays on the motion "tiny" have 1
    stay_turns: float = 0.3
    # change of the field's strength by another place, relative to that of the field, below which a turn is missing:
    # BROAD 01 and 06 have 0.7 to 0.9 on their table, what follows spikes of the gyroscope has 0.01 to 0.12; of fields
    # in a random direction one of ten is below
    stay_stronger: float = 0.1
    # s, between changes that are one event, and before and after a change of the place, when the vehicle moves
    at_once: float = 1.0
    # rad, rotation as above within that time around a change of the place, from which the vehicle moved there: BROAD 01
    # and 06 have 0.05 to 0.6 where they are picked up and put down, BROAD 32 has 0.003 where its magnet is attached
    stay_moves: float = 0.04
    # of the last jump, below which the iron after it is the one before the first jump: what was attached was taken off
    taken_off: float = 0.5
    same_row: float = 0.99  # correlation above which two rows of a channel are the same

    # What could not be found.
    found_with: float = 0.9  # probability with which the smallest nameable strength is found
    would_be_found: float = 0.8  # probability from which a candidate that is not significant is rejected
    confused: float = 0.25  # share of the trials above which another name counts as confused with it


RULES = Rules()
