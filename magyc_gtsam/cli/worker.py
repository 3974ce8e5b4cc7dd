"""The process of a server job: it imports the modules of commands, reads one line with arguments, and runs the command.

The imports take some tenths of a second and are done before a user starts a job.
"""

from __future__ import annotations

import importlib
import json
import os
import sys

_NEEDED = (
    "magyc_gtsam.cli.app",
    "magyc_gtsam.cli.calibrate",
    "magyc_gtsam.cli.info",
    "magyc_gtsam.io.mcap_log",
    "magyc_gtsam.estimators.smoother.smoother",
    "magyc_gtsam.estimators.smoother.residuals",
    "magyc_gtsam.report.page",
    "magyc_gtsam.report.analysis",
    "magyc_gtsam.export",
)


def run_when_told() -> int:
    """Run the command that comes on standard input, and return its exit code; 0 if the input ends before."""
    for name in _NEEDED:
        importlib.import_module(name)
    line = sys.stdin.readline()
    if not line:
        return 0
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, sys.stdin.fileno())
    os.close(nothing)
    from magyc_gtsam.cli import main

    return main(json.loads(line))


if __name__ == "__main__":
    sys.exit(run_when_told())
