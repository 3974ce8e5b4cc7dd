"""The state of an online calibration in one file: numbers and text only, replaced in one step."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array

_FORMAT = "magyc-gtsam online state 6"


def write(
    path: str | os.PathLike[str], method: str, options: Mapping[str, Any], state: Mapping[str, Array]
) -> None:
    """Write to a file beside `path`, then put it in its place.

    Raises:
        MagycError: the options are no JSON types, or the file cannot be written.
    """
    path = Path(path)
    header = json.dumps({"format": _FORMAT, "method": method, "options": dict(options)})
    part = path.with_name(path.name + ".part")
    arrays: dict[str, Any] = dict(state)
    try:
        with part.open("wb") as file:
            np.savez(file, header=np.array(header), **arrays)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:
        with suppress(OSError):
            part.unlink()
        raise MagycError(f"{path}: cannot be written ({error.strerror})") from None


def read(path: str | os.PathLike[str]) -> tuple[str, dict[str, Any], dict[str, Array]]:
    """Method, options and state, bit for bit as written.

    Raises:
        MagycError: no such file, not a saved state, damaged, or of another version.
    """
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as file:
            state = {name: file[name] for name in file.files}
        header = json.loads(str(state.pop("header")))
        version = header["format"]
        if version != _FORMAT:
            raise MagycError(f"{path}: format {version!r}, this version reads {_FORMAT!r}")
        return header["method"], header["options"], state
    except FileNotFoundError:
        raise MagycError(f"{path}: no such file") from None
    except OSError as error:
        raise MagycError(f"{path}: cannot be read ({error})") from None
    except (ValueError, KeyError, TypeError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        raise MagycError(f"{path}: not the state of an online calibration ({error})") from None
