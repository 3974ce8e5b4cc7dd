"""Ten hours at 100 Hz: processor time and peak memory of `calibrate` and `online`, each a process of its own.

    python benchmarks/long_log.py [HOURS ...]        # default 1 10; HOURS of 100 Hz data

One row for each length and format. `kept` is what the recording's own arrays take; peak is `ru_maxrss` of the process,
imports included (some 100 MB). `online` follows an MCAP file from its first byte to its last.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.io import write_mcap

RATE = 100.0  # Hz


def csv(path: Path, recording: mg.Recording) -> None:
    columns = np.column_stack([recording.time, recording.magnetic_field * 1e6, recording.angular_rate])
    with path.open("w") as file:
        file.write("time_s,mag_x_uT,mag_y_uT,mag_z_uT,gyro_x,gyro_y,gyro_z\n")
        for rows in np.array_split(columns, max(len(columns) // 100_000, 1)):
            np.savetxt(file, rows, fmt="%.7f", delimiter=",")


def measured(words: list[str]) -> tuple[float, float, float, int]:
    """s of processor time, s on the clock, MB at the peak, and the exit code of a command."""
    began = time.monotonic()
    if (process := os.fork()) == 0:
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        script = "import sys; from magyc_gtsam.cli import main; sys.exit(main())"
        os.execv(sys.executable, [sys.executable, "-c", script, *words])
    _, status, used = os.wait4(process, 0)
    clock = time.monotonic() - began
    return used.ru_utime + used.ru_stime, clock, used.ru_maxrss / 1e3, os.waitstatus_to_exitcode(status)


def logs(folder: Path, hours: float) -> float:
    """Writes log.mcap and log.csv in a process of its own, whose memory is not inherited; MB of the arrays."""
    rows = int(hours * 3600 * RATE)
    if (process := os.fork()) == 0:
        recording = replace(mg.simulate("wide", duration=3600 * hours, rate=RATE, seed=0).recording, attitude=None)
        csv(folder / "log.csv", recording)
        write_mcap(folder / "log.mcap", recording, epoch=10**18)
        os._exit(0)
    assert os.wait4(process, 0)[1] == 0
    return rows * 8 * 10 / 1e6  # time, field, rate, acceleration


def main(hours: list[float]) -> None:
    """Print the table."""
    print("| command | log | MB | kept MB | processor time, s | clock, s | peak MB | exit code |")
    print("|---|---|---|---|---|---|---|---|")
    for length in hours:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            kept = logs(folder, length)
            for command, log in (("calibrate", "log.mcap"), ("calibrate", "log.csv"), ("online", "log.mcap")):
                own = ["--idle", "0", "-o", str(folder / "online.yaml")] if command == "online" else []
                output = own or ["-o", str(folder / "out")]
                used, clock, peak, code = measured([command, str(folder / log), "-q", *output])
                size = (folder / log).stat().st_size / 1e6
                print(
                    f"| {command} | {log}, {length:g} h | {size:.0f} | {kept:.0f} | {used:.1f} | {clock:.1f} | "
                    f"{peak:.0f} | {code} |",
                    flush=True,
                )


if __name__ == "__main__":
    main([float(h) for h in sys.argv[1:]] or [1.0, 10.0])
