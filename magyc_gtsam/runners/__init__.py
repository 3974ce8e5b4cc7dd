"""Runners that optimise any GTSAM graph in batch or incrementally; names are imported at first use."""

from __future__ import annotations

from typing import Any

from magyc_gtsam.factors.lazy import attribute
from magyc_gtsam.runners.status import Status

_PUBLIC = {
    "BatchResult": "batch",
    "Incremental": "incremental",
    "IncrementalResult": "convergence",
    "optimize": "batch",
}

__all__ = ["Status", *_PUBLIC]


def __getattr__(name: str) -> Any:
    return attribute(__name__, _PUBLIC, name)


def __dir__() -> list[str]:
    return sorted(__all__)
