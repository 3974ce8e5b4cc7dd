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
        product: log odds that the product of an effect with another signal is present in the place of the effect.
        unforeseen: probability, whatever the data, of an effect that this comparison does not contain: a posterior over
            hypotheses does not include the case that all of them are wrong. Of 1,400 names above 0.999 without it
            (edition 411, wide and moderate) 5 are false (0.001 to 0.008); of 52 of editions 53 and 54 were 2.
        unforeseen_in_room: the same where the field varies, of an effect in the place of the names: what varies has no
            form, and a part of it may look like a name. Of 249 statements of 0.95 and more about what was put into six
            real logs (editions 383 to 385, 387 and 388), 0.975 on average without it, 18 are false. Judged on edition
            390.
        form: share of the power of an effect's signal by which it may deviate from its form. No real effect has its
            catalogue form to better than a fifth in amplitude (Kennedy and O'Hagan's model discrepancy). Of the varying
            field, too.
        form_of_colour: the same of the names' signal for correlated noise beside a varying field, two fifths in size:
            it has a hundred columns and more. Noise put into 18 real logs (editions 331, 390, 400 and 402) has 0.33 to
            5, and once 0.12; noise that is not there has 0.09 to 0.16 in four.
        in_place_of_field: least power of a fitted name in place of the varying field, relative to it. Functions of time
            and attitude can explain most of what an effect does, and then little remains for the effect beside them;
            in their place it explains as much as a third of what varies.
        profile_field, profile_rate: smallest value of a generic profile that matters, T and rad/s.
        depth, beam: largest number of effects in a set, beside a varying field, and candidates that extend each set.
        nodes, most: largest number of fitted sets, without and with the sets in which rivals were exchanged.
        alike: nats between two candidates in the linear model, below which their order may be another one at the
            minimum: in a cut of BROAD 06 an object and a current that are 0.2 nats apart gain 96 nats in place of 44.
            Judged on the put-in effects of editions 387 and 388.
        unrivalled: share of what an effect explains, below which its rivals in its place are not tried beside one more
            effect. At a half an exchange that succeeds there is missed in one of 64 logs.
        named_from: probability above which an effect is named: a wrong name costs as much as four missing ones.
        missing_from: probability above which something without a name is said to be present: the calibration is then
            not trusted. At 0.8 two minutes of the bundled dive, in which nothing is missing, were not (0.87).
        improbable: probability below which an effect is neither a rival nor possible.
        certain: nats for what is detected with certainty or not at all. A set by as much less probable is not extended.
        whole: probability that a family is present as a whole, not in one of its parts.
        beyond: largest scale of an effect's values, relative to its largest possible value.
        misfit: standard deviations of white noise's mean square from which a varying field is tested.
        one_of_families: log number of families, one of which is colour along one direction.
    """

    scales: Array = field(default_factory=lambda: 2.0 ** np.arange(-2.0, 6.0))
    nothing: float = float(np.log(1 / 3))
    named: float = float(np.log(0.75 / 22))
    unknown: float = float(np.log(0.5))
    product: float = float(np.log(0.1))
    unforeseen: float = 0.005
    unforeseen_in_room: float = 0.05
    form: float = 0.04
    form_of_colour: float = 0.2
    in_place_of_field: float = 0.3
    profile_field: float = 0.3e-6
    profile_rate: float = 1e-3
    depth: int = 6
    nodes: int = 10
    most: int = 16
    beam: int = 3
    alike: float = 3.0
    unrivalled: float = 1 / 3
    named_from: float = 0.8
    missing_from: float = 0.9
    improbable: float = 0.05
    certain: float = 12.0
    whole: float = 0.5
    beyond: float = 0.5
    misfit: float = 3.0
    one_of_families: float = float(np.log(20))


PRIOR = Prior()
