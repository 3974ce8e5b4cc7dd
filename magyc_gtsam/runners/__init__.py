"""Runners: optimise any graph, all at once or as it grows. Names are imported at first use; all but `Status` need
GTSAM."""

from __future__ import annotations

from typing import Any

from magyc_gtsam.factors.lazy import attribute
from magyc_gtsam.runners.status import Status

_PUBLIC = {
    "BatchResult": "batch",
    "Incremental": "incremental",
    "IncrementalResult": "incremental",
    "optimize": "batch",
}

__all__ = ["Status", *_PUBLIC]


def __getattr__(name: str) -> Any:
    return attribute(__name__, _PUBLIC, name)


def __dir__() -> list[str]:
    return sorted(__all__)
