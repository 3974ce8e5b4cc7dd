"""Mappings in YAML and JSON: read within limits, each key once, nothing that expands; and written."""

from __future__ import annotations

import json
import os
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import ArrayLike

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened

# Bytes of text; a calibration with all its diagnostics takes some hundred kB. YAML takes 6 s a megabyte, JSON 0.02 s.
_LARGEST = {".json": 1 << 26}
_LARGEST_YAML = 1 << 21
_DEEPEST = 40  # mappings and lists within each other


def load_mapping(path: str | os.PathLike[str], what: str) -> dict[str, Any]:
    """The mapping in a YAML or JSON (.json) file.

    Args:
        path: of the file.
        what: it should be, for error messages.

    Raises:
        MagycError: no such file, too large, not readable, a key that comes twice, or an alias (which could stand for
            more than fits into memory).
    """
    path = Path(path)
    kind = path.suffix or "YAML"
    try:
        largest = _LARGEST.get(kind, _LARGEST_YAML)
        if path.stat().st_size > largest:
            raise MagycError(
                f"{path}: {path.stat().st_size} bytes, at most {largest} are read; is it the right file?"
            )
        text = path.read_text(encoding="utf-8")
        data = parse_json(text) if kind == ".json" else parse_yaml(text)
    except FileNotFoundError:
        raise MagycError(f"{path}: no such file") from None
    except OSError as error:
        raise MagycError(f"{path}: cannot be read ({error.strerror})") from None
    except MagycError as error:
        raise MagycError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
    except UnicodeDecodeError as error:
        raise MagycError(f"{path}: not readable as {kind} ({shortened(error)})") from None
    if not isinstance(data, dict):
        raise MagycError(f"{path}: not a {what}, it holds no names with values")
    return data


def parse_json(text: str) -> Any:
    """JSON with each key once.

    Raises:
        MagycError: the text is not JSON, or has a key twice.
    """

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            names = [name for name, _ in pairs]
            twice = next(name for name in names if names.count(name) > 1)
            raise MagycError(f"the key {shortened(twice)!r} comes twice; which one is meant?")
        return found

    try:
        return json.loads(text, object_pairs_hook=unique)
    except RecursionError:
        raise MagycError("not readable as .json (nested without end)") from None
    except ValueError as error:
        raise MagycError(f"not readable as .json ({shortened(error)})") from None


class _Loader(yaml.SafeLoader):
    """YAML without aliases, with each key once, and not nested without end."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Refuse before anything is built."""
        if self.check_event(yaml.events.AliasEvent):
            raise MagycError(
                "holds an alias (*name), which could stand for more than fits into memory; write it out"
            )
        self._depth += 1
        if self._depth > _DEEPEST:
            raise MagycError(f"nested more than {_DEEPEST} deep")
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Hashable, Any]:
        """Refuse a key that comes twice."""
        seen: set[Hashable] = set()
        for key, _ in node.value:
            name = self.construct_object(key, deep=True)
            if not isinstance(name, Hashable):
                raise MagycError(f"the key {shortened(name)!r} is no name")
            if name in seen:
                raise MagycError(f"the key {shortened(name)!r} comes twice; which one is meant?")
            seen.add(name)
        return super().construct_mapping(node, deep)


def parse_yaml(text: str, resolvers: Mapping[str, tuple[Any, list[str]]] | None = None) -> Any:
    """YAML without aliases and with each key once.

    Args:
        resolvers: further implicit types: {tag: (pattern, first characters)}.

    Raises:
        MagycError: the text is not YAML, has an alias, or has a key twice.
    """
    loader: type[_Loader] = type("_Own", (_Loader,), {}) if resolvers else _Loader
    for tag, (pattern, first) in (resolvers or {}).items():
        loader.add_implicit_resolver(tag, pattern, first)
    try:
        return yaml.load(text, loader)
    except MagycError:
        raise
    except yaml.YAMLError as error:
        raise MagycError(f"not readable as .yaml ({shortened(error)})") from None
    except (RecursionError, ValueError, OverflowError, AttributeError, TypeError, LookupError) as error:
        raise MagycError(f"not readable as .yaml ({type(error).__name__}: {shortened(error)})") from None


class _Dumper(yaml.SafeDumper):
    """What is held twice is written twice: no aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def dump_yaml(data: Mapping[str, Any]) -> str:
    """YAML that `parse_yaml` reads."""
    text: str = yaml.dump(
        dict(data), Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True
    )
    return text


def numbers(name: str, value: ArrayLike) -> np.ndarray[Any, np.dtype[np.float64]]:
    """An array of what is numbers, and neither text nor true and false.

    Raises:
        MagycError: it is something else.
    """
    try:
        array = np.array(value)
        if array.dtype.kind not in "iuf" or _holds_booleans(value):
            raise TypeError
        return array.astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        raise MagycError(f"{name} must be numbers, got {shortened(value)}") from None


def _holds_booleans(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return any(map(_holds_booleans, value))
    return isinstance(value, bool | np.bool_)
