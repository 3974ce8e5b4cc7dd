"""The logs of a study: LOG or LOG@START:END, in any format or as arrays of the public collections."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from magyc_gtsam.cli.terminal import stages

if TYPE_CHECKING:
    from magyc_gtsam.recording import Recording

_PART = re.compile(r"(.+)@(\d+(?:\.\d+)?):(\d+(?:\.\d+)?)")


def recordings_of(logs: Sequence[str]) -> dict[str, Recording]:
    """Read logs, and return {stem of the file and @START:END: recording}."""
    from magyc_gtsam.io import read
    from magyc_gtsam.study.leaderboard.reading import ARRAYS, read_public

    result = {}
    with stages() as stage:
        for log in logs:
            path, start, end = log, None, None
            if part := _PART.fullmatch(log):
                path, start, end = part[1], float(part[2]), float(part[3])
            name = Path(path).stem + log[len(path) :]
            if Path(path).suffix in ARRAYS:
                recording, _ = read_public(Path(path), read)
                result[name] = recording if start is None or end is None else recording.between(start, end)
            else:
                result[name] = read(path, start=start, end=end, progress=stage(f"reading {name}"))
    return result
