"""The report: one self-contained HTML page per calibration, made to be looked at rather than read."""

from __future__ import annotations

import importlib
from typing import Any

__all__ = ["write_report"]


def __getattr__(name: str) -> Any:  # so that a verdict waits for no page
    if name != "write_report":
        raise AttributeError(f"module 'magyc_gtsam.report' has no attribute {name!r}")
    return importlib.import_module("magyc_gtsam.report.page").write_report
