"""Feed a reader files that were damaged at random, and count what is neither read nor refused with a reason.

    python benchmarks/fuzz.py mcap 200000 [SEED]     # mcap, mcap-plain, bin, ulog, csv, calibration, state

Prints the number of inputs, how many were read and refused, internal errors (with the first of each kind), the
slowest input in s and the largest memory in MB. Exit code 1 where there was an internal error, an input took longer
than 30 s, or the process grew beyond 1 GB.
"""

from __future__ import annotations

import collections
import random
import resource
import signal
import struct
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.io import info, read, write_mcap

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


def recording(n: int = 40) -> mg.Recording:
    source = np.random.default_rng(0)
    field, rate = source.normal(0, 3e-5, (n, 3)), source.normal(0, 1, (n, 3))
    return mg.Recording(np.arange(n) / 20, field, rate, acceleration=rate, channels={"current": rate[:, 0]})


def mcap(folder: Path) -> tuple[bytes, str]:
    write_mcap(folder / "a.mcap", recording(), epoch=10**18)
    return (folder / "a.mcap").read_bytes(), ".mcap"


def mcap_plain(folder: Path) -> tuple[bytes, str]:
    write_mcap(folder / "a.mcap", recording(), epoch=10**18, compression=None)
    return (folder / "a.mcap").read_bytes(), ".mcap"


def dataflash(folder: Path) -> tuple[bytes, str]:
    formats = {
        "FMT": (128, "BBnNZ", "<BB4s16s64s", "Type,Length,Name,Format,Columns"),
        "PARM": (64, "QNf", "<Q16sf", "TimeUS,Name,Value"),
        "MAG": (65, "QBhhhhhhhhhB", "<QBhhhhhhhhhB", "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health"),
        "IMU": (66, "QBffffff", "<QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    }

    def add(name: str, *values: object) -> bytes:
        number, _, layout, _ = formats[name]
        given = (v.encode() if isinstance(v, str) else v for v in values)
        return bytes([0xA3, 0x95, number]) + struct.pack(layout, *given)

    data = b"".join(add("FMT", n, 3 + struct.calcsize(s), k, c, names) for k, (n, c, s, names) in formats.items())
    data += add("PARM", 0, "COMPASS_OFS_X", 10.0)
    made = recording()
    for k, m in enumerate((made.magnetic_field * 1e7).round().astype(int).tolist()):
        data += add("MAG", 50_000 * k, 0, *m, 10, 0, 0, 0, 0, 0, 1)
        data += add("IMU", 50_000 * k, 0, *made.angular_rate[k], 0.0, 0.0, -9.8)
    return data, ".bin"


def ulog(folder: Path) -> tuple[bytes, str]:
    """Only what PX4's own format needs: definitions, one subscription a message, data."""

    def message(kind: str, content: bytes) -> bytes:
        return struct.pack("<HB", len(content), ord(kind)) + content

    data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message("B", bytes(40))
    combined = b"sensor_combined:uint64_t timestamp;float[3] gyro_rad;float[3] magnetometer_ga;"
    data += message("F", combined)
    for name, value in (("CAL_MAG0_ID", 5), ("CAL_MAG0_XOFF", 1)):
        key = f"int32_t {name}".encode()
        data += message("P", bytes([len(key)]) + key + struct.pack("<i", value))
    data += message("A", struct.pack("<BH", 0, 3) + b"sensor_combined")
    made = recording()
    for k in range(len(made.time)):
        row = struct.pack("<Q6f", 50_000 * (k + 1), *made.angular_rate[k], *made.magnetic_field[k] * 1e4)
        data += message("D", struct.pack("<H", 3) + row)
    return data, ".ulg"


def csv(folder: Path) -> tuple[bytes, str]:
    made = recording()
    rows = [
        ",".join(f"{x:.9g}" for x in (t, *m, *w))
        for t, m, w in zip(made.time, made.magnetic_field, made.angular_rate, strict=True)
    ]
    return ("t,mx,my,mz,gx,gy,gz\n" + "\n".join(rows) + "\n").encode(), ".csv"


def calibration(folder: Path) -> tuple[bytes, str]:
    deviations = np.diag(np.arange(1.0, 13.0) * 1e-14)
    cal = mg.Calibration(np.eye(3) + 0.01, [1e-5, 2e-5, 3e-5], [1e-3, 0, 0], deviations, method="smoother")
    cal.save(folder / "a.yaml")
    return (folder / "a.yaml").read_bytes(), ".yaml"


def state(folder: Path) -> tuple[bytes, str]:
    online = mg.OnlineCalibrator()
    made = recording()
    online.update(made.time, made.magnetic_field, made.angular_rate)
    online.save(folder / "a.npz")
    return (folder / "a.npz").read_bytes(), ".npz"


def log(path: Path) -> None:
    read(path)


def exported(path: Path) -> None:
    loaded = mg.Calibration.load(path)
    loaded.apply(np.full((2, 3), 3e-5))
    loaded.export("ardupilot")


Reader = tuple[Callable[[Path], tuple[bytes, str]], Callable[[Path], object]]
READERS: dict[str, Reader] = {
    "mcap": (mcap, log),
    "mcap-plain": (mcap_plain, log),
    "bin": (dataflash, log),
    "ulog": (ulog, log),
    "csv": (csv, log),
    "calibration": (calibration, exported),
    "state": (state, mg.OnlineCalibrator.load),
    "info": (mcap_plain, info),
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
    slowest = 0.0
    with tempfile.TemporaryDirectory() as folder:
        whole, suffix = make(Path(folder))
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
        except KeyboardInterrupt:  # what was done so far counts
            count = outcome.total()
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
