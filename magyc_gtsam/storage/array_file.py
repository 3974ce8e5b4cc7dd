"""Files of named arrays with a header: written atomically, and read without trusting what they hold."""

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
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.storage.files import expect_path, whole_file

Arrays = Mapping[str, NDArray[Any]]


def write_arrays(path: str | os.PathLike[str], header: Mapping[str, Any], arrays: Arrays) -> None:
    """Write or replace a file in one step.

    Args:
        path: the file.
        header: JSON types, with the "format" of the file.
        arrays: numbers, flags or text.

    Raises:
        MagycError: the file cannot be written.
    """
    named: dict[str, Any] = {"header": np.array(json.dumps(header)), **arrays}
    with whole_file(expect_path("save", path)) as part, part.open("wb") as file:
        np.savez(file, **named)
        file.flush()
        os.fsync(file.fileno())


def read_arrays(
    path: str | os.PathLike[str], version: str, what: str, function: str
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return header and arrays bit for bit as written.

    Args:
        path: the file.
        version: the format that is expected.
        what, function: what the file should be, and who reads it, for messages.

    Raises:
        MagycError: the file does not exist, is damaged, or has another format.
    """
    path = expect_path(function, path)
    try:
        _within_limits(path)
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        if odd := [name for name, array in arrays.items() if array.dtype.kind not in "biufU"]:
            raise ValueError(f"its array {odd[0]!r} is of {arrays[odd[0]].dtype}")
        header: dict[str, Any] = json.loads(str(arrays.pop("header")))
        if header["format"] != version:
            raise MagycError(f"{path}: format {header['format']!r}, this version reads {version!r}")
        return header, arrays
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
        raise MagycError(f"{path}: not {what} ({reason})") from None


def _within_limits(path: Path) -> None:
    """Reject compressed arrays, which are never written and could expand to any size in memory."""
    with zipfile.ZipFile(path) as file:
        packed = [member.filename for member in file.infolist() if member.compress_type != zipfile.ZIP_STORED]
    if packed:
        raise ValueError(f"its array {packed[0]!r} is compressed, which those written are not")


def expect_layout(expected: Arrays, found: Arrays) -> None:
    """Check that arrays have the kinds and shapes that are expected; lengths along the first axis may differ.

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
