"""What every method in the registry keeps, whoever registers it: one contract, one test per clause."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg

METHODS = mg.methods()
MAGNETOMETER_ONLY = [name for name, method in METHODS.items() if not method.needs]
SEQUENTIAL = {"crassidis"}  # magnetometer-only, but sample by sample: their order matters
STRENGTH = 50e-6  # T
FIELD = STRENGTH * np.array([0.45, 0.1, 0.8874])  # north, east, down
SOFT_IRON = np.array([[1.03, 0.01, -0.01], [0.01, 0.98, 0.005], [-0.01, 0.005, 0.99]])
HARD_IRON = np.array([6e-6, -4e-6, 9e-6])
GYRO_BIAS = np.array([4e-3, -5e-3, 2e-3])

Data = dict[str, Any]


def motion(angles: Callable[[np.ndarray], np.ndarray], seconds: float, noise: float = 1e-7) -> Data:
    """All that any method needs, 10 Hz, for (N, 3) heading, pitch and roll in rad."""
    time = np.arange(0.0, seconds, 0.1)

    def attitude(at: np.ndarray) -> Rotation:
        return Rotation.from_euler("ZYX", angles(at))

    step = 1e-4
    rate = (attitude(time - step).inv() * attitude(time + step)).as_rotvec() / (2 * step)
    body = attitude(time).inv()
    random = np.random.default_rng(0)
    return {
        "time": time,
        "magnetic_field": body.apply(FIELD) @ SOFT_IRON.T + HARD_IRON + noise * random.normal(size=(len(time), 3)),
        "angular_rate": rate + GYRO_BIAS + 1e-3 * random.normal(size=(len(time), 3)),
        "attitude": attitude(time).as_quat(),
    }


def tumbling(time: np.ndarray) -> np.ndarray:
    return np.stack([0.6 * time, 1.2 * np.sin(0.17 * time), 0.23 * time], axis=1)


def level(time: np.ndarray) -> np.ndarray:
    return np.stack([0.5 * time, 0 * time, 0 * time], axis=1)


def still(time: np.ndarray) -> np.ndarray:
    return np.zeros((len(time), 3))


GOOD = motion(tumbling, 60.0)


def recording(name: str, data: Data, **changes: Any) -> mg.Recording:
    """With what the method needs and nothing else; every row is a sample of its own."""
    data = data | changes
    needs = {key: data[key] for key in METHODS[name].needs}
    fresh = np.ones(len(data["time"]), dtype=bool)
    return mg.Recording(
        data["time"],
        data["magnetic_field"],
        magnetic_field_fresh=fresh,
        magnetic_field_unit=data.get("magnetic_field_unit", "T"),
        **({"angular_rate_fresh": fresh} if "angular_rate" in needs else {}),
        **needs,
    )


def same(one: mg.Calibration, other: mg.Calibration, tolerance: float, factor: float = 1.0) -> None:
    """Equal, `other` of a field `factor` times as strong; `tolerance` is relative to the field."""
    assert other.converged == one.converged
    np.testing.assert_allclose(other.soft_iron, one.soft_iron, rtol=0, atol=tolerance)
    np.testing.assert_allclose(
        other.hard_iron / factor, one.hard_iron, rtol=0, atol=tolerance * np.abs(GOOD["magnetic_field"]).max()
    )
    assert (one.gyro_bias is None) == (other.gyro_bias is None)
    if one.gyro_bias is not None and other.gyro_bias is not None:
        np.testing.assert_allclose(other.gyro_bias, one.gyro_bias, rtol=0, atol=0.1 * tolerance)


@pytest.fixture(scope="module")
def results() -> dict[str, mg.Calibration]:
    """Each method's calibration of the good recording."""
    return {name: mg.calibrate(recording(name, GOOD), name) for name in METHODS}


@pytest.mark.parametrize("name", METHODS)
def test_the_registry_says_what_it_is(name):
    method = METHODS[name]
    assert method.summary
    assert method.paper
    assert set(method.needs) <= {"angular_rate", "attitude", "acceleration"}


@pytest.mark.parametrize("name", METHODS)
def test_good_data_are_calibrated(name, results):
    calibration = results[name]
    assert calibration.converged, calibration.message
    assert calibration.method == name
    assert calibration.message
    # 5 % of the field: what hard-iron methods lose to the soft iron of 3 %
    np.testing.assert_allclose(calibration.hard_iron, HARD_IRON, rtol=0, atol=0.05 * STRENGTH)
    assert np.linalg.eigvalsh((calibration.soft_iron + calibration.soft_iron.T) / 2)[0] > 0
    if "angular_rate" not in METHODS[name].needs:
        assert calibration.gyro_bias is None
    if calibration.covariance is not None:
        assert np.linalg.eigvalsh(calibration.covariance)[0] > -1e-12
        assert (calibration.sigma["hard_iron"] > 0).all()


@pytest.mark.parametrize("name", METHODS)
def test_the_result_is_plain_data(name, results):
    text = json.dumps(results[name].to_dict(), allow_nan=False)
    assert mg.Calibration.from_dict(json.loads(text)).to_dict() == results[name].to_dict()


@pytest.mark.parametrize("name", METHODS)
def test_the_same_again_from_fortran_arrays_which_stay_as_they_are(name, results):
    data = {key: np.asfortranarray(value) for key, value in GOOD.items()}
    before = {key: value.copy() for key, value in data.items()}
    input_ = recording(name, data)
    kept = input_.magnetic_field.copy()
    calibration = mg.calibrate(input_, name)
    same(results[name], calibration, 0.0)
    for key, value in before.items():
        np.testing.assert_array_equal(data[key], value)
    np.testing.assert_array_equal(input_.magnetic_field, kept)


@pytest.mark.parametrize("name", METHODS)
def test_a_stronger_field_scales_the_hard_iron_and_nothing_else(name, results):
    stronger = mg.calibrate(recording(name, GOOD, magnetic_field=1.5 * GOOD["magnetic_field"]), name)
    # Graphs with sigmas in gauss weigh their priors otherwise then.
    same(results[name], stronger, 2e-6 if name in MAGNETOMETER_ONLY else 2e-3, factor=1.5)


@pytest.mark.parametrize("name", METHODS)
def test_a_given_field_strength_is_only_another_name(name, results):
    input_ = recording(name, GOOD)
    given = mg.calibrate(input_, name, field_strength=40e-6)
    assert given.field_strength == 40e-6
    np.testing.assert_allclose(given.hard_iron, results[name].hard_iron, rtol=0, atol=1e-9)
    strength = np.linalg.norm(given.apply(input_.magnetic_field), axis=1)
    assert strength.mean() == pytest.approx(40e-6, rel=0.02)


@pytest.mark.parametrize("name", MAGNETOMETER_ONLY)
def test_raw_counts_are_as_good_as_tesla(name, results):
    counts = recording(name, GOOD, magnetic_field=7e6 * GOOD["magnetic_field"], magnetic_field_unit="counts")
    same(results[name], mg.calibrate(counts, name), 2e-6, factor=7e6)


@pytest.mark.parametrize("name", sorted(set(MAGNETOMETER_ONLY) - SEQUENTIAL))
def test_the_order_of_the_samples_does_not_matter(name, results):
    order = np.random.default_rng(1).permutation(len(GOOD["time"]))
    same(
        results[name],
        mg.calibrate(recording(name, GOOD, magnetic_field=GOOD["magnetic_field"][order]), name),
        2e-6,
    )


@pytest.mark.parametrize("name", METHODS)
def test_progress_rises_to_the_end(name):
    seen: list[float] = []
    mg.calibrate(recording(name, GOOD), name, progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


@pytest.mark.parametrize("name", METHODS)
def test_unknown_options_are_named(name):
    with pytest.raises(mg.MagycError, match=r"has no option 'colour'; it has (?!.*progress)"):
        mg.calibrate(recording(name, GOOD), name, colour="red")


@pytest.mark.parametrize("name", METHODS)
def test_what_it_needs_is_missed(name):
    for need in METHODS[name].needs:
        data = {key: value for key, value in GOOD.items() if key != need}
        with pytest.raises(mg.MagycError, match=need.replace("_", " ")):
            mg.calibrate(mg.Recording(data["time"], data["magnetic_field"]), name)


def degenerate() -> list[tuple[str, str]]:
    """(method, motion) that cannot be calibrated: what is too little depends on what the method knows."""
    cases = {
        (): ("plane", "line", "point", "few"),
        ("angular_rate",): ("plane", "point", "few"),
        ("attitude",): ("point", "few"),
    }
    return [(name, case) for name, method in METHODS.items() for case in cases.get(method.needs, ())]


@pytest.mark.parametrize(("name", "case"), degenerate())
@pytest.mark.parametrize("noise", [0.0, 1e-7])
def test_degenerate_data_are_refused_with_a_reason(name, case, noise):
    if case == "plane":
        data = motion(level, 60.0, noise)
    elif case == "point":
        data = motion(still, 60.0, noise)
    elif case == "few":
        data = {key: value[:5] for key, value in motion(tumbling, 60.0, noise).items()}
    else:
        data = motion(tumbling, 60.0, noise)
        data["magnetic_field"] = data["magnetic_field"] * [1, 0, 0] + [0, 2e-5, 4e-5]
        data["magnetic_field"] = data["magnetic_field"] + noise * np.random.default_rng(2).normal(size=(600, 3))
    try:
        calibration = mg.calibrate(recording(name, data), name)
    except mg.MagycError as error:
        assert len(str(error)) > 20  # noqa: PT017
        return
    assert not calibration.converged
    assert len(calibration.message) > 20


@pytest.mark.parametrize("noise", [1e-6, (1e-6,), (0.0, 1e-3), (1.0, 5e-3), (1e-6, np.nan), "small"])
@pytest.mark.parametrize("name", ["smoother", "autocal", "twostep", "crassidis", "sar-kf"])
def test_a_noise_is_a_pair_in_tesla(name, noise):
    recording = mg.simulate("wide", 10).recording
    with pytest.raises(mg.MagycError, match="noise: must be a pair"):
        mg.calibrate(recording, name, noise=noise)


@pytest.mark.parametrize("name", METHODS)
def test_it_is_called_alike(name):
    module, function = METHODS[name].function.split(":")
    signature = inspect.signature(getattr(__import__(module, fromlist=[function]), function))
    parameters = list(signature.parameters.values())
    assert parameters[0].name == "recording"
    named = (inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.VAR_KEYWORD)
    assert all(p.kind in named for p in parameters[1:])
    names = set(signature.parameters)
    if METHODS[name].options:
        module, options = METHODS[name].options.split(":")
        names |= getattr(__import__(module, fromlist=[options]), options).__dataclass_fields__.keys()
    assert {"field_strength", "progress"} <= names


WRONG_KINDS = {
    "sar-ls": [{"window": None}],
    "sar-kf": [{"drift": "x"}],
    "magfactor3": [{"field": "x"}, {"delay": "x"}],
    "ali-pso": [{"seed": -1}, {"acceleration": 1}, {"particles": 2.5}, {"inertia": "x"}],
    "magyc-bfg": [{"window": "1"}, {"tolerance": "1"}, {"prior": [1]}],
    "magyc-ifg": [{"residual_sigma": "x"}, {"prior_sigma": -1}, {"robust": "zz", "compressed": False}],
}


@pytest.mark.parametrize(("name", "options"), [(n, each) for n, many in WRONG_KINDS.items() for each in many])
def test_an_option_of_a_wrong_kind_is_refused(name, options):
    with pytest.raises(mg.MagycError, match=next(iter(options))):
        mg.calibrate(recording(name, GOOD), name, **options)


@pytest.mark.parametrize("options", [{"horizon": None}, {"hard_iron_drift": [1]}, {"gyro_bias_drift": {}}])
def test_an_option_of_a_wrong_kind_is_refused_online(options):
    with pytest.raises(mg.MagycError, match=next(iter(options))):
        mg.OnlineCalibrator(**options)
