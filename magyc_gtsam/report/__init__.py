"""The report: one self-contained HTML page per calibration, made to be looked at rather than read."""

from __future__ import annotations

from magyc_gtsam.report.page import write_report

__all__ = ["write_report"]
