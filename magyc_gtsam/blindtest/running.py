"""Run of a blind test: seal the scenarios, then diagnose in processes that see the recordings only."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from magyc_gtsam.blindtest.from_outside import Function
from magyc_gtsam.blindtest.scenarios import Scenario
from magyc_gtsam.blindtest.sealing import RESULTS, seal
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Recording

Progress = Callable[[float], None]


def run(
    folder: Path,
    scenario_list: Sequence[Scenario],
    real: Mapping[str, Recording] | None = None,
    workers: int = 2,
    sealing: Progress = lambda _: None,
    diagnosing: Progress = lambda _: None,
    outside: Mapping[str, Function] | None = None,
) -> dict[str, Any]:
    """Seal the scenarios and diagnose the recordings that are not done yet; return the manifest.

    An interrupted run continues where it stopped. For the arguments see `seal`.

    Raises:
        MagycError: a diagnosing process failed; the message holds its last line.
    """
    manifest = seal(folder, scenario_list, real, sealing, outside)
    numbers = list(manifest["sha256"])
    pending = [n for n in numbers if not (folder / RESULTS / f"{n}.json").exists()]
    processes = [_start(folder, i, pending[i::workers]) for i in range(workers) if pending[i::workers]]
    try:
        while any(process.poll() is None for process in processes):
            time.sleep(0.5)
            diagnosing(_done(folder, numbers))
    finally:
        for process in processes:
            if process.poll() is None:
                process.terminate()
                process.wait()
    for worker, process in enumerate(processes):
        if process.returncode:
            words = _log(folder, worker).read_text(encoding="utf-8").strip().splitlines()
            raise MagycError(f"a diagnosing process failed: {words[-1] if words else process.returncode}")
    return manifest


def _log(folder: Path, worker: int) -> Path:
    return folder / f"diagnosis-{worker}.log"


def _done(folder: Path, numbers: Sequence[str]) -> float:
    return sum((folder / RESULTS / f"{n}.json").exists() for n in numbers) / max(len(numbers), 1)


def _start(folder: Path, worker: int, numbers: Sequence[str]) -> subprocess.Popen[bytes]:
    """Start a diagnosing process; `-P` keeps the script's folder, which holds the generator, off the path."""
    script = Path(__file__).with_name("diagnosis.py")
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with open(_log(folder, worker), "wb") as log:
        return subprocess.Popen(
            [sys.executable, "-P", str(script), str(folder), *numbers],
            stdout=subprocess.DEVNULL,
            stderr=log,
            env=os.environ | threads,
        )
