"""Feed a reader files that were damaged at random, and count what is neither read nor refused with a reason.

    python benchmarks/fuzz.py mcap 200000 [SEED]     # or another name of READERS

Prints the number of inputs, how many were read and refused, internal errors (with the first of each kind), the
slowest input in s and the largest memory in MB. Exit code 1 where there was an internal error, an input took longer
than 30 s, or the process grew beyond 1 GB.
"""

from __future__ import annotations

import collections
import os
import random
import resource
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import fuzz_files as files
import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.io import info, read
from magyc_gtsam.io.request import Request
from magyc_gtsam.live.line_sources import JsonLines
from magyc_gtsam.live.mcap_follow import McapFollower
from magyc_gtsam.live.source import LiveSource

LONGEST, LARGEST = 30.0, 1000.0  # s, MB
INTERESTING = [
    bytes(4),
    b"\xff" * 4,
    b"\xff" * 8,
    b"\x7f\xff\xff\xff",
    b"nan",
    b"1e308",
    b"-",
    b"\xa3\x95",
    b"\x06",
    b"*a",
]


def log(path: Path) -> None:
    read(path)


def exported(path: Path) -> None:
    loaded = mg.Calibration.load(path)
    loaded.apply(np.full((2, 3), 3e-5))
    loaded.export("ardupilot")


def followed(path: Path) -> None:
    """Take all samples of a log that is still written, as `magyc-gtsam online` does."""
    _taken(McapFollower(path, Request()))


def piped(path: Path) -> None:
    """Take all samples of lines of JSON, likewise."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        _taken(JsonLines(descriptor, Request()))
    finally:
        os.close(descriptor)


def _taken(source: LiveSource) -> None:
    online = mg.OnlineCalibrator()
    while True:
        batch = source.read(0.0)
        if not batch:
            break
        online.update(*batch.magnetometer)
        online.update(batch.gyroscope.time, angular_rate=batch.gyroscope.value)
    source.close()


Reader = tuple[Callable[[Path, mg.Recording], tuple[bytes, str]], Callable[[Path], object]]
READERS: dict[str, Reader] = {
    "mcap": (files.mcap, log),
    "mcap-plain": (files.mcap_plain, log),
    "bin": (files.dataflash, log),
    "ulog": (files.ulog, log),
    "csv": (files.csv, log),
    "bag": (files.ros_bag, log),
    "db3": (files.ros_database, log),
    "tlog": (files.telemetry, log),
    "phone": (files.phone, log),
    "blackbox": (files.blackbox, lambda path: read(path, magnetic_unit=4e-8)),
    "calibration": (files.calibration, exported),
    "state": (files.state, mg.OnlineCalibrator.load),
    "lines": (files.lines, piped),
    "follow": (files.mcap_plain, followed),
    "info": (files.mcap_plain, info),
}


def damaged(whole: bytes, source: random.Random) -> bytes:
    """Flip, overwrite, insert, delete, repeat, exchange or cut, one to eight times."""
    data = bytearray(whole)
    for _ in range(1 << source.randrange(4)):
        place, size = source.randrange(max(len(data), 1)), 1 << source.randrange(9)
        kind = source.randrange(8)
        if kind == 0 and data:
            data[place] ^= 1 << source.randrange(8)
        elif kind == 1 and data:
            data[place] = source.randrange(256)
        elif kind == 2:
            data[place : place + size] = source.choice(INTERESTING)
        elif kind == 3:
            data[place:place] = source.randbytes(size)
        elif kind == 4:
            del data[place : place + size]
        elif kind == 5:
            data[place:place] = data[place : place + size]
        elif kind == 6:
            other = source.randrange(max(len(data), 1))
            data[place : place + size] = data[other : other + size]
        elif source.random() < 0.2:
            del data[place:]
    return bytes(data)


def main(name: str, count: int, seed: int = 0) -> int:
    """The exit code; Ctrl-C ends early, with the figures so far."""
    warnings.simplefilter("ignore")
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell has its background jobs ignore it
    make, use = READERS[name]
    source = random.Random(seed)
    outcome: collections.Counter[str] = collections.Counter()
    internal: dict[str, str] = {}
    slowest, began = 0.0, time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        whole, suffix = make(Path(folder), files.recording())
        use(_written(Path(folder) / f"whole{suffix}", whole))
        try:
            for k in range(count):
                path = _written(Path(folder) / f"damaged{suffix}", damaged(whole, source))
                began = time.perf_counter()
                try:
                    use(path)
                    outcome["read"] += 1
                except mg.MagycError:
                    outcome["refused"] += 1
                except Exception as error:  # noqa: BLE001  # what is looked for
                    outcome["internal"] += 1
                    internal.setdefault(f"{type(error).__name__}: {str(error)[:80]}", f"input {k} of seed {seed}")
                slowest = max(slowest, time.perf_counter() - began)
        except KeyboardInterrupt:  # what was done so far counts, and an input that does not end
            count, slowest = outcome.total(), max(slowest, time.perf_counter() - began)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(
        f"{name}: {count} inputs of {len(whole)} bytes, {outcome['read']} read, {outcome['refused']} refused, "
        f"{outcome['internal']} internal errors; slowest {slowest:.2f} s, {memory:.0f} MB"
    )
    for kind, where in internal.items():
        print(f"  {kind} ({where})")
    return int(bool(internal) or slowest > LONGEST or memory > LARGEST)


def _written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2]), *map(int, sys.argv[3:])))
