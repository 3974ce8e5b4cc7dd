"""One convention for the keys of every factor: arguments of their own, first, named by content, in one order."""

import inspect

import pytest

import magyc_gtsam.factors as factors
from magyc_gtsam.gap import term_factor

ORDER = (
    *("attitude_key", "direction_key", "first_direction_key", "second_direction_key", "first_key", "second_key"),
    *("soft_iron_key", "scale_key", "hard_iron_key", "gyro_bias_key", "value_key"),
    *("field_key", "mounting_key", "delay_key"),
)
OPTIONAL = ("gyro_bias_key", "field_key", "mounting_key", "delay_key")
OTHERS = {"custom_factor": "a user's own", "native_factor": "of another factor"}


def makers():
    """{name: function} of all that make a factor on given keys."""
    found = {name: getattr(factors, name) for name in factors.__all__ if name not in OTHERS}
    made = {
        name: str(inspect.signature(each).return_annotation)
        for name, each in found.items()
        if inspect.isfunction(each)
    }
    named = {name: found[name] for name, what in made.items() if what.startswith("gtsam.") and "Factor" in what}
    return {"term_factor": term_factor, **named}


def test_the_factors_are_found():
    assert {"magnetometer_factor", "keyframe_field_factor", "soft_iron_walk", "delay_prior"} <= set(makers())
    assert len(makers()) >= 16


@pytest.mark.parametrize("name", sorted(makers()))
def test_keys_come_first_and_in_one_order(name):
    parameters = list(inspect.signature(makers()[name]).parameters.values())
    keys = [each.name for each in parameters if "key" in each.name]
    required = [each.name for each in parameters if each.name in keys and each.kind is not each.KEYWORD_ONLY]
    optional = [each.name for each in parameters if each.name in keys and each.kind is each.KEYWORD_ONLY]
    assert set(keys) <= set(ORDER)
    assert required
    assert [each.name for each in parameters[: len(required)]] == required
    assert required == sorted(required, key=ORDER.index)
    assert optional == sorted(set(optional), key=ORDER.index)
    assert set(optional) <= set(OPTIONAL)
    assert all(each.default is None for each in parameters if each.name in optional)
