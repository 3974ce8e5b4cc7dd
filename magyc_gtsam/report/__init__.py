"""The report of a calibration as one self-contained HTML page."""

from __future__ import annotations

import importlib
from typing import Any

__all__ = ["write_report"]


def __getattr__(name: str) -> Any:  # imported at first use, because a verdict alone needs no page
    if name != "write_report":
        raise AttributeError(f"module 'magyc_gtsam.report' has no attribute {name!r}")
    return importlib.import_module("magyc_gtsam.report.page").write_report
