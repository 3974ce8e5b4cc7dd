"""What a person waits for: processor time from the file to the page, by stage, for files of each format and size.

    python benchmarks/end_to_end.py [MINUTES ...]        # of 100 Hz data; default 2 10

For each file, s of processor time: `cat FILE > /dev/null`, reading, calibrating, and the page; and the times of reading
over those of `cat`, in MB/s, and over message by message with mcap-ros2-support (MCAP) or pymavlink (BIN). Peak is what
the process grew by while it read, over the arrays that it kept. The last column is PyPI `magyc`'s `magyc_bfg` over
`calibrate` on the same arrays, where that package is installed.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import fuzz_files
import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.io import write_mcap

RATE = 100.0  # Hz


def csv(path: Path, recording: mg.Recording) -> None:
    columns = [recording.time, *(recording.magnetic_field * 1e6).T, *recording.angular_rate.T]
    header = "time_s,mag_x_uT,mag_y_uT,mag_z_uT,gyro_x,gyro_y,gyro_z"
    np.savetxt(path, np.column_stack(columns), fmt="%.7f", delimiter=",", header=header, comments="")


def dataflash(path: Path, recording: mg.Recording) -> None:
    path.write_bytes(fuzz_files.dataflash(path.parent, recording)[0])


def mcap(path: Path, recording: mg.Recording) -> None:
    write_mcap(path, recording, epoch=10**18)


def by_message_mcap(path: Path) -> None:
    """What a user would write with mcap-ros2-support."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    rows: dict[str, list[tuple[float, ...]]] = {"/imu/mag": [], "/imu/data_raw": []}
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, m in reader.iter_decoded_messages(topics=list(rows)):
            v = m.magnetic_field if channel.topic == "/imu/mag" else m.angular_velocity
            stamp = m.header.stamp.sec + m.header.stamp.nanosec * 1e-9
            rows[channel.topic].append((stamp, v.x, v.y, v.z))
    for values in rows.values():
        np.array(values)


def by_message_dataflash(path: Path) -> None:
    """What a user would write with pymavlink."""
    from pymavlink.DFReader import DFReader_binary

    log = DFReader_binary(str(path), zero_time_base=True)
    rows: dict[str, list[tuple[float, ...]]] = {"MAG": [], "IMU": []}
    while (m := log.recv_match(type=["MAG", "IMU"], strict=True)) is not None:
        kind = m.get_type()
        rows[kind].append(
            (m.TimeUS, m.MagX, m.MagY, m.MagZ) if kind == "MAG" else (m.TimeUS, m.GyrX, m.GyrY, m.GyrZ)
        )
    for values in rows.values():
        np.array(values)


FORMATS: dict[str, tuple[Callable[[Path, mg.Recording], None], Callable[[Path], None] | None]] = {
    "mcap": (mcap, by_message_mcap),
    "bin": (dataflash, by_message_dataflash),
    "csv": (csv, None),
}


def cost(function: Callable[[], object], times: int = 3) -> float:
    """s of processor time, the least of several."""
    best = np.inf
    for _ in range(times):
        began = time.process_time()
        function()
        best = min(best, time.process_time() - began)
    return float(best)


def cat(path: Path) -> float:
    """s of processor time of `cat`, the process's own start taken out."""

    def run(file: str) -> float:
        script = f"import resource, subprocess; subprocess.run(['cat', {file!r}], stdout=subprocess.DEVNULL); "
        script += "u = resource.getrusage(resource.RUSAGE_CHILDREN); print(u.ru_utime + u.ru_stime)"
        return float(subprocess.run([sys.executable, "-c", script], capture_output=True, text=True).stdout)

    return max(min(run(str(path)) for _ in range(3)) - min(run("/dev/null") for _ in range(3)), 1e-4)


def kept(recording: mg.Recording) -> int:
    """Bytes of its arrays."""
    arrays = (recording.time, recording.magnetic_field, recording.angular_rate, recording.acceleration)
    return sum(a.nbytes for a in arrays if a is not None) + 3 * len(recording.time)


def measured(name: str, length: float, folder: Path) -> str:
    """One row of the table."""
    from magyc_gtsam.cli.results import write_page
    from magyc_gtsam.report.verdict import judged

    write, peer = FORMATS[name]
    path = folder / f"log.{name}"
    simulated = mg.simulate("wide", duration=60 * length, rate=RATE, seed=0).recording
    write(path, replace(simulated, attitude=None))  # a log has magnetometer and gyroscope
    size = path.stat().st_size / 1e6
    recording = mg.read(path)
    read = cost(lambda: mg.read(path))
    tracemalloc.start()
    mg.read(path)
    peak = tracemalloc.get_traced_memory()[1] / kept(recording)
    tracemalloc.stop()
    calibration = mg.calibrate(recording)
    fit = cost(lambda: mg.calibrate(recording))
    page = cost(lambda: write_page(folder, recording, calibration, judged(calibration)), 1)
    ratio = f"{cost(lambda: peer(path), 1) / read:.0f}" if peer else "–"
    idle = cat(path)
    return (
        f"| {name}, {length:g} min | {size:.1f} | {idle:.4f} | {read:.3f} | {size / read:.0f} | {read / idle:.0f} | "
        f"{ratio} | {peak:.2f} | {fit:.3f} | {page:.2f} | {bfg(recording, fit)} |"
    )


def main(minutes: list[float]) -> None:
    """Print the table."""
    print(
        "| file | MB | cat | read | MB/s | read/cat | by message/read | peak/kept | calibrate | page | bfg/calibrate |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for name in FORMATS:
        for length in minutes:
            with tempfile.TemporaryDirectory() as folder:
                print(measured(name, length, Path(folder)), flush=True)


def bfg(recording: mg.Recording, own: float) -> str:
    """PyPI magyc's batch factor graph over `calibrate`, at 10 Hz as its authors run it."""
    try:
        from magyc import magyc_bfg
    except ImportError:
        return "–"
    rows = slice(None, None, 10)
    took = cost(
        lambda: magyc_bfg(
            recording.magnetic_field[rows] * 1e7, recording.angular_rate[rows], recording.time[rows]
        ),
        1,
    )
    return f"{took / own:.0f}"


if __name__ == "__main__":
    main([float(m) for m in sys.argv[1:]] or [2.0, 10.0])
