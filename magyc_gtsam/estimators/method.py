"""An entry of the registry of methods."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Method:
    """An entry of the registry.

    Attributes:
        summary: what it is, in one sentence.
        paper: where it was published.
        needs: what the recording must hold beside the magnetic field.
        function: "module:function" that takes (recording, *, progress, **options) and returns a Calibration.
        options: "module:class" of its options, a dataclass; "" where they are the function's own keywords.
        problem: why it cannot be used, where it is another package's; "" for nothing.
    """

    summary: str
    paper: str
    needs: tuple[str, ...]
    function: str
    options: str = ""
    problem: str = ""
