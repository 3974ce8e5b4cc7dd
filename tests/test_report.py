"""The report page: its numbers, and the page itself in a browser without a network."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators import calibrate
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import with_minus
from magyc_gtsam.heading_uncertainty import turn_of
from magyc_gtsam.level_turn import TILT
from magyc_gtsam.observability import Observability, Weakness
from magyc_gtsam.recording import Recording
from magyc_gtsam.report.analysis import (
    coverage,
    disturbed_stretches,
    ellipsoid_outline,
    field_history,
    summary,
)
from magyc_gtsam.report.charts import packed
from magyc_gtsam.report.page import render, write_report
from magyc_gtsam.report.plots import level_turn_error
from magyc_gtsam.report.words import advice, parameter_rows, stretch, uncertain
from magyc_gtsam.simulation import simulate

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
    turn = turn_of(simulated(), good())
    dip = np.degrees(np.arctan2(FIELD[2], np.hypot(FIELD[0], FIELD[1])))
    assert turn.dip == pytest.approx(dip, abs=0.1)
    # The same turn with the vehicle's own angles: z down, magnetic heading from the field's direction.
    heading = np.radians(turn.heading)
    level = Rotation.from_euler("Z", heading[:, None]).inv().apply(FIELD)
    raw = level @ SOFT_IRON.T + HARD_IRON
    error = np.arctan2(-raw[:, 1], raw[:, 0]) - np.arctan2(-level[:, 1], level[:, 0])
    largest = np.degrees(np.abs(np.angle(np.exp(1j * error)))).max()
    assert np.abs(turn.raw_error(SOFT_IRON, HARD_IRON)).max() == pytest.approx(largest, abs=0.3)


def test_a_hard_iron_along_the_vertical_turns_the_heading_of_a_tilted_vehicle_only() -> None:
    turn = turn_of(simulated(), good())
    off = 2e-6 * np.cross(turn.ahead, turn.left)
    level, *tilted = (np.ptp(each.error(each.field + off)) for each in (turn, *turn.tilted()))
    assert level < 0.01
    horizontal = np.linalg.norm(FIELD) * np.cos(np.radians(turn.dip))
    expected = 2 * np.degrees(2e-6 * np.sin(np.radians(TILT)) / horizontal)
    np.testing.assert_allclose(tilted, expected, rtol=0.05)


def test_zeros_in_place_of_an_acceleration_are_no_vertical() -> None:
    bare = replace(simulated(), attitude=None, acceleration=None)
    zeros = turn_of(replace(bare, acceleration=np.zeros_like(bare.magnetic_field)), good())
    assert (zeros.dip, zeros.about) == (60.0, turn_of(bare, good()).about)


@pytest.mark.parametrize(
    ("motion", "dip", "seen"), [("ship", 84.0, 84.0), ("level", 20.0, 20.0), ("wide", 80.0, 60.0)]
)
def test_without_an_accelerometer_the_dip_is_that_above_the_sweep_of_the_field(
    motion: str, dip: float, seen: float
) -> None:
    """A dip of 60° near a pole would state a tenth of the heading error."""
    field = 60e-6 * np.array([np.cos(np.radians(dip)), 0.0, np.sin(np.radians(dip))])
    simulation = simulate(motion, 120, seed=1, field=field)
    turn = turn_of(replace(simulation.recording, attitude=None, acceleration=None), simulation.truth)
    assert turn.dip == pytest.approx(seen, abs=1.5)


def test_systematic_heading_error_is_the_spread_of_calibrations() -> None:
    calibration = good()
    assert calibration.covariance is not None
    turn = turn_of(simulated(), calibration)
    generator = np.random.default_rng(2)
    upper = np.triu_indices(3)
    errors = []
    for draw in generator.multivariate_normal(np.zeros(12), calibration.covariance, size=400):
        soft_iron = SOFT_IRON.copy()
        soft_iron[upper] += draw[:6]
        soft_iron.T[upper] = soft_iron[upper]
        # What is left of the true field when it was measured by this sensor and corrected as by `good`.
        errors.append(turn.raw_error(np.linalg.inv(SOFT_IRON) @ soft_iron, np.linalg.inv(SOFT_IRON) @ draw[6:9]))
    expected = turn.systematic(calibration.covariance, SOFT_IRON)
    np.testing.assert_allclose(np.std(errors, axis=0), expected, rtol=0.15)


def test_the_band_that_is_drawn_is_the_heading_sigma_that_is_stated() -> None:
    """The iron alone, without the uncertainty of the sensors' axes, has 0.11° in place of 0.12°."""
    recording = simulate("low", seed=3).recording
    calibration = calibrate(recording)
    figure = Figure()
    level_turn_error(figure, turn_of(recording, calibration), calibration)
    (band,) = figure.axes[1].collections
    assert calibration.observability is not None
    assert band.get_paths()[0].vertices[:, 1].max() == pytest.approx(calibration.observability.heading_sigma)


def test_heading_error_of_single_samples_is_that_of_noise() -> None:
    turn = turn_of(simulated(), good())
    noise = np.random.default_rng(5).normal(0, 1e-6, (4000, *turn.field.shape))
    true = turn.field @ np.column_stack([turn.ahead, turn.left])
    off = (turn.field + noise @ np.linalg.inv(SOFT_IRON).T) @ np.column_stack([turn.ahead, turn.left])
    angle = np.arctan2(off[..., 1], off[..., 0]) - np.arctan2(true[:, 1], true[:, 0])
    spread = np.degrees(np.angle(np.exp(1j * angle))).std(axis=0)
    np.testing.assert_allclose(turn.per_sample(1e-6, SOFT_IRON), spread, rtol=0.1)


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
    assert uncertain(-0.18, 155.0).replace("\N{NO-BREAK SPACE}", " ") == "0 ± 155"
    assert stretch((119.6, 150.2)) == "119–151 s (1:59–2:31)"


def test_terms_of_a_calibration_are_rows_in_the_units_of_the_page() -> None:
    terms = (
        Term("misalignment", np.radians([0.5, -1.0, 0.0]), np.eye(3) * np.radians(0.1) ** 2),
        Term("gyro-scale", np.array([0.012, 0.0, -0.02]), np.eye(3) * 1e-6, {"x": 1.0, "y": 1.0, "z": 1.0}),
        Term("timing", np.array([0.0125]), np.eye(1) * 1e-8),
    )
    calibration = replace(good(), terms=terms)
    rows = dict(parameter_rows(calibration))
    assert rows["Misalignment of the chips (°)"][:2] == [
        "0.50 ±\N{NO-BREAK SPACE}0.10",
        "−1.00 ±\N{NO-BREAK SPACE}0.10",
    ]
    assert rows["Gyroscope scale, read too large by (%)"][0] == "1.20 ±\N{NO-BREAK SPACE}0.10"
    page = render(simulated(), calibration)
    assert "timing (SI units): 0.0125" in page
    assert "Term(" not in page


def test_target_has_the_suffix_of_a_page_or_is_a_folder(tmp_path: Path) -> None:
    with pytest.raises(MagycError, match=r"must end in \.html or \.pdf, got 'r\.txt'"):
        write_report(tmp_path / "r.txt", simulated(), good())
    assert not list(tmp_path.iterdir())
    folder = tmp_path / "2026.01"
    folder.mkdir()
    assert write_report(folder, simulated(), good()) == folder / "report.html"
    assert write_report(tmp_path / "R.HTML", simulated(), good()) == tmp_path / "R.HTML"


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
    assert "mirrors an axis, which the symmetric matrix of PX4" in page
    assert "$VNWRG,23," in page


def drawn_figures(page: Any) -> int:
    """How many figures have something painted once they are looked at; those in closed details are opened."""
    page.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true; })")
    figures = page.locator("figure.chart")
    for index in range(figures.count()):
        figures.nth(index).scroll_into_view_if_needed()
    return int(
        page.evaluate(
            """async () => {
              const painted = (canvas) => {
                const { width, height } = canvas;
                if (!(width > 100 && height > 50)) return false;
                const pixels = canvas.getContext("2d").getImageData(0, 0, width, height).data;
                let inked = 0;
                for (let k = 3; k < pixels.length; k += 4) inked += pixels[k] > 0;
                return inked > 500;
              };
              await new Promise((done) => setTimeout(done, 300));
              return [...document.querySelectorAll("figure.chart canvas")].filter(painted).length;
            }"""
        )
    )


def test_trusted_page(opened: Any, tmp_path: Path) -> None:
    recording = simulated()
    page = opened(write_report(tmp_path, recording, good(), residuals()))
    assert page.locator("#verdict h1").inner_text() == "Calibrated"
    verdict = page.locator("#verdict").inner_text()
    assert "Systematic heading error at most" in verdict
    assert "single samples" in verdict
    assert "dive.mcap · method smoother · 600 s · 6,000 magnetometer samples" in verdict
    assert drawn_figures(page) == 2 + 4 + 4
    text = page.inner_text("main")
    for number in ("47.33 µT", "12.00 ± 0.15", "−5.00 ± 0.20", "0.0 ± 2.0", "150–180 s (2:30–3:00)"):
        assert number in text.replace("\N{NO-BREAK SPACE}", " ")
    assert "600 values" in page.text_content("#configuration")


def test_untrusted_page_escapes_a_hostile_name(opened: Any, tmp_path: Path) -> None:
    recording = replace(simulated(name=HOSTILE), acceleration=None, attitude=None, notes=(HOSTILE,))
    calibration = replace(bad(), configuration={"topic": HOSTILE}, message=f"no minimum found {HOSTILE}")
    page = opened(write_report(tmp_path, recording, calibration))
    assert page.locator("#verdict h1").inner_text() == "Do not use this calibration"
    verdict = page.locator("#verdict").inner_text()
    assert HOSTILE in verdict
    assert page.locator(".export button.copy").count() == 0
    page.locator("#verdict summary").click()
    assert "ard iron along z ±14 µT (limit 1): pitch by 20° or more while turning" in page.inner_text("#verdict")
    assert page.title().startswith("Calibration of <script>")
    assert drawn_figures(page) == 2 + 1
    text = page.inner_text("main")
    assert "Systematic heading error" not in text
    assert "No parameters are offered for copying, because the result must not be trusted." in text
    assert "This method gives no uncertainty." in text
    assert "Neither an accelerometer nor a reference attitude was recorded" in text
    assert "The method twostep does not work on windows" in text


def test_copy_button_copies_what_export_gives(opened: Any, tmp_path: Path) -> None:
    page = opened(write_report(tmp_path, simulated(), good()))
    for index, target in enumerate(("px4", "ardupilot", "vectornav", "ros")):
        button = page.locator(".export button.copy").nth(index)
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
    assert "Systematic heading error" not in text
    assert not re.search(r"\d\.\d+e\+\d+°", text)


def test_one_line_of_advice_for_each_remedy() -> None:
    turn = "turn through all headings"
    weak = tuple(
        Weakness(f"hard iron along {axis}", 9.0, 1.0, "µT", remedy)
        for axis, remedy in (("x", turn), ("z", "pitch"), ("y", turn))
    )
    calibration = replace(bad(), observability=Observability(False, weak))
    lines = advice(simulated(), calibration, ())
    assert lines[:2] == [
        "Turn through all headings, to determine hard iron along x, hard iron along y.",
        "Pitch, to determine hard iron along z.",
    ]


def charted(opened: Any, tmp_path: Path, **options: Any) -> Any:
    """The page of a good calibration with a disturbed stretch, all figures drawn."""
    page = opened(write_report(tmp_path, simulated(), good(), residuals()), **options)
    assert drawn_figures(page) == 10
    return page


def dragged(page: Any, over: Any, start: float, end: float) -> float:
    """Drag across an element, in shares of its width; its width in px."""
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    page.mouse.move(box["x"] + start * box["width"], box["y"] + 60)
    page.mouse.down()
    page.mouse.move(box["x"] + end * box["width"], box["y"] + 70, steps=5)
    page.mouse.up()
    return float(box["width"])


def test_hovering_reads_the_values(opened: Any, tmp_path: Path) -> None:
    page = charted(opened, tmp_path)
    figure = page.locator("figure.chart", has_text="Strength of the field")
    over = figure.locator(".u-over")
    over.scroll_into_view_if_needed()
    over.hover(position={"x": 100, "y": 50})
    found = re.fullmatch(
        r"Time ([\d.]+) · raw ([\d.]+) · calibrated ([\d.]+)", figure.locator(".readout").inner_text()
    )
    assert found
    assert float(found[3]) == pytest.approx(STRENGTH * 1e6, abs=1.5)
    ends = page.evaluate("f => [f.plot.scales.x.min, f.plot.scales.x.max]", figure.element_handle())
    expected = ends[0] + (ends[1] - ends[0]) * 100 / over.bounding_box()["width"]
    assert float(found[1]) == pytest.approx(expected, abs=2)


def test_an_interval_is_dragged_and_copied(opened: Any, tmp_path: Path) -> None:
    """As --start and --end; the other charts over time then show it."""
    page = charted(opened, tmp_path)
    dragged(page, page.locator("figure.chart", has_text="Strength of the field").locator(".u-over"), 0.2, 0.5)
    page.locator(".interval button").click()
    page.locator(".interval button", has_text="Copied").wait_for()
    copied = page.evaluate("navigator.clipboard.readText()")
    found = re.fullmatch(r"--start ([\d.]+) --end ([\d.]+)", copied)
    assert found, copied
    start, end = float(found[1]), float(found[2])
    assert end - start == pytest.approx(0.3 * 600, rel=0.05)
    shown = page.evaluate(
        "[...document.querySelectorAll('figure.chart')].find(f => f.textContent.includes('Dip')).plot.scales.x"
    )
    assert (shown["min"], shown["max"]) == pytest.approx((start, end), abs=0.1)


def test_the_sphere_turns_and_zooms(opened: Any, tmp_path: Path) -> None:
    page = charted(opened, tmp_path)
    figure = page.locator("figure.chart").first
    canvas = figure.locator("canvas")
    before = figure.get_attribute("data-view")
    dragged(page, canvas, 0.3, 0.5)
    after = figure.get_attribute("data-view")
    assert after != before
    rotation = np.array(after.split(), dtype=float).reshape(3, 3)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=5e-3)  # three digits are written
    assert np.linalg.det(rotation) == pytest.approx(1.0, abs=0.01)
    canvas.press("ArrowLeft")
    assert figure.get_attribute("data-view") != after
    page.keyboard.down("Control")
    page.mouse.wheel(0, -400)
    page.keyboard.up("Control")
    page.wait_for_function("f => +f.dataset.zoom > 1.5", arg=figure.element_handle())
    figure.get_by_text("along z").click()
    np.testing.assert_allclose(np.array(figure.get_attribute("data-view").split(), dtype=float)[6:], [0, 0, 1])


def test_a_key_hides_its_series(opened: Any, tmp_path: Path) -> None:
    """And the scale follows what is left: the calibrated strength alone spans little."""
    page = charted(opened, tmp_path)
    figure = page.locator("figure.chart", has_text="Strength of the field")
    span = "f => f.plot.scales.y.max - f.plot.scales.y.min"
    before = page.evaluate(span, figure.element_handle())
    figure.get_by_role("button", name="raw", exact=True).click()
    page.wait_for_timeout(100)
    assert page.evaluate(span, figure.element_handle()) < 0.5 * before


def test_dragging_zooms_a_chart(opened: Any, tmp_path: Path) -> None:
    page = charted(opened, tmp_path)
    figure = page.locator("figure.chart", has_text="Dip").first
    span = "f => f.plot.scales.x.max - f.plot.scales.x.min"
    before = page.evaluate(span, figure.element_handle())
    dragged(page, figure.locator(".u-over"), 0.2, 0.5)
    page.wait_for_timeout(100)
    assert page.evaluate(span, figure.element_handle()) == pytest.approx(0.3 * before, rel=0.05)


def test_page_prints_on_a4_without_cut_columns(opened: Any, tmp_path: Path) -> None:
    page = charted(opened, tmp_path, scheme="dark")
    page.emulate_media(media="print", color_scheme="dark")
    page.set_viewport_size({"width": 703, "height": 1000})  # A4 within its margins, at 96 dots per inch
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert page.evaluate("document.documentElement.scrollWidth") <= 703
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    wide = (
        "[...document.querySelectorAll('canvas, table, pre')].filter(e => e.getBoundingClientRect().right > 703)"
    )
    assert page.evaluate(f"{wide}.length") == 0


def test_page_is_small_and_packs_what_it_draws(tmp_path: Path) -> None:
    file = write_report(tmp_path, simulated(), good(), residuals())
    assert file.stat().st_size < 500_000
    values = np.array([0.0, 1.5, np.nan, -47.25])
    back = np.frombuffer(base64.b64decode(packed(values) or ""), dtype="<f4")
    np.testing.assert_array_equal(back, values)


def test_a_minus_is_a_minus() -> None:
    assert with_minus("-5.00 ± 0.20, x -3, −1 to -.5") == "−5.00 ± 0.20, x −3, −1 to −.5"
    assert with_minus("2024-06-01, dive-1, a-2, 1e-6") == "2024-06-01, dive-1, a-2, 1e-6"


def test_the_sphere_is_shown_whole_beside_a_large_hard_iron(opened: Any, tmp_path: Path) -> None:
    """A hard iron of nine times the field: raw points, calibrated points and both ellipsoids within the canvas."""
    iron = np.array([60e-6, -75e-6, 410e-6])
    recording, calibration = simulated(), good()
    moved = replace(recording, magnetic_field=recording.magnetic_field + iron)
    calibration = replace(calibration, hard_iron=calibration.hard_iron + iron)
    page = opened(write_report(tmp_path, moved, calibration))
    canvas = page.locator("#field canvas").first
    canvas.wait_for()
    painted = canvas.evaluate("""canvas => {
        const { data, width, height } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
        let edge = 0, all = 0;
        for (let y = 0; y < height; y++) for (let x = 0; x < width; x++) {
            if (!data[4 * (y * width + x) + 3]) continue;
            all += 1;
            if (Math.min(x, y, width - 1 - x, height - 1 - y) < 2) edge += 1;
        }
        return [edge, all];
    }""")
    assert painted[0] == 0
    assert painted[1] > 1000
