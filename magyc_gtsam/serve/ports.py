"""The serial ports that a page may name: those that the system lists, and other devices that are serial lines."""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened

_NAME = re.compile(r"/dev/[\w./-]{1,200}")
_DRIVERS, _PROCESSES = Path("/proc/tty/drivers"), Path("/proc")
_LINES = (
    "serial",
    "pty:slave",
)  # kinds of drivers; opening another device can have side effects, such as starting a watchdog
_KIND_FIELD, _MAJOR_FIELD, _MINOR_FIELD = 4, 2, 3  # fields of a line of /proc/tty/drivers
_TERMINAL_FIELD = 4  # field of /proc/N/stat after the name in brackets: the process's controlling terminal


def serial_ports() -> list[str]:
    """Return the serial ports of this machine; empty without pyserial."""
    try:
        from serial.tools.list_ports import comports
    except ImportError:
        return []
    return sorted(port.device for port in comports())


def checked_port(asked: object) -> str:
    """Return the device behind a port that a page has named.

    A port that is not listed, such as a pseudo terminal or a link in /dev, must be a serial line by its driver and must
    not be the terminal of a process, whose key strokes this server must not read.

    Raises:
        MagycError: the port is neither listed nor such a device.
    """
    if isinstance(asked, str) and asked in serial_ports():
        return asked
    problem = "not the name of a device under /dev"
    if isinstance(asked, str) and _NAME.fullmatch(asked):
        device = os.path.realpath(asked)
        problem = _why_no_serial_line(device)
        if not problem and _NAME.fullmatch(device):
            return device
    raise MagycError(
        f"port: no such serial port, {shortened(asked)!r} is {problem}; plug it in and choose it again, or name a "
        "serial device under /dev"
    )


def _why_no_serial_line(device: str) -> str:
    """Return why a device may not be read as a serial line; "" if it may."""
    try:
        found = os.stat(device)
        drivers = _DRIVERS.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError as error:
        return f"not there ({error.strerror})"
    if not stat.S_ISCHR(found.st_mode):
        return "no device of characters"
    major, minor = os.major(found.st_rdev), os.minor(found.st_rdev)
    rows = (line.split() for line in drivers)
    lines = [row for row in rows if len(row) > _KIND_FIELD and row[_KIND_FIELD] in _LINES]
    if not any(int(row[_MAJOR_FIELD]) == major and _within(minor, row[_MINOR_FIELD]) for row in lines):
        return "no serial line by its driver"
    process = _controlled_by(device, found)
    return f"the terminal of process {process}" if process else ""


def _within(minor: int, span: str) -> bool:
    """Return whether a span such as "0-255" or "64" contains a number."""
    first, _, last = span.partition("-")
    return int(first) <= minor <= int(last or first)


def _controlled_by(device: str, found: os.stat_result) -> str:
    """Return the number of a process whose terminal a device is, "" if there is none."""
    number = found.st_rdev
    for name in filter(str.isdecimal, os.listdir(_PROCESSES)):
        try:
            text = (_PROCESSES / name / "stat").read_text(encoding="ascii", errors="replace")
        except OSError:  # the process has ended
            continue
        fields = text.rpartition(")")[2].split()
        # Packed as by the kernel's `new_encode_dev`: low byte of the minor number, major, rest of the minor number.
        packed = os.minor(number) & 0xFF | os.major(number) << 8 | (os.minor(number) & ~0xFF) << 12
        if int(fields[_TERMINAL_FIELD]) == packed and _has(name, device, found):
            return name
    return ""


def _has(process: str, device: str, found: os.stat_result) -> bool:
    """Return whether a process has this device: in another container one of the same number is another terminal."""
    try:
        return os.path.samestat(os.stat(f"{_PROCESSES}/{process}/root{device}"), found)
    except FileNotFoundError:
        return False
    except OSError:  # not to be seen: it may be the same
        return True
