"""The leaderboard: fetched and checked, judged by optics, open to methods from outside."""

from __future__ import annotations

import functools
import http.server
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam import cli
from magyc_gtsam.estimators import method as outside
from magyc_gtsam.storage.files import sha256
from magyc_gtsam.study.leaderboard import fetching
from magyc_gtsam.study.leaderboard.collections import COLLECTIONS, kind_of
from magyc_gtsam.study.leaderboard.optics import reference_of
from magyc_gtsam.study.leaderboard.reading import read_public
from magyc_gtsam.study.leaderboard.running import DELIVERED, OPTICS, score
from magyc_gtsam.study.leaderboard.standings import losses, standings

NAMES = ("broad_01_undisturbed_slow_rotation_A", "broad_04_undisturbed_slow_rotation_with_breaks_A")


def _recorded(seed: int) -> mg.Recording:
    return mg.simulate("wide", 60, 10, seed=seed).recording


def _keep(folder: Path, name: str, recording: mg.Recording) -> None:
    np.savez(
        folder / f"{name}.npz",
        tm=recording.time,
        m=recording.magnetic_field,
        w=recording.angular_rate,
        tq=recording.time[::3],
        q=recording.attitude[::3],
    )


@pytest.fixture
def mirror(tmp_path: Path) -> Iterator[tuple[Path, str]]:
    """A folder that is served: two recordings of one unit, and one that nothing can judge."""
    folder = tmp_path / "mirror"
    folder.mkdir()
    for seed, name in enumerate((*NAMES, "broad_32_disturbed_attached_magnet_1cm")):
        _keep(folder, name, _recorded(seed))
    rows = [f"{file.name} {sha256(file)}\n" for file in sorted(folder.iterdir())]
    (folder / "registry.txt").write_text("".join(rows))

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=folder)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield folder, f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def test_recordings_are_fetched_once_and_checked(mirror: tuple[Path, str], tmp_path: Path) -> None:
    pytest.importorskip("pooch")
    folder, address = mirror
    files = fetching.fetch(tmp_path / "kept", address)
    assert [file.name for file in files] == sorted(file.name for file in folder.glob("*.npz"))
    first = folder / files[0].name
    first.rename(folder / "gone")
    assert fetching.fetch(tmp_path / "kept", address) == files
    files[0].unlink()
    with pytest.raises(mg.MagycError, match="cannot be fetched"):
        fetching.fetch(tmp_path / "kept", address)
    first.write_bytes((folder / "gone").read_bytes() + b"more")
    with pytest.raises(mg.MagycError, match="its SHA-256 differs"):
        fetching.fetch(tmp_path / "kept", address)
    assert not files[0].exists()


def test_originals_are_held_against_their_first_fetch(
    mirror: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pooch")
    from dataclasses import replace

    folder, address = mirror
    original = replace(COLLECTIONS[0], address=address + "/", files=(f"{NAMES[0]}.npz",))
    monkeypatch.setattr(fetching, "COLLECTIONS", (original,))
    (kept,) = fetching.fetch(tmp_path / "kept")
    kept.unlink()
    (folder / kept.name).write_bytes(b"something else")
    with pytest.raises(mg.MagycError, match="its SHA-256 differs"):
        fetching.fetch(tmp_path / "kept")


def _publish(folder: Path, walk: str, recording: mg.Recording, later: float) -> None:
    """Write a walk as Michel et al. published theirs; the cameras start `later` than the phone."""
    android, boot = "Nexus5" in walk, 135640.331
    sensors = folder / ("android" if android else "ios") / walk
    sensors.mkdir(parents=True)
    clock = recording.time[:, None] + (0.0 if android else boot)
    own = [np.tile([60.0, -50.0, 410.0], (len(clock), 1))] if android else []
    gravity = 1.0 if android else -9.80665
    np.savetxt(sensors / "magnetometer.txt", np.hstack([clock, recording.magnetic_field * 1e6, *own]))
    np.savetxt(sensors / "gyroscope.txt", np.hstack([clock, recording.angular_rate]))
    np.savetxt(sensors / "accelerometer.txt", np.hstack([clock, recording.acceleration / gravity]))
    (sensors / "description.txt").write_text(f"[Time]\nBootTime = {boot}")
    seen = recording.time > later
    rotations = Rotation.from_quat(recording.attitude[seen]).as_matrix()
    rotations[5:8] = np.nan  # frames without the phone
    capture = {
        "Frames": float(seen.sum()),
        "FrameRate": 1 / float(np.mean(np.diff(recording.time))),
        "RigidBodies": {"Rotations": rotations.transpose(2, 1, 0).reshape(1, 9, -1)},
    }
    (folder / "qualisys").mkdir(exist_ok=True)
    savemat(folder / "qualisys" / f"{walk}.mat", {"Session_7": capture})


def test_walks_with_a_phone_are_fetched_as_they_were_published(
    mirror: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pooch")
    from dataclasses import replace

    folder, address = mirror
    walks = ("Jakob_iPhone5_NoDist_AR", "Jakob_Nexus5_NoDist_AR")
    recordings = [mg.simulate("wide", 60, 50, seed=seed).recording for seed in (5, 6)]
    for walk, recording in zip(walks, recordings, strict=True):
        _publish(folder, walk, recording, later=2.7)
    files = tuple(f"{walk}.npz" for walk in walks)
    monkeypatch.setattr(fetching, "COLLECTIONS", (replace(COLLECTIONS[1], address=f"{address}/", files=files),))
    kept = {file.stem: file for file in fetching.fetch(tmp_path / "kept")}
    for walk, recording in zip(walks, recordings, strict=True):
        back, device = read_public(kept[walk], mg.read)
        assert np.allclose(back.magnetic_field, recording.magnetic_field, atol=1e-12)
        assert np.allclose(back.angular_rate, recording.angular_rate)
        assert np.allclose(back.acceleration, recording.acceleration)
        assert device == pytest.approx([60e-6, -50e-6, 410e-6] if "Nexus5" in walk else [0, 0, 0])
        known = np.isfinite(back.attitude).all(axis=1) & (back.time > 3.5)
        assert known.mean() > 0.9
        away = Rotation.from_quat(back.attitude[known]).inv() * Rotation.from_quat(recording.attitude[known])
        assert np.degrees(np.percentile(away.magnitude(), 95)) < 0.5  # of up to 30 °/s: aligned to some 10 ms
    (folder / "qualisys" / f"{walks[0]}.mat").write_bytes(b"no matrix")
    assert sorted(fetching.fetch(tmp_path / "kept")) == sorted(kept.values())
    kept[walks[0]].unlink()
    with pytest.raises(mg.MagycError, match="its published files cannot be read"):
        fetching.fetch(tmp_path / "kept")


def test_a_mirror_names_no_file_elsewhere(mirror: tuple[Path, str], tmp_path: Path) -> None:
    pytest.importorskip("pooch")
    folder, address = mirror
    (folder / "registry.txt").write_text(f"../{NAMES[0]}.npz {'0' * 64}\n")
    with pytest.raises(mg.MagycError, match="is not the name of a recording"):
        fetching.fetch(tmp_path / "kept", address)


def test_units_and_judges() -> None:
    judges = {name: kind_of(name).judges for name in (*NAMES, "10_undisturbed_slow_translation_A")}  # type: ignore[union-attr]
    assert list(judges.values()) == [True, True, False]
    assert kind_of("Thibaud_iPhone5_Dist_AR").unit == kind_of("Jakob_iPhone5_NoDist_AR").unit  # type: ignore[union-attr]
    assert kind_of("Thibaud_Nexus5_Dist_AR").unit != kind_of("Jakob_Nexus5_NoDist_AR").unit  # type: ignore[union-attr]
    assert kind_of("39_disturbed_mixed") is None


def test_the_form_of_broad_is_read_like_the_arrays(tmp_path: Path) -> None:
    recording = _recorded(0)
    savemat(
        tmp_path / "01_undisturbed_slow_rotation_A.mat",
        {
            "imu_mag": recording.magnetic_field * 1e6,
            "imu_gyr": recording.angular_rate,
            "imu_acc": recording.acceleration,
            "opt_quat": recording.attitude[:, [3, 0, 1, 2]],
            "sampling_rate": 10.0,
        },
    )
    back, device = read_public(tmp_path / "01_undisturbed_slow_rotation_A.mat", mg.read)
    assert np.allclose(back.magnetic_field, recording.magnetic_field, atol=1e-15)
    same = np.abs(np.einsum("ni,ni->n", back.attitude, recording.attitude))
    assert np.allclose(same, 1)
    assert not device.any()
    (tmp_path / "01_x.npz").write_bytes(b"PK\x03\x04")
    with pytest.raises(mg.MagycError, match="fetch it again"):
        read_public(tmp_path / "01_x.npz", mg.read)


def test_optics_find_the_truth_and_its_delay() -> None:
    simulation = mg.simulate("wide", 300, 25, seed=3)
    recording = simulation.recording
    late = mg.Recording.from_streams(
        (recording.time + 0.04, recording.magnetic_field),
        (recording.time, recording.angular_rate),
        attitude=(recording.time, recording.attitude),
    )
    found = reference_of(late)
    assert found.delay == pytest.approx(0.04, abs=0.01)
    away = found.calibration.hard_iron - simulation.truth.hard_iron
    assert away @ np.linalg.solve(found.covariance, away) < 20
    still = score(late, found, simulation.truth)
    raw = score(late, found, mg.Calibration(np.eye(3), np.zeros(3)))
    assert still.heading < 3 < raw.heading
    assert still.direction < raw.direction


METHOD = """
import numpy as np
import magyc_gtsam as mg

METHOD = mg.Method("does nothing", "nobody", (), "half_hearted:calibrate")


def calibrate(recording, *, progress=None):
    return mg.Calibration(np.eye(3), np.zeros(3), method="half-hearted", converged=True)
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """An installed package with a method, one that takes a name of ours, and one that cannot be loaded."""
    site = tmp_path / "site"
    about = site / "half_hearted-1.0.dist-info"
    about.mkdir(parents=True)
    (site / "half_hearted.py").write_text(METHOD)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: half-hearted\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[magyc_gtsam.methods]\nhalf-hearted = half_hearted:METHOD\nellipsoid = half_hearted:METHOD\n"
        "broken = not_installed:METHOD\n"
    )
    monkeypatch.syspath_prepend(site)
    outside._points.cache_clear()
    outside._loaded.cache_clear()
    yield
    outside._points.cache_clear()
    outside._loaded.cache_clear()


@pytest.mark.usefixtures("package")
def test_a_method_from_outside_joins() -> None:
    found = mg.methods()
    assert found["half-hearted"].summary == found["half-hearted:ellipsoid"].summary == "does nothing"
    assert found["ellipsoid"].summary != "does nothing"
    recording = _recorded(0)
    assert not mg.calibrate(recording, "half-hearted").hard_iron.any()
    with pytest.raises(mg.MagycError, match="package half-hearted cannot be loaded"):
        mg.calibrate(recording, "broken")


@pytest.mark.usefixtures("package")
def test_the_board_has_wins_and_losses_of_all(
    mirror: tuple[Path, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pooch")
    parquet = pytest.importorskip("pyarrow.parquet")
    output = tmp_path / "board"
    command = ["study", "leaderboard", "--base-url", mirror[1], "--folder", str(tmp_path / "kept")]
    command += ["-o", str(output), "--workers", "1"]
    for method in ("half-hearted", "ellipsoid", "smoother", "broken"):
        command += ["--method", method]
    assert cli.main(command) == 0
    said = capsys.readouterr().out
    assert "half-hearted is behind the best in 2 pairs" in said
    assert "broken failed on" in said
    assert "CC BY 4.0" in said
    assert "no other recording of its unit can judge: broad_32" in said
    assert said.index("own optics") < said.index("smoother") < said.index("half-hearted")
    rows = parquet.read_table(output / "leaderboard.parquet").to_pylist()
    assert len(rows) == 2 * 6
    table = {each.method: each for each in standings(rows)}
    assert table["smoother"].heading < 1.1 * table[OPTICS].heading < table[DELIVERED].heading
    assert table["smoother"].covered is not None
    assert table["half-hearted"].worse == table["half-hearted"].better == 0
    assert table["broken"].trusted == 0
    assert table["broken"].heading == table[DELIVERED].heading
    assert [pair.judged_on for pair, _ in losses(rows, "half-hearted")] != []
    page = (output / "index.html").read_text(encoding="utf-8")
    assert "half-hearted is behind the best" in page
    for part in (output / "parts").glob("*half-hearted*"):
        part.unlink()
    before = {part: part.stat().st_mtime_ns for part in (output / "parts").iterdir()}
    assert cli.main(command) == 0
    after = {part: part.stat().st_mtime_ns for part in (output / "parts").iterdir()}
    assert len(after) == 12
    assert before.items() <= after.items()
