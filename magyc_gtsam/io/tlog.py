"""Reader of MAVLink telemetry logs (.tlog), which hold the messages that a ground station received."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from magyc_gtsam.extras import needs
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.io.log_info import LogInfo, Source
from magyc_gtsam.io.mavlink_samples import (
    FILTERED,
    MESSAGES,
    Sender,
    note_of_senders,
    sender_of,
    stamp_of,
    values_of,
)
from magyc_gtsam.io.request import SENSORS, Request
from magyc_gtsam.io.streams import Stream, assemble
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.autopilot import without_parameters

_AUTOPILOT = without_parameters(
    f"{FILTERED}, which these parameters would replace; read the log on the autopilot's own card (.ulg, .BIN)"
)
_REPEATED = "use the times at which the ground station received them (stamps='log')"


@dataclass
class _Messages:
    """Messages of one kind from one sender.

    Attributes:
        stamps: of all messages, ns.
        rows: {sensor: numbers of the messages that measured it}.
        values: {sensor: x, y, z of each such message, in the message's units}.
    """

    stamps: array[int] = field(default_factory=lambda: array("q"))
    rows: dict[str, array[int]] = field(default_factory=lambda: {sensor: array("q") for sensor in SENSORS})
    values: dict[str, array[float]] = field(default_factory=lambda: {sensor: array("d") for sensor in SENSORS})

    def take(self, stamp: int, values: dict[str, list[float]]) -> None:
        """Append a message."""
        for sensor, numbers in values.items():
            self.rows[sensor].append(len(self.stamps))
            self.values[sensor].extend(numbers)
        self.stamps.append(stamp)

    def samples(self, sensor: str) -> int:
        """Return the number of samples of a sensor; 0 if all are zero, as of one that is absent."""
        return len(self.rows[sensor]) if any(self.values[sensor]) else 0

    def stream(self, kind: str, sensor: str, scale: float) -> Stream:
        """Return the samples of a sensor, its values multiplied by `scale`."""
        stamps, rows = (np.array(numbers, dtype=np.int64) for numbers in (self.stamps, self.rows[sensor]))
        return Stream(kind, stamps[rows], np.array(self.values[sensor], dtype=np.float64).reshape(-1, 3) * scale)


def read(path: Path, request: Request) -> Recording:
    """Read a telemetry log; see `magyc_gtsam.io.read`. One sender is read: a vehicle can have several.

    Raises:
        MagycError: pymavlink is not installed, or the log has no magnetometer.
    """
    request.only("MAVLink")
    senders = _senders(path, request)
    sender = _fullest(senders, request)
    kinds = senders[sender]
    listed = ", ".join(f"{kind} ({len(kinds[kind].stamps)} messages)" for kind in kinds)
    sensors = {}
    notes = [FILTERED, *note_of_senders(sender, senders)]
    for sensor in SENSORS:
        named = request.named(sensor)
        usable = [kind for kind in MESSAGES if kind in kinds and kinds[kind].samples(sensor)]
        if named is not None and named not in kinds:
            raise MagycError(f"{sensor}: no message {named!r}; the log has {listed}")
        if named is None and not usable:
            continue
        kind = named or max(usable, key=lambda each: kinds[each].samples(sensor))
        scale = request.scale(sensor, MESSAGES[kind][2][sensor][1], notes)
        sensors[sensor] = kinds[kind].stream(kind, sensor, scale)
    if "magnetic_field" not in sensors:
        raise MagycError(f"{path}: no magnetometer in the log; readable messages: {listed}")
    return assemble(
        sensors,
        {},
        request,
        name=path.stem,
        notes=tuple(notes),
        autopilot=_AUTOPILOT,
        repeated=_REPEATED,
    )


def info(path: Path) -> LogInfo:
    """Describe a telemetry log; see `magyc_gtsam.io.info`, which sets `problem`."""
    request = Request()
    senders = _senders(path, request)
    sources = []
    for kind, messages in senders[_fullest(senders, request)].items():
        span = (0.0, (messages.stamps[-1] - messages.stamps[0]) / 1e9)
        serves = tuple(sensor for sensor in SENSORS if messages.samples(sensor))
        sources.append(Source(kind, kind, len(messages.stamps), span, serves))
    return LogInfo(
        str(path), "MAVLink telemetry", max((s.span[1] for s in sources if s.span), default=0), tuple(sources)
    )


def _fullest(senders: dict[Sender, dict[str, _Messages]], request: Request) -> Sender:
    """Return the sender to read: of those with the messages that are named the one with most samples of both sensors.

    The first number decides, the second only between senders of which none has both sensors.
    """
    named = {name for sensor in SENSORS if (name := request.named(sensor)) is not None}

    def worth(sender: Sender) -> tuple[int, int, int]:
        kinds = senders[sender]
        field, rate = (max(m.samples(sensor) for m in kinds.values()) for sensor in SENSORS[:2])
        return len(named & kinds.keys()), min(field, rate), field

    return max(sorted(senders), key=worth)


def _senders(path: Path, request: Request) -> dict[Sender, dict[str, _Messages]]:
    """Return {sender: {kind: its messages}}."""
    with needs(f"{path}", "pymavlink", "ardupilot"):
        from pymavlink import mavutil
    senders: dict[Sender, dict[str, _Messages]] = {}
    try:
        log = mavutil.mavlink_connection(str(path), dialect="ardupilotmega", notimestamps=False)
        while (message := log.recv_match(type=list(MESSAGES))) is not None:
            received = round(message._timestamp * 1e6) * 1_000
            stamp = received if request.stamps == "log" else stamp_of(message)
            kinds = senders.setdefault(sender_of(message), {})
            kinds.setdefault(message.get_type(), _Messages()).take(stamp, values_of(message))
            request.report(log.percent / 100)
        log.close()
    except Exception as error:  # the exceptions of pymavlink on damaged bytes have no common class
        raise MagycError(f"{path}: the telemetry log cannot be read ({shortened(error)})") from error
    if not senders:
        raise MagycError(f"{path}: holds none of {', '.join(MESSAGES)}, which have a magnetometer")
    return senders
