"""Messages for the command line: arguments and functions of the library as options and commands.

Messages of the library name arguments as Python writes them, `start=` or `method='autocal'`. The command line, the
pages and the browser show them with the options of the same meaning.
"""

from __future__ import annotations

import re

_OPTIONS = (
    *(
        "magnetic_field",
        "angular_rate",
        "acceleration",
        "attitude",
        "magnetic_unit",
        "angular_unit",
        "acceleration_unit",
    ),
    *(
        "start",
        "end",
        "stamps",
        "gyroscope_axes",
        "angular_rate_is",
        "method",
        "field_strength",
        "heading",
        "prior",
    ),
    *("hard_iron_walk", "soft_iron_walk", "misalignment", "gyroscope_scale", "noise", "force", "battery_voltage"),
    "calibration",
)
_OF_TABLES = ("time", "time_unit", "rate", "columns")
_OF_METHODS = ("clock_drift",)
_PREFIX = (
    {name: f"--{name.replace('_', '-')}" for name in _OPTIONS}
    | {name: f"--read {name}=" for name in _OF_TABLES}
    | {name: f"--option {name}=" for name in _OF_METHODS}
    | {"field": "--location, --date"}
)
_VALUE = r"""'[^']*'|[^\s,;:)('"][^\s,;)"]*|"""  # in quotes, a number or word, or nothing
# A name that is not part of a path or of an option.
_ARGUMENT = re.compile(rf"(?<![-\w./])(?<!--read )(?<!--option )({'|'.join(_PREFIX)})=({_VALUE})")
# Names with which a message about an argument begins, of options in the unit of the argument.
_LEADING = re.compile(r"\A(window|method|prior)(?=: | must be )")
_RADIANS = re.compile(r"np\.radians\(([^()]*)\)")
_COMMANDS = {"`mg.find_gap`": "`magyc-gtsam gap`", "`mg.calibrate`": "`magyc-gtsam calibrate`"}


def as_options(message: str) -> str:
    """Return a message of the library with its arguments and functions as those of the command line."""
    text = _ARGUMENT.sub(_option, _RADIANS.sub(r"\1", message))
    text = _LEADING.sub(lambda match: f"--{match[1]}", text)
    for function, command in _COMMANDS.items():
        text = text.replace(function, command)
    return text


def _option(match: re.Match[str]) -> str:
    option, value = _PREFIX[match[1]], match[2]
    if not value or value == "True" or match[1] == "field":
        return option
    if option.endswith("="):
        return option + value
    return f"{option}{'=' if value.startswith(chr(39) + '-') else ' '}{value}"
