"""YAML and JSON files that hold a mapping: read with size limits, unique keys and no aliases, and written."""

from __future__ import annotations

import json
import os
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import yaml

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened

# Largest files, bytes. A calibration with its diagnostics takes some 100 kB. YAML parses at 6 s per MB, JSON at 0.02.
_LARGEST = {".json": 1 << 26}
_LARGEST_YAML = 1 << 21
_DEEPEST = 40  # levels of nested mappings and lists


def load_mapping(path: str | os.PathLike[str], what: str) -> dict[str, Any]:
    """Read the mapping in a JSON (.json) or YAML (any other suffix) file.

    Args:
        path: the file.
        what: the kind of file that is expected, for messages.

    Raises:
        MagycError: the file does not exist, is too large or cannot be parsed, or it holds a duplicate key, or an alias
            (which could expand beyond memory).
    """
    path = Path(path)
    kind = path.suffix.lower() or "YAML"
    try:
        largest = _LARGEST.get(kind, _LARGEST_YAML)
        if path.stat().st_size > largest:
            raise MagycError(
                f"{path}: has {path.stat().st_size} bytes, a {what} at most {largest}; is it the right file?"
            )
        text = path.read_text(encoding="utf-8")
        data = parse_json(text) if kind == ".json" else parse_yaml(text)
    except FileNotFoundError:
        raise MagycError(f"{path}: no such file") from None
    except OSError as error:
        raise MagycError(f"{path}: cannot be read ({error.strerror})") from None
    except MagycError as error:
        raise MagycError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
    except UnicodeDecodeError:
        raise MagycError(f"{path}: not a text file; a {what} as YAML or JSON is expected here") from None
    if not isinstance(data, dict):
        raise MagycError(f"{path}: not a {what}: expected a mapping of names to values")
    return data


def parse_json(text: str) -> Any:
    """Parse JSON.

    Raises:
        MagycError: the text is not JSON, or a mapping has a duplicate key.
    """

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        mapping = dict(pairs)
        if len(mapping) < len(pairs):
            names = [name for name, _ in pairs]
            raise _duplicate_key(next(name for name in names if names.count(name) > 1))
        return mapping

    try:
        return json.loads(text, object_pairs_hook=unique)
    except RecursionError:
        raise MagycError("not readable as JSON (nested without end)") from None
    except ValueError as error:
        raise MagycError(f"not readable as JSON ({shortened(error)})") from None


class _Loader(yaml.SafeLoader):
    """Loader of YAML that rejects aliases, duplicate keys and deep nesting."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a node; raise a MagycError for an alias or deep nesting before any object is built."""
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
        """Construct a mapping; raise a MagycError for a duplicate key."""
        seen: set[Hashable] = set()
        for key, _ in node.value:
            name = self.construct_object(key, deep=True)
            if not isinstance(name, Hashable):
                raise MagycError(f"the key {shortened(name)!r} is not a name")
            if name in seen:
                raise _duplicate_key(name)
            seen.add(name)
        return super().construct_mapping(node, deep)


def _duplicate_key(name: object) -> MagycError:
    return MagycError(f"the key {shortened(name)!r} occurs twice; remove one")


def parse_yaml(text: str, resolvers: Mapping[str, tuple[Any, list[str]]] | None = None) -> Any:
    """Parse YAML.

    Args:
        text: the document.
        resolvers: further implicit types: {tag: (pattern, first characters)}.

    Raises:
        MagycError: the text is not YAML, is nested too deeply, or has an alias or a duplicate key.
    """
    loader: type[_Loader] = type("_ExtendedLoader", (_Loader,), {}) if resolvers else _Loader
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
    """Dumper that writes an object again where it recurs, instead of an alias."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def dump_yaml(data: Mapping[str, Any]) -> str:
    """Return a mapping as YAML that `parse_yaml` reads."""
    text: str = yaml.dump(
        dict(data), Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True
    )
    return text
