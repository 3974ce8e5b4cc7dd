"""An entry of the registry of methods."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Method:
    """An entry of the registry.

    Attributes:
        summary: one-sentence description.
        paper: publication.
        needs: fields that the recording must hold besides the magnetic field.
        function: "module:function" that takes (recording, *, progress, **options) and returns a Calibration.
        options: "module:class" of the options, a dataclass; "" if they are the keywords of the function.
        problem: why a method of another package cannot be used; "" if it can.
    """

    summary: str
    paper: str
    needs: tuple[str, ...]
    function: str
    options: str = ""
    problem: str = ""
