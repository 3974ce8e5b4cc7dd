"""Reader of ArduPilot dataflash logs (.BIN); it undoes the corrections that ArduPilot applied."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io import ardupilot_compass, ardupilot_gyroscope
from magyc_gtsam.io.ardupilot_messages import ArduPilotLog, InstanceSamples, label, load
from magyc_gtsam.io.log_info import LogInfo, Source
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.streams import Stream, assemble
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.autopilot import Autopilot, Place

_MILLIGAUSS = 1e-7  # T
_AXES = {
    "magnetic_field": ("MAG", ("MagX", "MagY", "MagZ")),
    "angular_rate": ("IMU", ("GyrX", "GyrY", "GyrZ")),
    "acceleration": ("IMU", ("AccX", "AccY", "AccZ")),
}
_OFFSETS = (("OfsX", "OfsY", "OfsZ"),)
_MOTORS = (("MOX", "MOY", "MOZ"), ("MOfsX", "MOfsY", "MOfsZ"))  # the second until version 3.6
_THROTTLE_IN = "ThI"  # in CTUN of Copter and Sub, which alone tell the compass their throttle
_PER_MILLE = 1.5  # throttle above which it is one of the logs of before 2016, of 0 to 1000
_CHANNELS = ("BAT.Curr", "BAT.Volt", "BARO.Temp", "IMU.T", "CTUN.ThO")


def read(path: Path, request: Request) -> Recording:
    """Read an ArduPilot log; see `magyc_gtsam.io.read`.

    Raises:
        MagycError: a message is missing, or the correction in flight cannot be undone.
    """
    request.only("ArduPilot", clock="one clock")
    channels = tuple(request.channels) if request.channels is not None else _CHANNELS
    log = load(path, _fields(channels), request)
    notes = list(log.notes)
    compass, place, sigma = _magnetometer(log, request, notes)
    sensors, gyroscope_place = {"magnetic_field": compass}, Place()
    inertial = _choose(log, "angular_rate", request, [])
    for sensor in ("angular_rate", "acceleration"):
        key = _choose(log, sensor, request, notes if sensor == "angular_rate" else [])
        if key is None:
            notes.append(f"no {sensor}: the log has no IMU messages")
            continue
        scale = request.scale(sensor, notes=notes)
        samples = log.samples[key]
        if absent := [name for name in _AXES[sensor][1] if name not in samples.columns]:
            notes.append(f"no {sensor}: {samples.name} has no {', '.join(absent)}")
            continue
        stream = samples.stream(*_AXES[sensor][1])
        if sensor == "angular_rate":
            raw, note, gyroscope_place = ardupilot_gyroscope.undo(
                stream.value, samples.parameters, log.parameters, key[1], log.last
            )
            stream = replace(stream, value=raw)
            cutoff = log.parameters[-1].get("INS_GYRO_FILTER")
            delayed = f"; the rates are low-pass filtered at {cutoff:g} Hz (INS_GYRO_FILTER)" if cutoff else ""
            notes.append(f"{note}{delayed}")
        else:
            stream = replace(
                stream,
                value=ardupilot_gyroscope.turned(stream.value, samples.parameters, log.parameters, log.last),
            )
        sensors[sensor] = Stream(stream.name, stream.stamp, stream.value * scale)
    attitude = _attitude(log, request, notes)
    if attitude is not None:
        sensors["attitude"] = attitude
    return assemble(
        sensors,
        _channels(log, channels, request, inertial),
        request,
        name=path.stem,
        notes=tuple(notes),
        attitude_is="estimate",
        autopilot=Autopilot(
            "ardupilot",
            place,
            gyroscope_place,
            _powers(log, channels),
            {},
            *ardupilot_compass.motors_of(log.parameters[-1], place),
            offset_sigma=sigma,
        ),
    )


def _fields(channels: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Return the fields to load of each message, for the sensors and the channels."""
    fields: dict[str, tuple[str, ...]] = {"ATT": ("Roll", "Pitch", "Yaw")}
    for name in ("MAG", "MAG2", "MAG3"):
        fields[name] = (*_AXES["magnetic_field"][1], *sum((*_OFFSETS, *_MOTORS), ()), "Health")
    for name in ("IMU", "IMU2", "IMU3"):
        fields[name] = (*_AXES["angular_rate"][1], *_AXES["acceleration"][1])
    for channel in channels:
        message, dot, member = channel.partition(".")
        if not dot:
            raise MagycError(f"channels: {channel!r}; write them as message.field (BAT.Curr), or message[1].field")
        kind = message.split("[")[0]
        of_vehicle = (_THROTTLE_IN,) if kind == "CTUN" else ()
        fields[kind] = tuple(dict.fromkeys((*fields.get(kind, ()), member, *of_vehicle)))
    return fields


def info(path: Path) -> LogInfo:
    """Describe an ArduPilot log; see `magyc_gtsam.io.info`, which sets `problem`."""
    log = load(path, None, Request())
    sensors = [s for k, s in log.samples.items() if k[0] in ("MAG", "IMU")]
    times = [t for s in sensors for t in (int(s.stamp[0]), int(s.stamp[-1]))]
    first, last = min(times, default=0), max(times, default=0)
    serves: dict[str, tuple[str, ...]] = {"ATT": ("attitude",)}
    for sensor, (kind, _) in _AXES.items():
        for name in (kind, f"{kind}2", f"{kind}3"):
            serves[name] = (*serves.get(name, ()), sensor)
    for channel in _CHANNELS:
        kind = channel.split(".")[0]
        serves[kind] = tuple(dict.fromkeys((*serves.get(kind, ()), "channel")))
    sources = tuple(
        Source(
            label(k),
            k[0],
            len(s.stamp),
            ((int(s.stamp[0]) - first) / 1e9, (int(s.stamp[-1]) - first) / 1e9),
            serves.get(k[0], ()),
        )
        for k, s in log.samples.items()
    )
    return LogInfo(str(path), "ArduPilot dataflash", (last - first) / 1e9, sources, log.notes, first=first)


def _choose(log: ArduPilotLog, sensor: str, request: Request, notes: list[str]) -> tuple[str, int] | None:
    """Return the key of the instance that the caller named for a sensor, else of the first; None without any."""
    kind = _AXES[sensor][0]
    keys = sorted(k for k in log.samples if k[0] == kind)
    listed = ", ".join(f"{label(k)} ({len(log.samples[k].stamp)} samples)" for k in keys)
    named = request.named(sensor)
    if named is not None:
        matches = [k for k in keys if named in (label(k), f"{kind}{k[1] + 1}") or (named == kind and k[1] == 0)]
        if not matches:
            raise MagycError(f"{sensor}: no message {named!r}; the log has {listed or 'none'}")
        return matches[0]
    if len(keys) > 1:
        notes.append(f"{sensor} is from {label(keys[0])}, the first of {listed}; another can be named ({sensor}=)")
    return keys[0] if keys else None


def _magnetometer(
    log: ArduPilotLog, request: Request, notes: list[str]
) -> tuple[Stream, Place, tuple[float, ...]]:
    """Return the uncorrected magnetometer, without unhealthy samples, the place of its parameters, and sigmas (3,) of
    the offset that was undone, T.
    """
    key = _choose(log, "magnetic_field", request, notes)
    if key is None:
        raise MagycError(
            "the log has no MAG messages; have ArduPilot log the compass (LOG_BITMASK, bit 'Compass')"
        )
    samples = log.samples[key]
    _expect_one_boot(samples, request)
    stream = samples.stream(*_AXES["magnetic_field"][1])
    raw, sigma, correction_notes = ardupilot_compass.undo(
        stream.value,
        samples.first_of(*_OFFSETS),
        samples.first_of(*_MOTORS),
        samples.parameters,
        log.parameters,
        key[1],
        log.last,
    )
    notes.extend(correction_notes)
    scale = request.scale("magnetic_field", _MILLIGAUSS, notes)
    stream = Stream(stream.name, stream.stamp, raw * scale)
    if "Health" in samples.columns:
        healthy = samples.columns["Health"] != 0
        if not healthy.all():
            notes.append(
                f"{stream.name}: {(~healthy).sum()} of {len(healthy)} samples are unhealthy and were left out"
            )
            stream = stream.rows(healthy)
    return stream, ardupilot_compass.place_of(log.parameters[-1], key[1]), tuple((sigma * abs(scale)).tolist())


def _expect_one_boot(samples: InstanceSamples, request: Request) -> None:
    """Raise a MagycError if the vehicle was switched on again in between, and its clock does not show it later."""
    again = np.flatnonzero(np.diff(samples.boot))
    if len(again) == 0 or request.start is not None or request.end is not None:
        return
    before, after = samples.stamp[again[0]], samples.stamp[again[0] + 1]
    if after > before:
        at = (0.5 * (before + after) - samples.stamp[0]) / 1e9
        raise MagycError(
            f"{samples.name}: the vehicle was switched on again after sample {again[0] + 1}, {at:.1f} s into the log; "
            f"read one side of it (end={at:.1f} or start={at:.1f})"
        )


def _attitude(log: ArduPilotLog, request: Request, notes: list[str]) -> Stream | None:
    """Return ArduPilot's attitude estimate as quaternions; None if the log has none and the caller named none."""
    named = request.named("attitude")
    if named not in (None, "ATT"):
        raise MagycError(f"attitude: only the message ATT can be read, got {named!r}")
    if ("ATT", 0) not in log.samples:
        if named:
            raise MagycError("attitude: the log has no ATT messages")
        return None
    stream = log.samples["ATT", 0].stream("Roll", "Pitch", "Yaw")
    quaternion = Rotation.from_euler("ZYX", stream.value[:, ::-1], degrees=True).as_quat()
    trim = [log.parameters[-1].get(f"AHRS_TRIM_{axis}", 0.0) for axis in "XY"]
    turned = f", turned by AHRS_TRIM ({', '.join(f'{np.degrees(t):.1f}°' for t in trim)})" if any(trim) else ""
    notes.append(
        f"attitude is ATT, vehicle (forward, right, down) to north, east, down{turned}; ArduPilot's "
        "estimate, to which the compass contributed"
    )
    return Stream("ATT", stream.stamp, quaternion)


def _channels(
    log: ArduPilotLog, channels: tuple[str, ...], request: Request, inertial: tuple[str, int] | None
) -> dict[str, Stream]:
    """Return the channels that the log has; those of IMU are of the instance that is read, unless they name one."""
    result = {}
    for channel in channels:
        message, member = channel.split(".", 1)
        keys = [k for k in sorted(log.samples) if message in (k[0], label(k))]
        keys.sort(key=lambda k: k != inertial)
        samples = log.samples[keys[0]] if keys else None
        if samples is not None and member in samples.columns and len(samples.stamp) > 1:
            result[channel] = Stream(channel, samples.stamp, samples.columns[member])
        elif request.channels is not None:
            raise MagycError(f"channels: the log has no {channel!r}; write them as message.field")
    return result


def _powers(log: ArduPilotLog, channels: tuple[str, ...]) -> dict[str, tuple[int, float]]:
    """Return `Autopilot.powers` of the channels: battery 1's current, and the throttle that the compass is told."""
    result = {}
    for channel in channels:
        message, member = channel.split(".", 1)
        key = next((k for k in sorted(log.samples) if message in (k[0], label(k))), None)
        columns = log.samples[key].columns if key is not None else {}
        if key == ("BAT", 0) and member == "Curr":
            result[channel] = (2, 1.0)
        elif key is not None and key[0] == "CTUN" and member == "ThO" and {member, _THROTTLE_IN} <= columns.keys():
            largest = np.nanmax(np.abs(columns[member]), initial=0.0)
            result[channel] = (1, 1000.0 if largest > _PER_MILLE else 1.0)
    return result
