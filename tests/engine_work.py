"""Units of work for tests of the engine; in a module of their own, so that other processes find them."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np


def spectrum(unit: tuple[int, int]) -> dict[str, Any]:
    """Numbers whose last bits depend on the order of sums."""
    seed, size = unit
    matrix = np.random.default_rng(seed).normal(size=(size, size))
    return {"seed": seed, "values": np.linalg.eigvalsh(matrix @ matrix.T).tolist()}


def kill_once(unit: tuple[int, str]) -> dict[str, Any]:
    """Kills its own process the first time that it sees the file's unit."""
    seed, marker = unit
    if seed == 3 and not Path(marker).exists():
        Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.02)
    return spectrum((seed, 30))


def kill_always(unit: int) -> dict[str, Any]:
    """Kills its own process at unit 1."""
    if unit == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return {"unit": unit}


def last(unit: tuple[int, str]) -> dict[str, Any]:
    """Unit 1 takes long, and leaves a file when it has ended."""
    number, marker = unit
    if number == 1:
        time.sleep(20)
        Path(marker).touch()
    return {"unit": number}
