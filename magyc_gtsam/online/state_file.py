"""Writing and reading of the state of an online calibration as one file of numbers and text."""

from __future__ import annotations

import json
import os
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.recording import Array
from magyc_gtsam.storage.files import expect_path, whole_file

_FORMAT = "magyc-gtsam online state 16"


def write(
    path: str | os.PathLike[str], method: str, options: Mapping[str, Any], state: Mapping[str, Array]
) -> None:
    """Write a state, replacing the file atomically.

    Raises:
        MagycError: the file cannot be written.
    """
    path = expect_path("save", path)
    header = json.dumps({"format": _FORMAT, "method": method, "options": dict(options)})
    arrays: dict[str, Any] = dict(state)
    with whole_file(path) as part, part.open("wb") as file:
        np.savez(file, header=np.array(header), **arrays)
        file.flush()
        os.fsync(file.fileno())


def read(path: str | os.PathLike[str]) -> tuple[str, dict[str, Any], dict[str, Array]]:
    """Return method, options and state bit for bit as written.

    Raises:
        MagycError: the file does not exist, is damaged, or is not a saved state of this version.
    """
    path = expect_path("OnlineCalibrator.load", path)
    try:
        _within_limits(path)
        with np.load(path, allow_pickle=False) as file:
            state = {name: file[name] for name in file.files}
        if odd := [name for name, array in state.items() if array.dtype.kind not in "biufU"]:
            raise ValueError(f"its array {odd[0]!r} is of {state[odd[0]].dtype}")
        header = json.loads(str(state.pop("header")))
        version = header["format"]
        if version != _FORMAT:
            raise MagycError(f"{path}: format {version!r}, this version reads {_FORMAT!r}")
        return header["method"], header["options"], state
    except FileNotFoundError:
        raise MagycError(f"{path}: no such file") from None
    except OSError as error:
        raise MagycError(f"{path}: cannot be read ({error})") from None
    except (
        ArithmeticError,
        AttributeError,
        EOFError,
        LookupError,
        MemoryError,
        NotImplementedError,
        RecursionError,
        RuntimeError,
        SyntaxError,
        TypeError,
        ValueError,
        struct.error,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        reason = shortened(error) or type(error).__name__
        raise MagycError(f"{path}: not the state of an online calibration ({reason})") from None


def _within_limits(path: Path) -> None:
    """Reject compressed arrays, which `write` never writes and which could expand to any size in memory."""
    with zipfile.ZipFile(path) as file:
        packed = [member.filename for member in file.infolist() if member.compress_type != zipfile.ZIP_STORED]
    if packed:
        raise ValueError(f"its array {packed[0]!r} is compressed, which a saved state's are not")


def compare(expected: Mapping[str, Array], found: Mapping[str, Array]) -> None:
    """Check that the arrays of a state have the kinds and shapes of a new one.

    Args:
        expected: the state of a new calibrator.
        found: the state that was read; lengths along the first axis may differ.

    Raises:
        ValueError: an array is missing, or has another kind or shape.
    """
    if missing := sorted(expected.keys() - found.keys()):
        raise ValueError(f"arrays are missing: {', '.join(missing[:5])}")
    for name, array in expected.items():
        want, got = np.asarray(array), np.asarray(found[name])
        if (
            want.dtype.kind != got.dtype.kind
            or want.ndim != got.ndim
            or (want.ndim > 1 and want.shape[1:] != got.shape[1:])
        ):
            raise ValueError(f"{name}: {got.dtype} {got.shape}, expected {want.dtype} {want.shape}")
