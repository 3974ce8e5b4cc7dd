"""Effects from outside: functions of any Python file, put into recordings, judged as foreign ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magyc_gtsam import MagycError
from magyc_gtsam.blindtest.from_outside import EffectsFromFile, changed
from magyc_gtsam.blindtest.generator import generate
from magyc_gtsam.blindtest.heading import heading_errors
from magyc_gtsam.blindtest.scenarios import FACTORS, fingerprint
from magyc_gtsam.blindtest.scoring import UNKNOWN, WRONG, judged
from magyc_gtsam.blindtest.sealing import seal
from magyc_gtsam.cli import main
from magyc_gtsam.simulation import simulate
from magyc_gtsam.simulation.environment import CHANNELS

EXAMPLE = Path(__file__).parents[1] / "examples" / "foreign_effects.py"


def test_functions_of_a_file_are_put_into_recordings(tmp_path: Path) -> None:
    outside = EffectsFromFile.read(EXAMPLE)
    assert set(outside.effects) == {
        f"foreign_effects.{name}"
        for name in ("gain_with_temperature", "late_in_fast_turns", "gripper", "bias_with_shaking")
    }
    every = outside.scenarios("wide", 30, 1, duration=20.0)
    assert len(every) == 4 * len(FACTORS)
    for scenario in every:
        hidden = generate(scenario, outside=outside.effects)
        plain = generate(replace(scenario, effects=())).recording
        moved = [
            not np.array_equal(getattr(hidden.recording, key), getattr(plain, key))
            for key in ("magnetic_field", "angular_rate")
        ]
        assert moved == ([False, True] if "shaking" in scenario.label else [True, False])
        assert hidden.recording.attitude is None
        assert hidden.attitude is not None
        assert judged(scenario, "unknown", ()) == UNKNOWN
        assert judged(scenario, "closed", [("timing", ())]) == WRONG
        assert heading_errors(scenario, {}) is None
    assert {s.factor for s in every} == set(FACTORS)
    manifest = seal(tmp_path, every[:2], outside=outside.effects)
    assert manifest["scenarios"] == fingerprint(every[:2])


def test_an_effect_changes_what_it_says_and_nothing_else() -> None:
    recording = simulate("wide", 20, seed=1, channels=CHANNELS).recording
    shifted = changed(
        recording, "x", lambda arrays, factor, random: {"angular_rate": arrays["angular_rate"] + factor}, 2.0, 1
    )
    np.testing.assert_allclose(shifted.angular_rate, recording.angular_rate + 2.0)
    np.testing.assert_array_equal(shifted.magnetic_field, recording.magnetic_field)
    warm = changed(recording, "x", lambda a, f, r: {"channel temperature": a["channel temperature"] + 1}, 1.0, 1)
    np.testing.assert_allclose(warm.channels["temperature"], recording.channels["temperature"] + 1)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (lambda a, f, r: None, "must return a dictionary of arrays"),
        (lambda a, f, r: {"time": a["time"]}, "is not one of"),
        (lambda a, f, r: {"magnetic_field": a["time"]}, "of shape"),
        (lambda a, f, r: {"magnetic_field": a["magnetic_field"] * np.nan}, "must be finite"),
        (lambda a, f, r: {"magnetic_field": a["magnetic_field"] * 1e6}, "mine.effect: .* likely unit: µT"),
        (lambda a, f, r: {}, "mine.effect: changes nothing at factor 1"),
        (lambda a, f, r: {"magnetic_field": a["magnetic_field"]}, "changes nothing"),
        (lambda a, f, r: 1 / 0, "ZeroDivisionError"),
    ],
)
def test_what_no_recording_can_hold_is_refused(given: object, said: str) -> None:
    recording = simulate("wide", 20, seed=1).recording
    with pytest.raises(MagycError, match=said):
        changed(recording, "mine.effect", given, 1.0, 1)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "said"), [("", "holds no function"), ("import nowhere", "must run by itself"), (None, "Python file")]
)
def test_files_without_effects_are_refused(
    tmp_path: Path, text: str | None, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / ("mine.txt" if text is None else "mine.py")
    path.write_text(text or "", encoding="utf-8")
    assert main(["study", "gap", "--foreign", str(path), "-o", str(tmp_path / "out")]) == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert main(["study", "gap", "--foreign", str(EXAMPLE), "--set", "none", "-o", str(tmp_path / "out")]) == 2
    assert "has no effect with --foreign" in capsys.readouterr().err
