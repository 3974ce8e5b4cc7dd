"""Options that belong together, written down once: a dataclass whose fields are options of a command."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import is_dataclass
from functools import wraps
from typing import Any


def with_groups(command: Callable[..., int]) -> Callable[..., int]:
    """A command for typer: of its parameters, those that are dataclasses become the options of their fields."""
    groups: dict[str, Any] = {}
    parameters: list[inspect.Parameter] = []
    types: dict[str, Any] = {}
    own = inspect.get_annotations(command, eval_str=True)  # not get_type_hints, which hides options before 3.11
    for name, parameter in inspect.signature(command).parameters.items():
        if is_dataclass(own[name]):
            groups[name] = own[name]
            types |= inspect.get_annotations(own[name], eval_str=True)
            parameters += inspect.signature(own[name]).parameters.values()
        else:
            types[name] = own[name]
            parameters.append(parameter)

    @wraps(command)
    def run(**arguments: Any) -> int:
        made = {
            name: group(**{field: arguments.pop(field) for field in group.__dataclass_fields__})
            for name, group in groups.items()
        }
        return command(**made, **arguments)

    signature = [p.replace(kind=p.KEYWORD_ONLY, annotation=types[p.name]) for p in parameters]
    run.__signature__ = inspect.Signature(signature)  # type: ignore[attr-defined]
    run.__annotations__ = types
    return run
