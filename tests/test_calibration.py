"""Calibration: applied as its formula says, saved and loaded bit for bit, never half written."""

import dataclasses
import os
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from magyc_gtsam import Calibration, MagycError
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.observability import Observability, Weakness

SOFT_IRON = np.array([[1.1, 0.1, 0.04], [0.1, 0.9, 0.02], [0.04, 0.02, 1.2]])
HARD_IRON = np.array([2e-6, 12e-6, -9e-6])
BIAS = np.array([4e-3, -5e-3, 2e-3])

FINITE = st.floats(-1e12, 1e12)
# PyYAML writes the control character NEL as the line break it stands for, and reads a blank.
TEXT = st.text(st.characters(exclude_characters="\x85"), max_size=10)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | FINITE | TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
    max_leaves=8,
)
POSITIVE = FINITE.map(abs)
WEAKNESSES = st.builds(Weakness, TEXT, FINITE, FINITE, st.sampled_from(["µT", "%"]), TEXT)
OBSERVABILITIES = st.builds(
    Observability, st.booleans(), st.lists(WEAKNESSES, max_size=3).map(tuple), st.none() | FINITE
)


@st.composite
def calibrations(draw):
    soft_iron = np.diag(draw(hnp.arrays(float, 3, elements=st.floats(0.5, 2.0))))
    soft_iron += draw(hnp.arrays(float, (3, 3), elements=st.floats(-0.1, 0.1)))
    bias = draw(st.none() | hnp.arrays(float, 3, elements=st.floats(-70, 70)))
    freedoms = 9 if bias is None else 12
    root = draw(st.none() | hnp.arrays(float, (freedoms, 1), elements=st.floats(-1e3, 1e3)))
    return Calibration(
        soft_iron,
        draw(hnp.arrays(float, 3, elements=st.floats(-0.01, 0.01))),
        bias,
        None if root is None else root @ root.T,
        delay=draw(st.floats(-60, 60)),
        delay_sigma=draw(st.none() | POSITIVE),
        converged=draw(st.booleans()),
        message=draw(TEXT),
        method=draw(TEXT),
        noise=draw(st.dictionaries(st.sampled_from(["magnetic_field", "angular_rate"]), POSITIVE)),
        field_strength=draw(st.none() | st.floats(0, 0.01)),
        observability=draw(st.none() | OBSERVABILITIES),
        diagnostics=draw(st.dictionaries(TEXT, JSON, max_size=3)),
        configuration=draw(st.dictionaries(TEXT, JSON, max_size=3)),
    )


def test_apply_undoes_the_sensor_model():
    u = np.random.default_rng(0).normal(0, 5e-5, (20, 3))
    m = np.array([SOFT_IRON @ row + HARD_IRON for row in u])
    calibration = Calibration(SOFT_IRON, HARD_IRON, BIAS)
    np.testing.assert_allclose(calibration.apply(m), u, atol=1e-18)
    np.testing.assert_allclose(calibration.apply(m[3]), u[3], atol=1e-18)
    np.testing.assert_allclose(calibration.apply(m[:3].tolist()), u[:3], atol=1e-18)
    assert calibration.apply(m[0]).shape == (3,)
    assert calibration.apply(m[:0]).shape == (0, 3)


def test_apply_an_unsymmetric_soft_iron():
    """A transposed inverse would pass with a symmetric one."""
    soft_iron = np.array([[1.0, 0.5, 0.0], [0.0, 1.0, 0.25], [0.0, 0.0, 2.0]])
    m = np.array([[1.0, 2.0, 3.0]])
    np.testing.assert_allclose(Calibration(soft_iron, np.zeros(3)).apply(m)[0], np.linalg.solve(soft_iron, m[0]))


def test_apply_gyroscope():
    rates = np.random.default_rng(0).normal(size=(5, 3))
    calibration = Calibration(SOFT_IRON, HARD_IRON, BIAS)
    np.testing.assert_array_equal(calibration.apply_gyroscope(rates), rates - BIAS)
    np.testing.assert_array_equal(calibration.apply_gyroscope(rates[0]), rates[0] - BIAS)
    with pytest.raises(MagycError, match="'twostep' does not estimate a gyroscope bias"):
        Calibration(SOFT_IRON, HARD_IRON, method="twostep").apply_gyroscope(rates)


@pytest.mark.parametrize("shape", [(4,), (3, 4), (2, 3, 3), ()])
def test_apply_refuses_other_shapes(shape):
    """(3, N) must not be scrambled into (N, 3)."""
    calibration = Calibration(SOFT_IRON, HARD_IRON, BIAS)
    with pytest.raises(MagycError, match=r"magnetic_field: shape .* expected \(N, 3\) or \(3,\)"):
        calibration.apply(np.zeros(shape))
    with pytest.raises(MagycError, match="angular_rate: shape"):
        calibration.apply_gyroscope(np.zeros(shape))


def test_sigma_is_the_root_of_the_diagonal_in_its_place():
    sigma = Calibration(SOFT_IRON, HARD_IRON, BIAS, np.diag(np.arange(12.0) ** 2)).sigma
    np.testing.assert_array_equal(sigma["soft_iron"], [[0, 1, 2], [1, 3, 4], [2, 4, 5]])
    np.testing.assert_array_equal(sigma["hard_iron"], [6, 7, 8])
    np.testing.assert_array_equal(sigma["gyro_bias"], [9, 10, 11])
    assert Calibration(SOFT_IRON, HARD_IRON).sigma == {}


@settings(max_examples=60, deadline=None)
@given(calibrations(), st.sampled_from([".yaml", ".yml", ".json"]))
def test_saved_and_loaded_is_the_same_bit_for_bit(tmp_path_factory, calibration, suffix):
    path = tmp_path_factory.getbasetemp() / f"calibration{suffix}"
    calibration.save(path)
    loaded = Calibration.load(path)
    for field in dataclasses.fields(Calibration):
        before, after = getattr(calibration, field.name), getattr(loaded, field.name)
        if isinstance(before, np.ndarray):
            assert after.dtype == float
            assert after.tobytes() == before.tobytes(), field.name
        else:
            assert after == before, field.name


def test_save_replaces_the_file_in_one_step(tmp_path, monkeypatch):
    path = tmp_path / "cal.yaml"
    Calibration(SOFT_IRON, HARD_IRON, message="first").save(path)
    second = Calibration(SOFT_IRON, HARD_IRON, message="second")

    def out_of_power(*_):
        raise OSError("out of power")

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", out_of_power)
        with pytest.raises(MagycError, match=r"cal.yaml: cannot be written \(out of power\)"):
            second.save(path)
    assert Calibration.load(path).message == "first"
    second.save(path)
    assert Calibration.load(path).message == "second"
    assert [p.name for p in tmp_path.iterdir()] == ["cal.yaml"]


def test_files_that_several_write_at_once_are_one_of_theirs(tmp_path):
    path = tmp_path / "cal.yaml"

    def write(number):
        for _ in range(10):
            Calibration(SOFT_IRON, HARD_IRON, message=f"{number}" * 100).save(path)
            assert len(set(Calibration.load(path).message)) == 1

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(write, range(4)))
    assert [p.name for p in tmp_path.iterdir()] == ["cal.yaml"]


def test_what_cannot_be_written_leaves_the_old_file_alone(tmp_path):
    path = tmp_path / "cal.yaml"
    Calibration(SOFT_IRON, HARD_IRON).save(path)
    before = path.read_text()
    with pytest.raises(yaml.YAMLError, match="cannot represent"):
        Calibration(SOFT_IRON, HARD_IRON, diagnostics={"bad": object()}).save(path)
    assert path.read_text() == before


def test_the_yaml_is_for_people_too(tmp_path):
    Calibration(SOFT_IRON, HARD_IRON, message="µT").save(tmp_path / "cal.yaml")
    text = (tmp_path / "cal.yaml").read_text(encoding="utf-8")
    assert text.splitlines()[0] == "format: magyc-gtsam calibration 1"
    assert "- [1.1, 0.1, 0.04]" in text
    assert "message: µT" in text


SAVED = Calibration(SOFT_IRON, HARD_IRON).to_dict()
GOOD = yaml.safe_dump(SAVED)
BAD_FILES = {
    "broken YAML": ("cal.yaml", "soft_iron: [1, 2", "not readable as .yaml"),
    "broken JSON": ("cal.json", "{", "not readable as JSON"),
    "binary": ("cal.yaml", b"\xff\xfe\x00\x01", "not a text file; a calibration as YAML or JSON"),
    "a list": ("cal.yaml", "[1, 2]", "not a calibration"),
    "empty": ("cal.yaml", "", "not a calibration"),
    "something else": ("cal.yaml", "camera: {fx: 500}", "not a calibration: format is None"),
    "an accelerometer's": (
        "cal.yaml",
        "format: magyc-gtsam accelerometer calibration 1",
        "the calibration of an accelerometer, which is not exported",
    ),
    "another version": ("cal.yaml", GOOD.replace("calibration 1", "calibration 9"), "calibration 9"),
    "no hard iron": ("cal.yaml", GOOD.replace("hard_iron", "hard_irony"), "calibration without hard_iron"),
    "wrong shape": ("cal.yaml", yaml.safe_dump(SAVED | {"soft_iron": [1]}), "soft_iron must be (3, 3)"),
    "words": ("cal.yaml", yaml.safe_dump(SAVED | {"soft_iron": "a"}), "soft_iron must be numbers"),
    "observability": ("cal.yaml", GOOD.replace("observability: null", "observability: {}"), "damaged calibration"),
    "diagnostics": ("cal.yaml", GOOD.replace("diagnostics: {}", "diagnostics: 3"), "diagnostics"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_FILES)
def test_load_refuses_with_the_files_name(tmp_path, case):
    name, text, words = BAD_FILES[case]
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(MagycError) as caught:
        Calibration.load(path)
    assert str(caught.value).startswith(str(path))
    assert words in str(caught.value)


def test_a_file_that_was_cut_off_anywhere_is_refused(tmp_path):
    """The defaults of what is missing would make it trusted, and leave out terms and options."""
    path = tmp_path / "cal.yaml"
    term = Term("motor-current", [1e-6, 0.0, 0.0], np.eye(3) * 1e-16)
    options = {"compass": 2, "noise": [1e-6, 5e-3]}
    weak = Observability(False, (Weakness("hard iron", 3.0, 1.0, "µT", "turn"),))
    Calibration(
        SOFT_IRON, HARD_IRON, terms=(term,), converged=False, observability=weak, configuration=options
    ).save(path)
    text = path.read_text(encoding="utf-8")
    lines = text.splitlines(keepends=True)
    within_the_last = [text[:-count] for count in range(2, len(lines[-1]) + 1)]
    for part in (*("".join(lines[:count]) for count in range(1, len(lines))), *within_the_last):
        path.write_text(part, encoding="utf-8")
        with pytest.raises(MagycError, match=r"cal\.yaml: "):
            Calibration.load(path)
    path.write_text(text[: text.index("terms:")], encoding="utf-8")
    with pytest.raises(MagycError, match="without terms, .*, converged: is it cut off"):
        Calibration.load(path)


def test_load_of_a_missing_file(tmp_path):
    with pytest.raises(MagycError, match=r"none\.yaml: no such file"):
        Calibration.load(tmp_path / "none.yaml")


@pytest.mark.parametrize("name", ["CAL.YAML", "cal.Yml", "CAL.JSON"])
def test_suffixes_may_be_capitals(tmp_path, name):
    Calibration(SOFT_IRON, HARD_IRON).save(tmp_path / name)
    np.testing.assert_array_equal(Calibration.load(tmp_path / name).soft_iron, SOFT_IRON)


@pytest.mark.parametrize("name", ["cal.txt", "cal"])
def test_save_refuses_other_suffixes(tmp_path, name):
    with pytest.raises(MagycError, match=r"saved as \.yaml or \.json"):
        Calibration(SOFT_IRON, HARD_IRON).save(tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"soft_iron": np.ones((3, 3))}, "soft_iron is singular"),
        ({"soft_iron": np.eye(2)}, r"soft_iron must be \(3, 3\)"),
        ({"hard_iron": HARD_IRON[None]}, r"hard_iron must be \(3,\)"),
        ({"hard_iron": [np.nan, 0, 0]}, "hard_iron must be .* finite"),
        ({"gyro_bias": [1, 2]}, r"gyro_bias must be \(3,\)"),
        ({"covariance": np.eye(9), "gyro_bias": BIAS}, r"covariance must be \(12, 12\)"),
        ({"covariance": np.eye(12)}, r"covariance must be \(9, 9\)"),
        ({"covariance": np.diag([np.inf] * 9)}, "covariance must be .* finite"),
    ],
)
def test_refused_values(change, words):
    with pytest.raises(MagycError, match=words):
        Calibration(**{"soft_iron": SOFT_IRON, "hard_iron": HARD_IRON} | change)


def test_immutable_and_its_own():
    soft_iron, diagnostics = SOFT_IRON.copy(), {"cost": 1.0, "disturbed": [[1.0, 2.0]]}
    calibration = Calibration(soft_iron, HARD_IRON, BIAS, np.eye(12), diagnostics=diagnostics)
    soft_iron[:] = 0
    diagnostics["cost"] = 2.0
    np.testing.assert_array_equal(calibration.soft_iron, SOFT_IRON)
    assert calibration.diagnostics["cost"] == 1.0
    for name in ("soft_iron", "hard_iron", "gyro_bias", "covariance"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(calibration, name)[0] = 0
    with pytest.raises(TypeError):
        calibration.diagnostics["cost"] = 3.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        calibration.converged = False


def test_pickles():
    one = Calibration(np.eye(3) * 1.1, [1e-6, 2e-6, 3e-6], [0.1, 0.2, 0.3], noise={"magnetic_field": 1e-7})
    two = pickle.loads(pickle.dumps(one))
    assert two.to_dict() == one.to_dict()


@pytest.mark.parametrize(
    ("converged", "observable", "trusted"),
    [(True, None, True), (True, True, True), (True, False, False), (False, True, False), (False, None, False)],
)
def test_trusted_is_converged_and_where_that_is_known_observable(converged, observable, trusted):
    observability = None if observable is None else Observability(observable)
    calibration = Calibration(np.eye(3), np.zeros(3), converged=converged, observability=observability)
    assert calibration.trusted is trusted


ASYMMETRIC = str(np.triu(np.ones((9, 9))).tolist())
IMPOSSIBLE = {
    "hard iron of a tesla": ("hard_iron", "[1.0, 0.0, 0.0]", "at most 0.01 T"),
    "hard iron beyond all": ("hard_iron", "[1.0e+300, 0.0, 0.0]", "at most 0.01 T"),
    "not a number": ("hard_iron", "[.nan, 0.0, 0.0]", "finite"),
    "true and false": ("hard_iron", "[true, false, true]", "hard_iron must be numbers"),
    "numbers as text": ("hard_iron", "['1e-5', '0', '0']", "hard_iron must be numbers"),
    "a gyroscope that spins": ("gyro_bias", "[1000.0, 0.0, 0.0]", "at most 70 rad/s"),
    "soft iron of billions": ("soft_iron", "[[1.0e+9, 0, 0], [0, 1.0e+9, 0], [0, 0, 1.0e+9]]", "0.001 to 1000"),
    "soft iron without volume": ("soft_iron", "[[1, 0, 0], [0, 1, 0], [0, 0, 1.0e-9]]", "singular"),
    "a year late": ("delay", "3.0e+7", "delay must be at most 60 s"),
    "late by true": ("delay", "true", "delay must be a finite number"),
    "converged by text": ("converged", "'yes'", "converged must be true or false"),
    "negative deviation": ("delay_sigma", "-1.0", "delay_sigma must be a finite number of at least 0"),
    "field of a magnet": ("field_strength", "5.0", "field_strength must be"),
    "asymmetric covariance": ("covariance", ASYMMETRIC, "symmetric"),
    "negative variance": ("covariance", str((-np.eye(9)).tolist()), "negative variances"),
}


@pytest.mark.parametrize("case", IMPOSSIBLE)
def test_what_no_instrument_can_have_is_refused(tmp_path, case):
    name, value, words = IMPOSSIBLE[case]
    values = Calibration(SOFT_IRON, HARD_IRON).to_dict()
    del values[name]
    path = tmp_path / "cal.yaml"
    path.write_text(yaml.safe_dump(values) + f"{name}: {value}\n")
    with pytest.raises(MagycError, match=words):
        Calibration.load(path)
    with pytest.raises(MagycError, match=words):
        Calibration(**{"soft_iron": SOFT_IRON, "hard_iron": HARD_IRON} | {name: yaml.safe_load(value)})


def test_what_is_not_trusted_may_be_impossible_and_is_not_exported(tmp_path):
    """Fits of too little motion end anywhere; their report shows it, and their files can be read again."""
    Calibration(SOFT_IRON, [1.0, 0.0, 0.0], converged=False).save(tmp_path / "cal.yaml")
    loaded = Calibration.load(tmp_path / "cal.yaml")
    assert loaded.hard_iron[0] == 1.0
    with pytest.raises(MagycError, match="at most 0.01 T"):
        loaded.export("px4", force=True)


def test_counts_may_be_as_large_as_they_are(tmp_path):
    counts = Calibration(SOFT_IRON, [500.0, 0, 0], configuration={"magnetic_field_unit": "counts"})
    counts.save(tmp_path / "cal.yaml")
    assert Calibration.load(tmp_path / "cal.yaml").hard_iron[0] == 500.0


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
def test_a_key_that_comes_twice_is_refused(tmp_path, suffix):
    path = tmp_path / f"cal{suffix}"
    Calibration(SOFT_IRON, HARD_IRON).save(path)
    text = path.read_text()
    line = next(line for line in text.splitlines() if "delay:" in line or '"delay":' in line)
    path.write_text(text.replace(line, f"{line}\n{line}"))
    with pytest.raises(MagycError, match="the key 'delay' occurs twice"):
        Calibration.load(path)


def test_files_that_expand_or_nest_without_end_are_refused_at_once(tmp_path):
    path = tmp_path / "cal.yaml"
    levels = "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]\n" for k in range(1, 11))
    path.write_text("a0: &a0 [x, x]\n" + levels)
    with pytest.raises(MagycError, match="holds an alias") as caught:
        Calibration.load(path)
    assert len(str(caught.value)) < 500
    for name, text in (("a.yaml", "[" * 100_000), ("b.yaml", "{a: " * 100_000), ("c.json", "[" * 1_000_000)):
        (tmp_path / name).write_text(text)
        with pytest.raises(MagycError, match=r"nested|not readable"):
            Calibration.load(tmp_path / name)


def test_a_key_that_is_no_name_is_refused(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text("? [1, 2]\n: 3\n")
    with pytest.raises(MagycError, match="is not a name"):
        Calibration.load(path)
    path.write_text("a: [" + "1, " * 1_000_000 + "]\n")  # minutes in a YAML reader
    with pytest.raises(MagycError, match="3000006 bytes, a calibration at most 2097152"):
        Calibration.load(path)


def test_what_is_held_twice_is_written_without_an_alias(tmp_path):
    shared = [1.0, 2.0]
    Calibration(SOFT_IRON, HARD_IRON, diagnostics={"a": shared, "b": shared}).save(tmp_path / "cal.yaml")
    assert "&" not in (tmp_path / "cal.yaml").read_text()
    assert Calibration.load(tmp_path / "cal.yaml").diagnostics["b"] == shared


def test_errors_show_no_more_of_a_file_than_fits_a_line(tmp_path):
    path = tmp_path / "cal.yaml"
    path.write_text("soft_iron: \x1b]0;owned\x07" + "x" * 100_000 + ": : :")
    with pytest.raises(MagycError) as caught:
        Calibration.load(path)
    message = str(caught.value)
    assert len(message) < len(str(path)) + 300
    assert "\x1b" not in message


def test_a_term_of_no_numbers_is_refused(tmp_path):
    values = Calibration(SOFT_IRON, HARD_IRON).to_dict()
    for term in ("x", {"name": "current", "value": [True], "covariance": [[1.0]]}, {"name": "current"}):
        path = tmp_path / "cal.yaml"
        path.write_text(yaml.safe_dump(values | {"terms": [term]}))
        with pytest.raises(MagycError, match="term|damaged"):
            Calibration.load(path)
