"""The diagnosing process, `python -P diagnosis.py FOLDER NUMBER…`, which sees recordings but never the truth.

It is run as a file, not as part of its package. Importing the simulator or the blind test fails, and so does opening
any file under `FOLDER/sealed`.
"""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

FORBIDDEN = ("magyc_gtsam.blindtest", "magyc_gtsam.simulation")


class ImportBlocker:
    """An import hook that rejects the packages which contain the answers."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return None for an allowed module, so that the ordinary finders continue."""
        if any(name == f or name.startswith(f + ".") for f in FORBIDDEN):
            raise ImportError(f"the diagnosing process must not import {name}")
        return None


def blindfold(sealed: Path) -> None:
    """Prevent any file under `sealed` from being opened and any of `FORBIDDEN` from being imported from now on."""
    loaded = [name for name in sys.modules if name.startswith(FORBIDDEN)]
    if loaded:
        raise ImportError(f"the diagnosing process has already imported {loaded[0]}")
    sys.meta_path.insert(0, ImportBlocker())
    hidden = os.path.realpath(sealed)

    def audit(event: str, arguments: tuple[Any, ...]) -> None:
        if event in ("open", "os.listdir", "os.scandir") and isinstance(arguments[0], str | bytes | os.PathLike):
            path = os.path.realpath(os.fsdecode(arguments[0]))
            if path == hidden or path.startswith(hidden + os.sep):
                raise PermissionError(f"the diagnosing process must not open {path}")

    sys.addaudithook(audit)


def load(path: Path) -> Any:
    """Read a `Recording` from an .npz file of the generator."""
    import numpy as np

    from magyc_gtsam.recording import Recording

    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    channels = {k.removeprefix("channel "): arrays.pop(k) for k in list(arrays) if k.startswith("channel ")}
    arrays["angular_rate_is"] = str(arrays["angular_rate_is"])
    return Recording(**arrays, channels=channels, name=path.stem)


def slim(result: dict[str, Any]) -> dict[str, Any]:
    """Remove the long curves, which the scorer does not need."""
    for metrics in (result["before"], result["after"]):
        metrics["maps"] = [{"over": m["over"], "worst": max(m["level"], default=0.0)} for m in metrics["maps"]]
        for curve in ("time", "error", "sigma"):
            metrics["open_loop"].pop(curve, None)
    return result


def diagnose(path: Path) -> dict[str, Any]:
    """Return the result of `find_gap` on one recording, or why it failed."""
    import magyc_gtsam as mg
    from magyc_gtsam.storage.json_types import json_types

    began, used = time.perf_counter(), time.process_time()
    answer: dict[str, Any]
    try:
        answer = slim(json_types(mg.find_gap(load(path))))
    except mg.MagycError as refusal:
        answer = {"verdict": "refused", "sentence": str(refusal), "effects": []}
    except Exception:  # noqa: BLE001 - a crash is an outcome, and the scorer counts it
        answer = {"verdict": "crashed", "sentence": traceback.format_exc(), "effects": []}
    answer["seconds"] = time.perf_counter() - began
    answer["cpu_seconds"] = time.process_time() - used
    return answer


def main(arguments: Sequence[str]) -> int:
    """Diagnose the given recordings, printing the number of each when done."""
    folder = Path(arguments[0])
    blindfold(folder / "sealed")
    from magyc_gtsam.storage.files import write_text

    for number in arguments[1:]:
        target = folder / "results" / f"{number}.json"
        if not target.exists():
            answer = diagnose(folder / "recordings" / f"{number}.npz")
            write_text(target, json.dumps(answer))
        print(number, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
