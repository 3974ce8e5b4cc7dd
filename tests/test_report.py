"""The report page: its numbers, and the page itself in a browser without a network."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.observability import Observability, Weakness
from magyc_gtsam.recording import Recording
from magyc_gtsam.report import write_report
from magyc_gtsam.report.analysis import (
    Coverage,
    coverage,
    disturbed_stretches,
    ellipsoid_outline,
    field_history,
    level_turn,
    summary,
)
from magyc_gtsam.report.page import render
from magyc_gtsam.report.plots import coverage_map
from magyc_gtsam.report.words import advice, stretch, uncertain

SOFT_IRON = np.array([[1.10, 0.10, 0.04], [0.10, 0.88, 0.02], [0.04, 0.02, 1.22]])
HARD_IRON = np.array([2e-6, 12e-6, 9e-6])
GYRO_BIAS = np.array([4e-3, -5e-3, 2e-3])
FIELD = np.array([22.7e-6, 5.2e-6, 41.2e-6])  # north, east, down
STRENGTH = float(np.linalg.norm(FIELD))
HOSTILE = "<script>document.title = 'taken'</script>"


def simulated(noise: float = 1e-6, name: str = "dive.mcap") -> Recording:
    """Ten minutes at 10 Hz of roll ±5°, pitch ±45° and heading ±360°, with acceleration and attitude."""
    time = np.arange(6000) / 10
    heading = 2 * np.pi * np.sin(0.05 * time)
    pitch = np.radians(45) * np.sin(0.3 * time)
    roll = np.radians(5) * np.sin(0.2 * time)
    attitude = Rotation.from_euler("ZYX", np.stack([heading, pitch, roll], axis=1))
    field = attitude.inv().apply(FIELD) @ SOFT_IRON.T + HARD_IRON
    generator = np.random.default_rng(0)
    return Recording(
        time,
        field + generator.normal(0, noise, field.shape),
        generator.normal(0, 0.1, field.shape),  # the report does not look at it
        acceleration=attitude.inv().apply([0.0, 0.0, -9.81]),
        attitude=attitude.as_quat(),
        name=name,
    )


def good() -> Calibration:
    """The truth, with a covariance."""
    sigma = np.concatenate([np.full(6, 1e-3), np.full(3, 0.15e-6), np.full(3, 0.2e-3)])
    return Calibration(
        SOFT_IRON,
        HARD_IRON,
        GYRO_BIAS,
        np.diag(sigma**2),
        delay_sigma=2e-3,
        method="smoother",
        message="converged in 6 iterations",
        noise={"magnetic_field": 1e-6, "angular_rate": 5e-3},
        field_strength=STRENGTH,
        observability=Observability(True),
        diagnostics={"cost": 1.02, "weights": [1.0] * 600},
    )


def bad() -> Calibration:
    """Of a method without covariance or gyroscope, not observable."""
    weak = Weakness("hard iron along z", 14.0, 1.0, "µT", "pitch by 20° or more while turning")
    return Calibration(
        SOFT_IRON,
        HARD_IRON + np.array([0, 0, 20e-6]),
        method="twostep",
        converged=False,
        message="no minimum found in 200 iterations",
        observability=Observability(False, (weak,), 9.0),
    )


def residuals(disturbed: slice = slice(150, 180)) -> SimpleNamespace:
    """Windows of a second whose residuals are noise, but for a disturbed stretch and one hole."""
    generator = np.random.default_rng(1)
    weight, link_sigma = np.ones(600), np.full(599, 3e-3)
    magnetic = generator.normal(0, 0.3e-6, (600, 3))
    magnetic[disturbed] += 3e-6
    weight[disturbed] = 0.1
    link_sigma[400] = np.inf
    return SimpleNamespace(
        time=np.arange(600) + 0.5,
        magnetic_field=magnetic,
        magnetic_sigma=np.full(600, 0.3e-6),
        magnetic_weight=weight,
        link=generator.normal(0, 3e-3, (599, 3)),
        link_sigma=link_sigma,
        link_weight=np.ones(599),
    )


def test_level_turn_is_the_error_of_the_raw_heading() -> None:
    turn = level_turn(good(), field_history(simulated(), good()))
    dip = np.degrees(np.arctan2(FIELD[2], np.hypot(FIELD[0], FIELD[1])))
    assert turn.inclination == pytest.approx(dip, abs=0.1)
    # The same turn with the vehicle's own angles: z down, magnetic heading from the field's direction.
    heading = np.radians(turn.heading)
    level = Rotation.from_euler("Z", heading[:, None]).inv().apply(FIELD)
    raw = level @ SOFT_IRON.T + HARD_IRON
    error = np.arctan2(-raw[:, 1], raw[:, 0]) - np.arctan2(-level[:, 1], level[:, 0])
    largest = np.degrees(np.abs(np.angle(np.exp(1j * error)))).max()
    assert np.abs(turn.error).max() == pytest.approx(largest, abs=0.3)


def test_level_turn_sigma_is_the_spread_of_calibrations() -> None:
    calibration = good()
    assert calibration.covariance is not None
    history = field_history(simulated(), calibration)
    turn = level_turn(calibration, history)
    assert turn.sigma is not None
    generator = np.random.default_rng(2)
    draws = generator.multivariate_normal(np.zeros(12), calibration.covariance, size=400)
    errors = []
    for draw in draws:
        soft_iron = SOFT_IRON.copy()
        upper = np.triu_indices(3)
        soft_iron[upper] += draw[:6]
        soft_iron.T[upper] = soft_iron[upper]
        # What is left of the true field when it was measured by this sensor and corrected as by `good`.
        sensor = replace(
            calibration,
            soft_iron=np.linalg.inv(SOFT_IRON) @ soft_iron,
            hard_iron=np.linalg.inv(SOFT_IRON) @ draw[6:9],
        )
        errors.append(level_turn(sensor, history).error)
    np.testing.assert_allclose(np.std(errors, axis=0), turn.sigma, rtol=0.15)


def test_heading_error_and_dip_of_a_perfect_calibration_are_flat() -> None:
    recording = simulated(noise=1e-12)
    history = field_history(recording, good())
    assert history.heading_error is not None
    assert np.std(history.heading_error[:, 0]) > 10
    np.testing.assert_allclose(history.heading_error[:, 1], 0, atol=1e-4)
    assert history.up is not None
    np.testing.assert_allclose(history.up[0], [0, 0, -1], atol=1e-6)  # level at first, z axis down


def test_delay_is_taken_out_before_the_heading_is_compared() -> None:
    recording = simulated(noise=1e-12)
    field = np.roll(recording.magnetic_field, 2, axis=0)
    late = replace(recording, magnetic_field=field).rows(slice(2, None))
    without = field_history(late, good()).heading_error
    within = field_history(late, replace(good(), delay=0.2)).heading_error
    assert without is not None
    assert within is not None
    assert np.std(within[:-2, 1]) < 1e-3 < 0.1 < np.std(without[:, 1])


def test_ellipsoid_outline_touches_the_extremes_of_the_ellipsoid() -> None:
    unit = np.random.default_rng(3).normal(size=(200_000, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    surface = unit @ SOFT_IRON.T + 0.3
    outline = ellipsoid_outline(SOFT_IRON, np.full(3, 0.3), (0, 2))
    np.testing.assert_allclose(outline.max(axis=0), surface[:, [0, 2]].max(axis=0), atol=5e-3)
    np.testing.assert_allclose(outline.min(axis=0), surface[:, [0, 2]].min(axis=0), atol=5e-3)


def test_coverage_counts_seconds_in_equal_areas() -> None:
    directions = np.random.default_rng(4).normal(size=(200_000, 3))
    visited = coverage(np.arange(200_000) * 0.01, directions)
    assert visited.share == 1.0
    assert visited.seconds.sum() == pytest.approx(2000)
    assert np.ptp(visited.seconds) / visited.seconds.mean() < 0.3


def test_disturbed_stretches_join_neighbours_and_keep_strangers_apart() -> None:
    weight = np.ones(100)
    weight[[0, 1, 3, 50]] = 0.2
    assert disturbed_stretches(np.arange(100) + 0.5, weight) == [(0.0, 4.0), (50.0, 51.0)]
    assert disturbed_stretches(np.arange(100) + 0.5, np.ones(100)) == []


def test_summary_keeps_extremes_and_leaves_unknown_out() -> None:
    value = np.zeros(10_000)
    value[1234], value[5000:6000] = 7.0, np.nan
    _, mean, lowest, highest = summary(np.arange(10_000.0), value, most=100)
    assert len(mean) == 100
    assert np.nanmax(highest) == 7.0
    assert np.nanmin(lowest) == 0.0
    assert np.isnan(mean[50:60]).all()
    assert np.isfinite(mean[:50]).all()


def test_numbers_carry_two_digits_of_their_sigma() -> None:
    assert uncertain(12.3456, 0.0312).replace("\N{NO-BREAK SPACE}", " ") == "12.346 ± 0.031"
    assert uncertain(12.3456, 31.2).replace("\N{NO-BREAK SPACE}", " ") == "12 ± 31"
    assert uncertain(12.3456, np.nan) == "12.3456"
    assert stretch((119.6, 150.2)) == "119–151 s (1:59–2:31)"


def test_target_is_a_file_or_a_directory(tmp_path: Path) -> None:
    run = tmp_path / "new" / "run"
    assert write_report(run, simulated(), good()) == run / "report.html"
    assert write_report(tmp_path / "dive.html", simulated(), good()) == tmp_path / "dive.html"
    assert sorted(path.name for path in tmp_path.rglob("*.*")) == ["dive.html", "report.html"]


def test_page_of_a_short_recording_without_anything_optional() -> None:
    recording = simulated()
    short = Recording(recording.time[:5], recording.magnetic_field[:5])
    assert "Unnamed recording" in render(short, Calibration(np.eye(3), np.zeros(3)))


def test_page_with_holes_in_the_reference_and_in_the_data() -> None:
    recording = simulated()
    assert recording.attitude is not None
    attitude = recording.attitude.copy()
    attitude[1000:3000] = np.nan
    rows = np.ones(6000, dtype=bool)
    rows[4000:4100] = False
    page = render(replace(recording, attitude=attitude, acceleration=None).rows(rows), good(), residuals())
    assert "1 gap, the longest of 10.1 s after 400 s" in page
    assert "z axis is taken as up" in page


def test_page_says_when_calibration_made_it_worse() -> None:
    page = render(simulated(), replace(good(), soft_iron=np.linalg.inv(SOFT_IRON), hard_iron=-HARD_IRON))
    assert "varies more than that of the raw field" in page
    assert "agrees less with the reference" in page


def test_page_of_a_mirrored_sensor_says_which_target_cannot_hold_it() -> None:
    page = render(simulated(), replace(good(), soft_iron=np.diag([1.0, 1.0, -1.0]) @ SOFT_IRON))
    assert "mirrors an axis, which PX4" in page
    assert "$VNWRG,23," in page


def drawn_figures(page: Any) -> int:
    """How many figures have a size, a line or image in them, and images that decode."""
    return int(
        page.evaluate(
            """async () => {
              const figures = [...document.querySelectorAll("figure svg")];
              for (const image of document.querySelectorAll("figure svg image, img")) {
                const copy = new Image();
                copy.src = image.getAttribute("xlink:href") || image.getAttribute("href") || image.src;
                await copy.decode();
                if (!(copy.naturalWidth > 0)) return -1;
              }
              return figures.filter((f) => f.getBoundingClientRect().height > 50
                && f.querySelectorAll("path").length > 5).length;
            }"""
        )
    )


def test_trusted_page(opened: Any, tmp_path: Path) -> None:
    recording = simulated()
    page = opened(write_report(tmp_path, recording, good(), residuals()))
    assert page.locator("#verdict h1").inner_text() == "Calibrated"
    verdict = page.locator("#verdict").inner_text()
    assert "Converged in 6 iterations." in verdict
    assert "dive.mcap · method smoother · 600 s · 6,000 magnetometer samples" in verdict
    assert drawn_figures(page) == 4 + 4 + 4
    text = page.inner_text("main")
    for number in ("47.33 µT", "12.00 ± 0.15", "-5.00 ± 0.20", "0.0 ± 2.0", "150–180 s (2:30–3:00)"):
        assert number in text.replace("\N{NO-BREAK SPACE}", " ")
    assert "600 values" in page.text_content("#configuration")


def test_untrusted_page_escapes_a_hostile_name(opened: Any, tmp_path: Path) -> None:
    recording = replace(simulated(name=HOSTILE), acceleration=None, attitude=None, notes=(HOSTILE,))
    calibration = replace(bad(), configuration={"topic": HOSTILE}, message=f"no minimum found {HOSTILE}")
    page = opened(write_report(tmp_path, recording, calibration))
    assert page.locator("#verdict h1").inner_text() == "Do not use this calibration"
    verdict = page.locator("#verdict").inner_text()
    assert HOSTILE in verdict
    assert "hard iron along z ±14 µT (limit 1): pitch by 20° or more while turning" in verdict
    assert page.title().startswith("Calibration of <script>")
    assert drawn_figures(page) == 4 + 2
    text = page.inner_text("main")
    assert "Do not paste the parameters below into the vehicle yet." in text
    assert "This method states no uncertainty." in text
    assert "Neither an accelerometer nor a reference attitude was recorded" in text
    assert "The method twostep does not work on windows" in text


def test_copy_button_copies_what_export_gives(opened: Any, tmp_path: Path) -> None:
    page = opened(write_report(tmp_path, simulated(), good()))
    for index, target in enumerate(("px4", "ardupilot", "vectornav", "ros")):
        button = page.locator("button.copy").nth(index)
        button.click()
        page.wait_for_function("b => b.textContent === 'Copied'", arg=button.element_handle())
        assert page.evaluate("navigator.clipboard.readText()").strip() == good().export(target).strip()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_phone_page_does_not_scroll_sideways(opened: Any, tmp_path: Path, scheme: str) -> None:
    page = opened(write_report(tmp_path, simulated(), good(), residuals()), width=390, scheme=scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    ink, ground = page.evaluate(
        "[getComputedStyle(document.body).color, getComputedStyle(document.body).backgroundColor]"
    )
    brightness = [sum(int(part) for part in colour[4:-1].split(",")) for colour in (ink, ground)]
    assert (brightness[0] < brightness[1]) == (scheme == "light")


def test_numbers_of_a_result_that_failed_stay_in_their_cards(opened: Any, tmp_path: Path) -> None:
    """A fit that diverged has any size: 656 µT where 1 is usual, and deviations of thousands of degrees."""
    failed = replace(bad(), soft_iron=SOFT_IRON * 1e-2, hard_iron=HARD_IRON * 1e3, covariance=np.eye(9) * 1e-3)
    page = opened(write_report(tmp_path, simulated(), failed))
    overflowing = page.evaluate(
        "[...document.querySelectorAll('.number')].filter(n => n.scrollWidth > n.clientWidth).map(n => n.innerText)"
    )
    assert overflowing == []
    text = page.inner_text("main")
    assert "uncertain by all of it at worst" in text
    assert not re.search(r"\d\.\d+e\+\d+°", text)


def test_one_line_of_advice_for_each_remedy() -> None:
    turn = "turn through all headings"
    weak = tuple(
        Weakness(f"hard iron along {axis}", 9.0, 1.0, "µT", remedy)
        for axis, remedy in (("x", turn), ("z", "pitch"), ("y", turn))
    )
    calibration = replace(bad(), observability=Observability(False, weak))
    lines = advice(simulated(), calibration, ())
    assert lines[1:3] == [
        "Turn through all headings: for hard iron along x, hard iron along y.",
        "Pitch: for hard iron along z.",
    ]


def test_text_in_figures_can_be_read_on_a_phone(opened: Any, tmp_path: Path) -> None:
    write_report(tmp_path / "report.html", simulated(), good(), residuals())
    sizes = opened(tmp_path / "report.html", 390).evaluate(
        """[...document.querySelectorAll('figure svg text')].filter(t => t.textContent.trim())
        .map(t => parseFloat(getComputedStyle(t).fontSize) * Math.hypot(t.getScreenCTM().a, t.getScreenCTM().b))"""
    )
    assert len(sizes) > 50
    assert min(sizes) > 11


@pytest.mark.parametrize(
    "seconds", [(20.0,), (20.0, 20.5), (20.0, 25.0), (20.0, 50.0), (0.1, 1.0, 40.0), (0.005, 0.2, 60.0)]
)
def test_the_map_of_directions_labels_little_time_too(seconds: tuple[float, ...]) -> None:
    """Also where one cell or few were visited, for almost the same time: one label or more, and none twice."""
    visited = np.zeros((12, 24))
    visited[6, : len(seconds)] = seconds
    svg = coverage_map(Coverage(np.linspace(0, 2 * np.pi, 25), np.linspace(-1, 1, 13), visited))
    labels = [float(text) for text in re.findall(r">([\d.]+)</text>", svg)]
    assert 1 <= len(labels) <= 9
    assert len(set(labels)) == len(labels)
    apart = np.diff(np.log(np.sort(labels))) / np.log(max(seconds) / min(seconds) / 0.9)
    assert (apart > 0.1).all()  # of the bar's length
