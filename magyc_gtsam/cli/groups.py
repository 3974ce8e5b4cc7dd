"""Groups of options that several commands share, each a dataclass whose fields are options."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import is_dataclass
from functools import wraps
from typing import Any


def with_groups(command: Callable[..., int]) -> Callable[..., int]:
    """Decorate a command for typer: a parameter that is a dataclass is replaced by options for its fields."""
    groups: dict[str, Any] = {}
    parameters: list[inspect.Parameter] = []
    types: dict[str, Any] = {}
    # Not get_type_hints, which before Python 3.11 hides options behind implicit Optional.
    annotations = inspect.get_annotations(command, eval_str=True)
    for name, parameter in inspect.signature(command).parameters.items():
        annotation = annotations[name]
        if isinstance(annotation, type) and is_dataclass(annotation):
            groups[name] = annotation
            types |= inspect.get_annotations(annotation, eval_str=True)
            parameters += inspect.signature(annotation).parameters.values()
        else:
            types[name] = annotation
            parameters.append(parameter)

    @wraps(command)
    def run(**arguments: Any) -> int:
        grouped = {
            name: group(**{field: arguments.pop(field) for field in group.__dataclass_fields__})
            for name, group in groups.items()
        }
        return command(**grouped, **arguments)

    signature = [p.replace(kind=p.KEYWORD_ONLY, annotation=types[p.name]) for p in parameters]
    run.__signature__ = inspect.Signature(signature)  # type: ignore[attr-defined]
    run.__annotations__ = types
    return run
