"""Text from files and messages, made safe and short enough to show."""

from __future__ import annotations

import re
from collections.abc import Collection
from itertools import islice

LONGEST = 200  # characters of a text from a file in a message
_MOST_LISTED = 20  # largest number of names that a message lists
_LONGEST_LISTED = 60  # largest number of characters of each name
_MOST_SENTENCES = 40  # largest number of sentences of a report
_LONGEST_SENTENCE = 500  # largest number of characters of each sentence
MOST_WORDS = 30  # largest number of words of the cause and the action in a verdict
# Control characters, characters that reverse the direction of text, and characters without width.
_CONTROL = re.compile(
    "[\x00-\x09\x0b-\x1f\x7f-\x9f\xad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb\ud800-\udfff]"
)

_HYPHEN = re.compile(r"(?<![\w.)\]-])-(?=\.?\d)")


def shortened(text: object, longest: int = LONGEST) -> str:
    """Return a text from a file on one line, with control characters escaped, cut at `longest` characters."""
    line = printable(" ".join(str(text)[: 10 * longest].split()))
    return line if len(line) <= longest else f"{line[:longest]}…"


def listed(names: Collection[object], separator: str = ", ") -> str:
    """Return names from a file for a message: the first 20, each cut at 60 characters, and the number of others."""
    shown = [shortened(name, _LONGEST_LISTED) for name in islice(names, _MOST_LISTED)]
    more = len(names) - len(shown)
    return separator.join(shown) + (f" and {more} more" if more else "")


def two_digits(value: float) -> str:
    """Return a number with two significant digits, from 100 to 100,000 without an exponent: "163", not "1.6e+02"."""
    return f"{value:.0f}" if 99.5 <= abs(value) < 1e5 else f"{value:.2g}"


def counted(number: int, what: str) -> str:
    """Return a number and its noun, as "1 log" or "2 logs"."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def first_of(sentences: Collection[str], what: str) -> tuple[str, ...]:
    """Return the first 40 sentences for a report, each cut at 500 characters, and the number of others.

    Args:
        sentences: all of them.
        what: their name in the plural, as in "and 3 more `what`".
    """
    shown = tuple(shortened(sentence, _LONGEST_SENTENCE) for sentence in islice(sentences, _MOST_SENTENCES))
    more = len(sentences) - len(shown)
    return (*shown, f"and {more} more {what}") if more else shown


def printable(text: str) -> str:
    """Return a text with its control characters escaped, as "\\x1b"."""
    return _CONTROL.sub(lambda match: match[0].encode("unicode_escape").decode("ascii"), text)


def with_minus(text: str) -> str:
    """Return a text with a minus sign in place of every hyphen before a number."""
    return _HYPHEN.sub("−", text)


def clauses(message: str) -> list[str]:
    """Split a message at its semicolons, except those in parentheses."""
    parts, depth, start = [], 0, 0
    for place, character in enumerate(message):
        depth += (character == "(") - (character == ")")
        if character == ";" and depth <= 0:
            parts.append(message[start:place].strip())
            start = place + 1
    return [part for part in (*parts, message[start:].strip()) if part]


def cause_and_action(message: str) -> tuple[str, str]:
    """Split a message "cause (numbers): remedy" into cause and remedy, shortened to 30 words in all.

    Both lose whole clauses at their end, the remedy first; the cause gives way to the first clause of the remedy.
    """
    cause, _, action = message.partition(": ")
    if len(f"{cause} {action}".split()) > MOST_WORDS:
        cause = _without_brackets(cause)
    if len(f"{cause} {action}".split()) > MOST_WORDS:
        first = len(_clauses(action)[0].split())
        cause = _whole_clauses(cause, MOST_WORDS - first) or _cut_to_words(cause, MOST_WORDS)
        action = _cut_to_words(action, MOST_WORDS - len(cause.split()))
    return cause, action


def _without_brackets(text: str) -> str:
    """Return a text without its parts in parentheses."""
    while " (" in text and ")" in text[text.index(" (") :]:
        start = text.index(" (")
        text = text[:start] + text[text.index(")", start) + 1 :]
    return text


def _clauses(text: str) -> list[str]:
    """Return the parts of a sentence between its commas and semicolons."""
    return text.replace("; ", ", ").split(", ")


def _whole_clauses(text: str, words: int) -> str:
    """Return as many whole clauses as fit into a number of words; "" if not even one fits."""
    kept = ""
    for clause in _clauses(text):
        longer = f"{kept}, {clause}" if kept else clause
        if len(longer.split()) > words:
            break
        kept = longer
    return kept


def _cut_to_words(text: str, words: int) -> str:
    """Return as many whole clauses as fit into a number of words; if not even one fits, as many words."""
    kept = _whole_clauses(text, words)
    if kept or not text or words < 2:
        return kept
    return " ".join(text.split()[: words - 1]) + " …"
