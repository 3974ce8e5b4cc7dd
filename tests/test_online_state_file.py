"""State files that were changed: refused with the reason, or usable; never an error from within later on."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.factors.errors import MagycError


@pytest.fixture(scope="module", params=["smoother", "magyc-ifg"])
def saved(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    if request.param == "magyc-ifg":
        pytest.importorskip("gtsam")
    recording = mg.simulate("wide", duration=30, rate=10, seed=3).recording
    online = mg.OnlineCalibrator(request.param)
    online.update(recording.time, recording.magnetic_field, recording.angular_rate)
    path = tmp_path_factory.mktemp("state") / "online.npz"
    online.save(path)
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


CHANGES: dict[str, Any] = {
    "one axis more": lambda a: a[..., None],
    "text": lambda a: a.astype(str),
    "a column more": lambda a: np.concatenate([a, a[..., :1]], axis=-1) if a.ndim > 1 else a.reshape(1, -1),
    "complex": lambda a: a.astype(complex) if a.dtype.kind in "fiub" else a[..., None],
}


@pytest.mark.parametrize("change", CHANGES)
def test_arrays_of_other_shapes(saved: dict[str, np.ndarray], tmp_path: Path, change: str) -> None:
    more = mg.simulate("wide", duration=3, rate=10, seed=4).recording
    refused = 0
    names = np.random.default_rng(len(change)).choice(sorted(saved), 6, replace=False).tolist()
    for name in names:
        array = saved[name]
        path = tmp_path / "changed.npz"
        np.savez(path, **(saved | {name: CHANGES[change](array)}))
        try:
            online = mg.OnlineCalibrator.load(path)
            online.update(more.time + 30, more.magnetic_field, more.angular_rate)
            online.progress  # noqa: B018
        except MagycError:
            refused += 1
    assert refused >= 3


def test_arrays_that_are_missing(saved: dict[str, np.ndarray], tmp_path: Path) -> None:
    for name in [*sorted(saved)[::4], "header"]:
        np.savez(tmp_path / "changed.npz", **{k: v for k, v in saved.items() if k != name})
        if name == "header":
            with pytest.raises(MagycError, match="not the state of an online calibration"):
                mg.OnlineCalibrator.load(tmp_path / "changed.npz")
            continue
        try:
            mg.OnlineCalibrator.load(tmp_path / "changed.npz").progress  # noqa: B018
        except MagycError as error:
            found = str(error)
        else:
            found = "loaded"
        assert found == "loaded" or "damaged" in found


def test_random_bytes(saved: dict[str, np.ndarray], tmp_path: Path) -> None:
    whole = io.BytesIO()
    np.savez(whole, **saved)  # type: ignore[arg-type]
    source = np.random.default_rng(2)
    for _ in range(30):
        data = bytearray(whole.getvalue())
        for place in source.integers(0, len(data), 20):
            data[place] = source.integers(256)
        (tmp_path / "changed.npz").write_bytes(data)
        with pytest.raises(MagycError):
            mg.OnlineCalibrator.load(tmp_path / "changed.npz")


def test_arrays_that_would_unpack(tmp_path: Path) -> None:
    path = tmp_path / "packed.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("header.npy", bytes(1 << 26))
    assert path.stat().st_size < 1 << 18
    with pytest.raises(MagycError, match="is compressed"):
        mg.OnlineCalibrator.load(path)
