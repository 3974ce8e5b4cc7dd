"""Reader of PX4 logs (.ulg); it undoes the calibration that PX4 applied."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import listed
from magyc_gtsam.io import px4_thermal
from magyc_gtsam.io.log_info import LogInfo, Source
from magyc_gtsam.io.px4_calibration import Parameters, motors_of, undo
from magyc_gtsam.io.px4_channels import CHANNELS, channels_of, own_of, powers_of, thermometers_of
from magyc_gtsam.io.px4_messages import Array, Message, device_of, load
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.streams import Stream, assemble
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.autopilot import Autopilot, Place

_GAUSS = 1e-4  # T
_NO_SAMPLE = 0x7FFFFFFF  # relative stamp of a sensor without a new sample in sensor_combined
# {sensor: {message: its fields}}; see `Message.vector`.
_MESSAGES = {
    "magnetic_field": {
        "sensor_combined": "magnetometer_ga[{}]",
        "vehicle_magnetometer": "magnetometer_ga[{}]",
        "sensor_mag": "xyz",
    },
    "angular_rate": {"sensor_combined": "gyro_rad[{}]", "sensor_gyro": "xyz"},
    "acceleration": {"sensor_combined": "accelerometer_m_s2[{}]"},
}
_AUXILIARY = ("sensor_selection", "magnetometer_bias_estimate")


def read(path: Path, request: Request) -> Recording:
    """Read a PX4 log; see `magyc_gtsam.io.read`.

    Raises:
        MagycError: pyulog is not installed, a message is missing, or the applied calibration cannot be undone.
    """
    request.only("PX4", clock="the stamps of the sensors")
    channels = request.channels if request.channels is not None else CHANNELS
    names = {m for fields in _MESSAGES.values() for m in fields} | {"vehicle_attitude", *_AUXILIARY}
    names |= {c.split(".")[0].split("[")[0] for c in channels}
    names |= {n.split("[")[0] for s in request.sensors if (n := request.named(s))}
    messages, parameters, damage = load(path, sorted(names))
    request.report(0.7)
    notes = list(damage)
    magnetometer, place = _magnetometer(messages, parameters, request, notes)
    sensors = {"magnetic_field": magnetometer}
    gyroscope, mean, gyroscope_place = _gyroscope(messages, parameters, request, notes)
    if gyroscope is not None:
        sensors["angular_rate"] = gyroscope
    acceleration = _find(messages, "acceleration", request.named("acceleration"))
    if acceleration is not None:
        message, value = acceleration
        scale = request.scale("acceleration", notes=notes)
        sensors["acceleration"] = Stream(message.label, message.stamp * 1000, value * scale)
    own = {"magnetometer": own_of(messages, "mag", magnetometer.name)}
    own |= {} if gyroscope is None else {"gyroscope": own_of(messages, "gyro", gyroscope.name)}
    attitude = _attitude(messages, request, notes)
    if attitude is not None:
        sensors["attitude"] = attitude
    recording = assemble(
        sensors,
        channels_of(messages, request, [message for message in own.values() if message is not None]),
        request,
        name=path.stem,
        notes=tuple(notes),
        angular_rate_is=mean,
        attitude_is="estimate",
        autopilot=Autopilot(
            "px4",
            place,
            gyroscope_place,
            powers_of(messages, channels),
            thermometers_of(messages, channels, own),
            *motors_of(parameters, place),
        ),
    )
    request.report(1.0)
    return recording


def info(path: Path) -> LogInfo:
    """Describe a PX4 log; see `magyc_gtsam.io.info`, which sets `problem`."""
    messages, _, damage = load(path, None)
    # Other messages can have stamps from long before the log.
    sensors = [m for m in messages if m.count and any(m.name in fields for fields in _MESSAGES.values())]
    first = min((int(m.data["timestamp"][0]) for m in sensors), default=0)
    last = max((int(m.data["timestamp"][-1]) for m in sensors), default=0)
    sources = []
    for m in messages:
        serves = [
            s for s, fields in _MESSAGES.items() if m.name in fields and m.vector(fields[m.name]) is not None
        ]
        serves += ["attitude"] if "q[0]" in m.data and m.name.startswith("vehicle_attitude") else []
        serves += (
            ["channel"]
            if any(c.split(".")[0] == m.name and c.split(".", 1)[1] in m.data for c in CHANNELS)
            else []
        )
        times = m.data["timestamp"]
        span = ((int(times[0]) - first) / 1e6, (int(times[-1]) - first) / 1e6) if m.count else None
        sources.append(Source(m.label, m.name, m.count, span, tuple(serves)))
    return LogInfo(str(path), "PX4 ULog", (last - first) / 1e6, tuple(sources), damage, first=first * 1000)


def _find(
    messages: list[Message], sensor: str, named: str | None, notes: list[str] | None = None
) -> tuple[Message, Array] | None:
    """Return the message of a sensor and its values (n, 3): the one that is named, else the one with most samples."""
    fields = _MESSAGES[sensor]
    values = [(m, m.vector(fields[m.name])) for m in messages if m.name in fields]
    candidates = [(m, v) for m, v in values if v is not None]
    if named is not None:
        matches = [(m, v) for m, v in candidates if named in (m.label, f"{m.name}[{m.instance}]")]
        if not matches:
            present = listed([f"{m.label} ({m.count} samples)" for m, _ in candidates]) or "none"
            raise MagycError(f"{sensor}: no message {named!r}; the log has {present}")
        return matches[0]
    if not candidates:
        return None
    # sensor_combined has every sample; which of the others is thinned out depends on the logger.
    order = list(fields)
    best, value = min(
        candidates, key=lambda f: (f[0].name != order[0], -f[0].count, order.index(f[0].name), f[0].instance)
    )
    others = [m for m, _ in candidates if m is not best]
    if others and notes is not None:
        alternatives = listed([f"{m.label} ({m.count} samples)" for m in others])
        notes.append(
            f"{sensor} is from {best.label} ({best.count} samples); {alternatives} could be named instead"
        )
    return best, value


def _magnetometer(
    messages: list[Message], parameters: Parameters, request: Request, notes: list[str]
) -> tuple[Stream, Place]:
    """Return the magnetometer with PX4's calibration undone, and the place of its parameters."""
    found = _find(messages, "magnetic_field", request.named("magnetic_field"), notes)
    if found is None:
        raise MagycError(
            f"no magnetometer in the log (none of {', '.join(_MESSAGES['magnetic_field'])}); "
            "have the logger record sensor_mag (SDLOG_PROFILE)"
        )
    message, logged = found
    stamp = message.stamp
    if message.name == "sensor_combined" and "magnetometer_timestamp_relative" in message.data:
        relative = np.asarray(message.data["magnetometer_timestamp_relative"]).astype(np.int64)
        stamp = np.asarray(message.data["timestamp"]).astype(np.int64) + relative
        new = relative != _NO_SAMPLE
        new[1:] &= (np.diff(stamp) != 0) | (np.diff(logged, axis=0) != 0).any(axis=1)
        logged, stamp = logged[new], stamp[new]
    if message.name == "vehicle_magnetometer":
        _refuse_estimated_bias(messages)
    device = device_of(message, messages, "mag")
    # Before version 1.11 the driver corrected sensor_mag, which then also had x_raw; it is never rotated.
    corrected = message.name != "sensor_mag" or "x_raw" in message.data
    if not corrected:
        logged, warm = px4_thermal.corrected(
            "TC_M", logged, message.data.get("temperature"), parameters.initial, device
        )
        notes.extend([warm] if warm else [])
    raw, undone, place = undo(
        "MAG",
        logged,
        stamp,
        parameters,
        device,
        corrected=corrected,
        rotated=message.name != "sensor_mag",
    )
    notes.extend(undone)
    scale = request.scale("magnetic_field", _GAUSS, notes)
    return Stream(message.label, stamp * 1000, raw * scale), place


def _refuse_estimated_bias(messages: list[Message]) -> None:
    """Raise a MagycError if PX4 subtracted a bias that it estimated in flight."""
    for m in messages:
        if m.name == "magnetometer_bias_estimate" and any(
            np.any(v != 0) for k, v in m.data.items() if k.startswith(("bias_x", "bias_y", "bias_z"))
        ):
            raise MagycError(
                "PX4 subtracted from vehicle_magnetometer a bias that it estimated in flight, which cannot be "
                "undone exactly; read the uncorrected message if the log has it (magnetic_field='sensor_mag')"
            )


def _gyroscope(
    messages: list[Message], parameters: Parameters, request: Request, notes: list[str]
) -> tuple[Stream | None, Literal["instant", "interval-mean"], Place]:
    """Return the gyroscope with PX4's calibration undone, None without one, the kind of its rates, and its place."""
    found = _find(messages, "angular_rate", request.named("angular_rate"), notes)
    if found is None:
        notes.append("no gyroscope: the log has neither sensor_combined nor sensor_gyro")
        return None, "instant", Place()
    message, logged = found
    combined = message.name == "sensor_combined"
    problem = ""
    try:
        device = device_of(message, messages, "gyro")
    except MagycError as error:  # the log changes between gyroscopes, which only changes the bias to estimate
        device, problem = None, str(error)
        notes.append(problem)
    corrected = combined or "x_raw" in message.data
    if not corrected:
        logged, warm = px4_thermal.corrected(
            "TC_G", logged, message.data.get("temperature"), parameters.initial, device
        )
        notes.extend([warm] if warm else [])
    elif parameters.initial.get("TC_G_ENABLE", 0):
        notes.append("the gyroscope's thermal correction (TC_G_*) was applied in flight and is kept")
    raw, undone, place = undo(
        "GYRO",
        logged,
        message.stamp,
        parameters,
        device,
        corrected=corrected,
        rotated=combined,
    )
    notes.extend(undone)
    place = replace(place, problem=problem or place.problem)
    scale = request.scale("angular_rate", notes=notes)
    stream = Stream(message.label, message.stamp * 1000, raw * scale)
    if combined and ("gyro_integral_dt" in message.data):
        notes.append(
            "sensor_combined holds delta angles over gyro_integral_dt: the angular rate is an interval mean"
        )
        return stream, "interval-mean", place
    return stream, "instant", place


def _attitude(messages: list[Message], request: Request, notes: list[str]) -> Stream | None:
    """Return PX4's attitude estimate as quaternions; None if the log has none and the caller named none."""
    named = request.named("attitude")
    candidates = [m for m in messages if all(f"q[{k}]" in m.data for k in range(4))]
    matches = [m for m in candidates if (named or "vehicle_attitude") in (m.name, m.label)]
    if not matches:
        if named:
            raise MagycError(f"attitude: no message {named!r} with a quaternion in the log")
        return None
    message = matches[0]
    quaternion = np.column_stack([message.data[f"q[{k}]"] for k in (1, 2, 3, 0)]).astype(np.float64)
    notes.append(
        f"attitude is {message.label}, vehicle (forward, right, down) to north, east, down; PX4's "
        "estimate, to which the magnetometer contributed"
    )
    return Stream(message.label, message.stamp * 1000, quaternion)
