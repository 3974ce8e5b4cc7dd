"""Reads files of some MB that ask for far more than they are, and says what each took.

    python benchmarks/bombs.py

One line for each file: its size, s of processor time, the largest memory in MB, and how it ended. Each is read in a
process of its own. The exit code is 1 where one took more than 30 s or 1 GB, or ended as an internal error.
"""

from __future__ import annotations

import os
import resource
import struct
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import zstandard

import magyc_gtsam as mg
from magyc_gtsam.io import read, write_mcap

LONGEST, LARGEST = 30.0, 1000.0  # s, MB
STAMP = 10**18  # ns


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def chunk(records: bytes) -> bytes:
    packed = zstandard.compress(records)
    head = struct.pack("<QQQII", 0, 0, len(records), 0, 4) + b"zstd" + struct.pack("<Q", len(packed))
    return record(6, head + packed)


def topic(number: int, definition: str, encoding: str = "cdr", schema: str = "ros2msg") -> bytes:
    kind = struct.pack("<H", number) + text("a/msg/A") + text(schema) + text(definition)
    return record(3, kind) + record(4, struct.pack("<HH", number, number) + text("/a") + text(encoding) + bytes(4))


def messages(count: int, size: int, channels: int = 1) -> bytes:
    """Of `size` bytes each, all zero but for the first four, which are those of CDR."""
    layout = [("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("at", "<u8", 2)]
    rows = np.zeros(count, dtype=[*layout, ("data", "u1", size)] if size else layout)
    rows["op"], rows["length"], rows["channel"] = 5, 22 + size, 50 + np.arange(count) % channels
    rows["at"] = STAMP + 1000 * np.arange(count)[:, None]
    if size:
        rows["data"][:, 1] = 1
    return rows.tobytes()


def texts(count: int) -> Iterator[bytes]:
    """Messages of two texts, each of another pair of lengths."""
    for k in range(count):
        first, second = k % 500, k // 500 % 500
        content = struct.pack("<I", first) + bytes(first)
        content += bytes(-len(content) % 4) + struct.pack("<I", second) + bytes(second)
        content = b"\0\1\0\0" + content + bytes(-len(content) % 8) + bytes(8)
        yield record(5, struct.pack("<HIQQ", 50, 0, STAMP + 1000 * k, 0) + content)


def nested(array: str) -> str:
    """Types without fields within each other."""
    parts = [f"===\nMSG: a/T{k}\n" + "\n".join(f"a/T{k + 1}{array} x{j}" for j in range(100)) for k in range(1, 8)]
    return "\n".join(["a/T1 x", *parts, "===\nMSG: a/T8", ""])


MCAP: dict[str, Callable[[], bytes]] = {
    "2 million messages of 60,000 channels": lambda: chunk(messages(2_000_000, 0, 60_000)),
    "8 million messages without a channel": lambda: chunk(messages(8_000_000, 0)),
    "800 MB of messages without a channel": lambda: chunk(messages(100_000, 2000)) * 4,
    "800 MB of truths, which become numbers": lambda: (
        topic(50, "\n".join(f"bool f{k}" for k in range(2000))) + chunk(messages(100_000, 2004)) * 4
    ),
    "75 million records of nine zero bytes": lambda: chunk(bytes(9) * 25_000_000) * 3,
    "100,000 layouts of messages": lambda: (
        topic(50, "string a\nstring b\nfloat64 x") + chunk(b"".join(texts(100_000)))
    ),
    "types without fields, 7 deep": lambda: topic(50, nested(""), "ros1", "ros1msg") + messages(1, 2000),
    "and as lists": lambda: topic(50, nested("[1000000]"), "ros1", "ros1msg") + messages(1, 2000),
    "100,000 damaged chunks": lambda: record(6, b"x" * 50) * 100_000,
}
OTHERS: dict[str, Callable[[], tuple[str, bytes]]] = {
    "a column's name of 100,000 brackets": lambda: (
        "a.csv",
        b"t,mx,my,mz," + b"(" * 100_000 + b"\n1,1,1,1,1\n" * 9,
    ),
    "250,000 columns": lambda: ("a.csv", b"t," * 250_000 + b"x\n" + (b"1," * 250_000 + b"1\n") * 3),
    "YAML of 60,000 names": lambda: ("a.yaml", b"".join(b"k%d: 1\n" % k for k in range(60_000))),
    "YAML of a list of 10 MB": lambda: ("a.yaml", b"a: [" + b"1," * 5_000_000 + b"]\n"),
}


def archive(folder: Path) -> Path:
    path = folder / "a.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("Magnetometer.csv", "time,x,y,z\n" + "1,1,1,1\n" * 30_000_000 + os.urandom(1_500_000).hex())
    return path


def tried(name: str, path: Path) -> bool:
    """Read in a process of its own; whether that was within limits."""
    sys.stdout.flush()
    if (process := os.fork()) == 0:
        ended, began = "read", time.process_time()
        try:
            (mg.Calibration.load if path.suffix == ".yaml" else read)(path)
        except mg.MagycError:
            ended = "refused"
        except BaseException as error:  # noqa: BLE001  # what is looked for
            ended = f"internal error {type(error).__name__}"
        took, memory = time.process_time() - began, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        print(f"| {name} | {path.stat().st_size / 1e6:.1f} | {took:.1f} | {memory:.0f} | {ended} |", flush=True)
        os._exit(int(took > LONGEST or memory > LARGEST or ended.startswith("internal")))
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 0


def main() -> int:
    """The exit code."""
    print("| file | MB | s | MB at the peak | |\n|---|---|---|---|---|")
    good = True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = np.random.default_rng(0)
        field, rate = source.normal(0, 3e-5, (200, 3)), source.normal(0, 1, (200, 3))
        write_mcap(
            folder / "good.mcap", mg.Recording(np.arange(200) / 20, field, rate), epoch=STAMP, compression=None
        )
        whole = (folder / "good.mcap").read_bytes()
        padding = record(9, bytes(24) + os.urandom(9_000_000))  # what is granted depends on the size of the file
        for what, make in MCAP.items():
            path = folder / "a.mcap"
            path.write_bytes(whole[:8] + padding + make() + whole[8:])
            good &= tried(what, path)
        for what, other in OTHERS.items():
            file, data = other()
            (folder / file).write_bytes(data)
            del data
            good &= tried(what, folder / file)
        good &= tried("240 MB of text in an archive", archive(folder))
    return int(not good)


if __name__ == "__main__":
    sys.exit(main())
