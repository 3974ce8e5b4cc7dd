"""Sealing of the truth: it is written and hashed before any diagnosis, and opened for the scorer only.

The folder of a blind test holds `recordings/<number>.npz` for the diagnosis, `sealed/<number>.json` with the truth,
and `manifest.json` with the sha256 of each. The scenarios are numbered in random order, so that a number reveals
nothing.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from magyc_gtsam.blindtest.from_outside import Function
from magyc_gtsam.blindtest.generator import generate, truth_of, write
from magyc_gtsam.blindtest.scenarios import Scenario, fingerprint
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Recording
from magyc_gtsam.storage.files import sha256, write_text

RECORDINGS, SEALED, RESULTS, MANIFEST = "recordings", "sealed", "results", "manifest.json"


def seal(
    folder: Path,
    scenario_list: Sequence[Scenario],
    real: Mapping[str, Recording] | None = None,
    progress: Callable[[float], None] = lambda _: None,
    outside: Mapping[str, Function] | None = None,
) -> dict[str, Any]:
    """Write recordings, truths and manifest, unless the folder already holds them.

    Args:
        folder: folder of the test.
        scenario_list: the scenarios.
        real: real recordings by the name that scenarios use.
        progress: called with the share done.
        outside: foreign effects by name; see `from_outside`.

    Returns:
        The manifest.

    Raises:
        MagycError: the folder holds another test.
    """
    print_of = fingerprint(scenario_list)
    target = folder / MANIFEST
    if target.exists():
        manifest: dict[str, Any] = json.loads(target.read_text(encoding="utf-8"))
        if manifest["scenarios"] != print_of:
            raise MagycError(
                f"{folder}: holds another blind test; choose a new folder, or the options of that test"
            )
        return manifest
    for part in (RECORDINGS, SEALED, RESULTS):
        (folder / part).mkdir(parents=True, exist_ok=True)
    order = np.random.default_rng(int(print_of[:12], 16)).permutation(len(scenario_list))
    entries = {}
    for done, index in enumerate(order.tolist()):
        scenario, number = scenario_list[index], f"{done:05d}"
        logged = (real or {}).get(scenario.motion) if scenario.set == "real" else None
        hidden = generate(scenario, logged, outside)
        recording_file, truth_file = folder / RECORDINGS / f"{number}.npz", folder / SEALED / f"{number}.json"
        write(recording_file, hidden.recording)
        truth_file.write_text(json.dumps(truth_of(scenario, hidden)), encoding="utf-8")
        entries[number] = {"recording": sha256(recording_file), "truth": sha256(truth_file)}
        progress((done + 1) / len(order))
    manifest = {"scenarios": print_of, "count": len(entries), "sha256": entries}
    write_text(target, json.dumps(manifest, indent=1))
    return manifest


def opened(folder: Path, number: str, manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return the truth of one recording.

    Raises:
        MagycError: truth or recording differ from the sealed ones.
    """
    files = {
        "truth": folder / SEALED / f"{number}.json",
        "recording": folder / RECORDINGS / f"{number}.npz",
    }
    for kind, file in files.items():
        if not file.exists() or sha256(file) != manifest["sha256"][number][kind]:
            raise MagycError(f"{file}: was changed after sealing; the test is void, run it again in a new folder")
    truth: dict[str, Any] = json.loads(files["truth"].read_text(encoding="utf-8"))
    return truth
