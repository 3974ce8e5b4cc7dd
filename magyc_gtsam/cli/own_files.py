"""The files that commands write into a folder of results, and their removal before another run writes there."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

EXPORTS = {
    "px4": "px4.params",
    "ardupilot": "ardupilot.param",
    "vectornav": "vectornav.txt",
    "ros": "ros.yaml",
}
_TABLES = ("gap.json", "comparison.csv", "comparison.json", "calibrations.csv", "calibrations.parquet")
# Names that others may use as well: a file of these commands names the program.
_MARKED = (
    *("calibration.yaml", "next.yaml", "history.yaml", "configuration.yaml"),
    *("report.html", "report.pdf", "index.html"),
)
_EACH = "calibrations"  # folder of one calibration for each log
_MARK = re.compile(rb"magyc[-_]gtsam")


def remove_results(folder: Path) -> None:
    """Remove the files that commands wrote into a folder, so that none stays beside those of another run.

    The folders that `calibrate` makes for each of many logs are folders of results of their own, and stay.
    """
    for name in EXPORTS.values():
        (folder / name).unlink(missing_ok=True)
    files = (*(folder / name for name in _MARKED), *(folder / _EACH).glob("*.yaml"))
    own = [file for file in files if file.is_file() and _MARK.search(file.read_bytes())]
    # A table has no mark: it is one of these commands beside a file that has one.
    for file in (*own, *(folder / name for name in _TABLES if own)):
        file.unlink(missing_ok=True)
    with suppress(OSError):  # there is none, or it has other files
        (folder / _EACH).rmdir()
