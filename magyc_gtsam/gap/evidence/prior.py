"""The prior in one place: each constant with its unit and the reason for it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array


@dataclass(frozen=True, eq=False)
class Prior:
    """Prior probabilities, and limits of the search.

    Attributes:
        scales: of an effect's values, in units of the smallest that matters; all octaves are equally probable: from
            undetectable by any motion to larger than in any sensor.
        nothing: log odds of a recording with sensor noise only, against any other: three of four have an effect,
            however small.
        named: log odds of one more effect of the catalogue against none: of each, as when three of four effects were
            among the 22 that it had then.
        unknown: log odds of an effect outside the catalogue against none, all together: two of five effects. At 0.25
            one of 19 foreign recordings of edition 36 was given a name, at 0.5 and 1 none; of 19 with one effect none
            lost its name.
        unforeseen: probability, whatever the data, of an effect that this comparison does not contain: a posterior over
            hypotheses does not include the case that all of them are wrong. Of 52 statements above 0.99 without it
            (editions 53 and 54, 0.999 on average) 2 are false, of 78 from 0.95 before none: 2 of 130 (95 %: 0.002 to
            0.055; by Laplace's rule 0.023).
        unforeseen_in_room: the same where the field varies, of an effect in the place of the names: what varies has no
            form, and a part of it may look like a name. Of 249 statements of 0.95 and more about what was put into six
            real logs (editions 383 to 385, 387 and 388), 0.975 on average without it, 18 are false. Judged on edition
            390.
        imitated: log odds that an apparent effect of the catalogue is a part of an effect outside it of which nothing
            else is seen (log score on edition 41: 0.926, 0.927 at 0.15 and 0.929 at 0.2).
        each_more: log odds that one cause outside the catalogue, of which something is seen, resembles one more effect.
            It resembles a first one with even odds: in 6 of 14 foreign recordings of edition 207 with a certain unknown
            effect one effect of the catalogue is significant beside it.
        rarely: log odds that such a cause resembles an effect that every instrument has in such a size
            (`EffectTerm.ordinary`). Chosen on BROAD 01, five names of which have 0.87 to 0.95 with it and 0.51 to 0.65
            without; judged on the put-in effects of edition 376.
        all_named: log odds that nothing of such a cause is detected as unknown beside the effects that it resembles. A
            magnet that rolls or is turned resembles three to six effects, beside an unknown one or not. It was chosen
            with `each_more` on the foreign recordings of edition 311 and the real ones of edition 312.
        rest: power of the other effects and of what is unknown, relative to that of the largest effect, from which all
            may be of one cause. In six foreign recordings of edition 207 that resemble one effect it is 0.7 to 4. With
            0.25 a varying field is named beside one more magnet of edition 311; with 0.06 a step beside a small lag
            that is not quite a delay is uncertain.
        shares: power of the rest of such a cause relative to the imitated effect, all equally probable. Of several
            effects that it resembles together, the smallest share is the least.
        form: share of the power of an effect's signal by which it may deviate from its form. No real effect has its
            catalogue form to better than a fifth in amplitude (Kennedy and O'Hagan's model discrepancy).
        form_of_field: the same of the varying field, a third in amplitude: it is modelled by functions of time and of
            attitude alone. Of the names given beside it to 359 real logs with an effect put in (editions 385, 387, 388
            and 390, at 0.06), 13 of 23 that are not there have less than 0.1 of its power, and 4 of 250 that are there.
            Judged on edition 391.
        beside_field, in_place_of_field: least power of a fitted name relative to that of the varying field, beside the
            field and in its place. Functions of time and attitude can explain most of what an effect does, and then
            little remains for the effect beside them; in their place it explains as much as a third of what varies. Of
            the names in the best sets of 338 real logs with an effect put in (editions 390 to 392), 6 of 251 that are
            there have less, and 61 of 84 that are not; 20 and 68 have less than a tenth beside the field. An
            object in the surroundings is a part of the field: it needs `form_of_field` beside it.
        form_of_colour: the same of all names for correlated noise beside a varying field, three tenths in amplitude: it
            has a hundred columns and more and explains all of a deviation, where any family explains a part. In 18 real
            logs with such noise put in it has 0.095 to 5 of the power that it could explain of the names' signal; of
            nine others where it was named (editions 387, 388 and 390) six have 0.06 to 0.09, and three, beside
            something unknown, 0.2 to 0.8.
        profile_field, profile_rate: smallest value of a generic profile that matters, T and rad/s.
        depth, beam: largest number of effects in a set, beside a varying field, and candidates that extend each set.
        nodes, most: largest number of fitted sets, without and with the sets in which rivals were exchanged.
        close: nats below the best set beyond which a set is not extended.
        alike: nats between two candidates in the linear model, below which their order may be another one at the
            minimum: in a cut of BROAD 06 an object and a current that are 0.2 nats apart gain 96 nats in place of 44.
            Judged on the put-in effects of editions 387 and 388.
        unrivalled: share of what an effect explains, below which its rivals in its place are not tried beside one more
            effect. At a half an exchange that succeeds there is missed in one of 64 logs.
        named_from: probability above which an effect is named: a wrong name costs as much as four missing ones.
        missing_from: probability above which something without a name is said to be present: the calibration is then
            not trusted.
        improbable: probability below which an effect is neither a rival nor possible.
        certain: nats for effects that are detected with certainty or not at all.
        world_ahead: nats by which a varying field must explain more than the same variation in the sensor's axes, so
            that no unknown cause is taken for it; both are approximate. It is 28 to 137 in four real rooms, and at most
            8 for three foreign effects of edition 314, on which it was chosen. In place of the field alone, such a
            cause must explain as much itself: clean recordings reach 6 nats by chance.
        whole: probability that a family is present as a whole, not in one of its parts.
        not_quite: log odds that an effect visibly deviates from its form, by less than `form`.
        beyond: largest scale of an effect's values, relative to its largest possible value.
        misfit: standard deviations of white noise's mean square from which a varying field is tested.
        least_power: smallest power, in squared sigmas, assumed for the direction of a function of time along one axis.
        one_of_families: log number of families, one of which is colour along one direction.
        hardly_single: log odds below which an effect on single samples is left out.
    """

    scales: Array = field(default_factory=lambda: 2.0 ** np.arange(-2.0, 6.0))
    nothing: float = float(np.log(1 / 3))
    named: float = float(np.log(0.75 / 22))
    unknown: float = float(np.log(0.5))
    unforeseen: float = 0.015
    unforeseen_in_room: float = 0.05
    imitated: float = float(np.log(0.1))
    each_more: float = float(np.log(2.5))
    rarely: float = float(np.log(0.07))
    all_named: float = float(np.log(0.002))
    rest: float = 0.125
    shares: Array = field(default_factory=lambda: 4.0 ** np.arange(-2.0, 1.0))
    form: float = 0.04
    form_of_field: float = 0.1
    beside_field: float = 0.03
    in_place_of_field: float = 0.3
    form_of_colour: float = 0.09
    profile_field: float = 0.3e-6
    profile_rate: float = 1e-3
    depth: int = 6
    nodes: int = 10
    most: int = 16
    beam: int = 3
    close: float = 12.0
    alike: float = 3.0
    unrivalled: float = 1 / 3
    named_from: float = 0.8
    missing_from: float = 0.9
    improbable: float = 0.05
    certain: float = 12.0
    world_ahead: float = 12.0
    whole: float = 0.5
    not_quite: float = float(np.log(0.5))
    beyond: float = 0.5
    misfit: float = 3.0
    least_power: float = 4.0
    one_of_families: float = float(np.log(20))
    hardly_single: float = -3.0


PRIOR = Prior()
