"""`magyc-gtsam apply`: write a log with calibrated field and angular rate."""

from __future__ import annotations

import csv
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from magyc_gtsam.cli import options as given
from magyc_gtsam.cli.files import replacing
from magyc_gtsam.cli.options import with_groups
from magyc_gtsam.cli.reading import Reading
from magyc_gtsam.cli.terminal import complain, concluded, refused, show, stages

if TYPE_CHECKING:
    from magyc_gtsam.cli.terminal import Progress
    from magyc_gtsam.recording import Recording


@with_groups
def run(
    calibration_file: given.CalibrationFile,
    reading: Reading,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            parser=given.named_path,
            metavar="FILE",
            help="OUT.mcap or OUT.csv.",
            show_default=False,
        ),
    ],
    force: Annotated[bool, typer.Option("--force", help="Also write a result that must not be trusted.")] = False,
    quiet: given.Quiet = False,
) -> int:
    """Apply a calibration to a log.

    Time stamps and all other data are unchanged. From MCAP to MCAP every message of every other topic is copied byte
    for byte, and in the sensors' own messages only the vector is replaced (ROS 2, without --gyroscope-axes). Those that
    are faulty, or outside the interval that magnetometer and gyroscope both cover, are left out, as are such rows of a
    table. The gyroscope bias is subtracted if the method estimated one, and the effects found by `magyc-gtsam gap` are
    corrected; a delay of the magnetometer in the stamps of its samples, which are then earlier. Use the same reading
    options (units, axes) as for the calibration; an effect of a current or a temperature needs that channel in the log.
    An effect that is dated in the log in which it was found (a jump, a drift, a passed object, a tone) is corrected in
    that log: in another one a jump counts as set in from its start, the others are left out, and a note says so. An
    untrusted calibration, and one that gives a field unlike the Earth's, is refused with exit code 1. The output is
    marked as calibrated: `apply` and `history` refuse it as a LOG, other commands read it and note the mark.
    """
    from magyc_gtsam.calibration import Calibration
    from magyc_gtsam.calibration.calibrated import calibrated, uneven, without_lag
    from magyc_gtsam.calibration.elsewhere import on_recording
    from magyc_gtsam.factors.effects.corrections import lag_of
    from magyc_gtsam.factors.errors import MagycError
    from magyc_gtsam.recording.applied import ONLY_THE_REST, as_calibrated, is_calibrated
    from magyc_gtsam.recording.held import with_equal_samples
    from magyc_gtsam.recording.time_zero import time_zero_of
    from magyc_gtsam.report.verdict import judged

    if output.suffix.lower() not in (".mcap", ".csv"):
        raise MagycError(f"--output: must end in .mcap or .csv, got {output}")
    if output.exists() and reading.log.exists() and output.samefile(reading.log):
        raise MagycError(f"--output: {output} is the log itself; name another file")
    calibration = Calibration.load(calibration_file)
    if calibration.configuration.get("calibrated_before"):
        raise MagycError(f"{calibration_file}: {ONLY_THE_REST}")
    if not calibration.trusted and not force:
        return refused(judged(calibration).reason)
    with stages(shown=not quiet) as stage:
        recording = reading.recording(stage("reading"))
        if is_calibrated(recording):
            raise MagycError(
                f"{reading.log}: the field is calibrated already (magyc-gtsam apply wrote it); apply the calibration "
                "to the log as it was recorded"
            )
        calibration, notes = on_recording(calibration, recording)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            result = as_calibrated(with_equal_samples(calibrated(calibration, recording)))
        doubts = [str(each.message) for each in caught if issubclass(each.category, UserWarning)]
        if doubts and not force:
            return refused("; ".join(doubts))
        lag = lag_of(calibration.terms)
        with replacing(output) as part:
            writing = stage("writing")
            if output.suffix.lower() == ".mcap":
                written, remark = _write_mcap(part, reading, result, lag, writing)
            else:
                written, remark = _write_csv(part, without_lag(result, lag), time_zero_of(recording)), ""
            writing(1.0)
    if not quiet:
        show(f"{output}: {written} samples of the calibrated field{remark}")
    notes = [*notes, *uneven(result)]
    for note in notes:  # of the values that were written, whether or not their number is shown
        complain(f"note: {note}")
    for doubt in doubts:
        complain(f"the result must not be trusted: {doubt}")
    return concluded(judged(calibration)) or int(bool(doubts))


def _write_mcap(
    path: Path, reading: Reading, calibrated: Recording, lag: float, progress: Progress
) -> tuple[int, str]:
    """Write the log with the vectors of its sensors replaced if it is MCAP, else the recording.

    Returns:
        The number of samples of the field that were written, and a remark.
    """
    from magyc_gtsam.calibration.calibrated import without_lag
    from magyc_gtsam.io import write_mcap
    from magyc_gtsam.io.mcap_copy import copy_mcap
    from magyc_gtsam.recording.time_zero import time_zero_of

    is_bag = reading.log.is_dir()
    is_mcap = not is_bag and _begins(reading.log) == b"\x89MCAP"
    named = reading.magnetic_field, reading.angular_rate
    if is_mcap and reading.gyroscope_axes is None:
        count = copy_mcap(
            reading.log,
            path,
            calibrated,
            time_zero_of(calibrated),
            dict(zip(("magnetic_field", "angular_rate"), named, strict=True)),
            lag,
            reading.stamps == "log",
            progress,
        )
        if count is not None:
            remark = f"; {count.unchanged} messages of other topics copied unchanged"
            if count.left_out:
                remark += (
                    f"; {count.left_out} of the sensors left out: faulty, or outside the time that both cover"
                )
            return count.calibrated["magnetic_field"], remark
    result = without_lag(calibrated, lag)
    write_mcap(path, result, epoch=time_zero_of(calibrated))
    return int(result.magnetic_field_fresh.sum()), "; other topics are not in it" if is_mcap or is_bag else ""


def _begins(log: Path) -> bytes:
    with open(log, "rb") as file:
        return file.read(5)


def _write_csv(path: Path, recording: Recording, origin: int) -> int:
    """Write a table with units in the header; field and rate are empty where their sensor has no sample.

    Returns:
        The number of samples of the field.
    """
    import numpy as np

    from magyc_gtsam.recording.time_zero import seconds_of

    columns: list[tuple[list[str], np.ndarray, np.ndarray]] = []
    stamps = np.round(recording.time * 1e9).astype(np.int64) + origin
    every = np.ones(len(recording.time), dtype=bool)
    for name, unit, value, rows in (
        ("calibrated_magnetic_field", "T", recording.magnetic_field, recording.magnetic_field_fresh),
        ("angular_rate", "rad/s", recording.angular_rate, recording.angular_rate_fresh),
        ("acceleration", "m/s^2", recording.acceleration, every),
    ):
        if value is not None:
            columns.append(([f"{name}_{axis}_{unit}" for axis in "xyz"], value, rows))
    if recording.attitude is not None:
        columns.append(([f"quaternion_{axis}" for axis in "xyzw"], recording.attitude, every))
    for name, value in recording.channels.items():
        table = value.reshape(len(value), -1)
        names = [name] if value.ndim == 1 else [f"{name}_{i}" for i in range(table.shape[1])]
        columns.append((names, table, every))
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["time_s", *(name for names, _, _ in columns for name in names)])
        for row, stamp in enumerate(stamps.tolist()):
            cells: list[float | str] = [seconds_of(stamp)]
            for names, value, rows in columns:
                known = rows[row] and np.isfinite(value[row]).all()
                cells += value[row].tolist() if known else [""] * len(names)
            writer.writerow(cells)
    return int(recording.magnetic_field_fresh.sum())
