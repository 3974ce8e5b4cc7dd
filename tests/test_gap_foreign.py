"""What moves with the sensor and is in no catalogue is not called the field of the place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam.blindtest.generator import generate
from magyc_gtsam.blindtest.scenarios import Scenario, seed_of
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.gap.evidence.node import FIELD_VARIATION
from magyc_gtsam.gap.evidence.posterior import UNKNOWN
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.model.field_variation import field_variation


def _beside_heading(course: Callable[[np.ndarray], np.ndarray]) -> mg.Recording:
    """Add to the sensor's field a function of the heading alone, as a servo's magnet."""
    base = mg.simulate("wide", 120, seed=3).recording
    assert base.attitude is not None
    heading = Rotation.from_quat(base.attitude).as_euler("ZYX")[:, 0]
    return replace(base, magnetic_field=base.magnetic_field + course(heading))


def test_a_variation_with_the_sensor_may_depend_on_attitude_alone() -> None:
    """That of a field of the place may not: it varies along the way, too."""
    recording = _beside_heading(lambda h: 1e-6 * np.stack([np.sin(2 * h), np.cos(2 * h), 0 * h], axis=1))
    twin = base_model(recording, None, short_term_noise(recording)).twin
    sensor, world = (field_variation(twin, in_world=in_world) for in_world in (False, True))
    assert sensor.attitude > 3 * sensor.along
    assert world.attitude <= 2 * world.along
    assert sensor.gain > world.gain


@pytest.mark.parametrize(
    ("motion", "seed", "factor"), [("multi", 174576511289408, 2.0), ("moderate", 4177445569759, 1.0)]
)
def test_a_magnet_that_follows_the_heading_is_no_field_of_the_place(motion: str, seed: int, factor: float) -> None:
    """Its variation in the sensor's axes is compared in every set in which the field varies alone.

    The field absorbs what effects explain beside it there, and a set without them loses.
    """
    scenario = Scenario("servo", "foreign", motion, seed, (("servo-magnet", factor),))
    gap = mg.find_gap(generate(scenario).recording)
    assert gap.verdict == "unknown"
    assert gap.probabilities[UNKNOWN] > 0.95
    assert gap.probabilities.get(FIELD_VARIATION, 0.0) < 0.5


def test_a_drift_of_the_iron_is_no_unknown_variation_with_the_sensor() -> None:
    """That one explains more than a field of the place, as do families beside the field: it does not count twice."""
    name = "single-wide-hard-iron-drift-x2-00"
    scenario = Scenario(name, "single", "wide", seed_of(name, 398), (("hard-iron-drift", 2.0),))
    gap = mg.find_gap(generate(scenario).recording)
    assert gap.names == ("hard-iron-drift",)
    assert gap.probabilities[UNKNOWN] < 0.1
