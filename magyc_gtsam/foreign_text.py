"""What a message may hold: text that comes out of files, made fit to be shown, and how long a verdict may be."""

from __future__ import annotations

import re

LONGEST = 200  # characters of a foreign text in a message
MOST_WORDS = 30  # of the cause and the action that a verdict gives
# What a terminal would obey rather than show, and what turns the direction of a text or has no width.
_OBEYED = re.compile(
    "[\x00-\x09\x0b-\x1f\x7f-\x9f\xad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb\ud800-\udfff]"
)

_HYPHEN = re.compile(r"(?<![\w.)\]-])-(?=\.?\d)")


def shortened(text: object) -> str:
    """A foreign text on one line, without control characters, cut at 200 characters."""
    line = printable(" ".join(str(text)[: 10 * LONGEST].split()))
    return line if len(line) <= LONGEST else f"{line[:LONGEST]}…"


def printable(text: str) -> str:
    """A text as it is, but for characters that a terminal would obey rather than show: those as "\\x1b"."""
    return _OBEYED.sub(lambda match: match[0].encode("unicode_escape").decode("ascii"), text)


def with_minus(text: str) -> str:
    """With a minus sign where a hyphen stands before a number."""
    return _HYPHEN.sub("−", text)
