"""Lazy import of a package's names, with an explanatory error where GTSAM is needed but not installed."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from magyc_gtsam.factors.errors import MagycError


@contextmanager
def requires_gtsam(what: str) -> Iterator[None]:
    """Raise an explanatory error for `what` if an import in the block fails because GTSAM is not installed.

    Raises:
        MagycError: instead of the `ModuleNotFoundError` of gtsam; those of other modules pass through.
    """
    try:
        yield
    except ModuleNotFoundError as missing:
        if missing.name is None or missing.name.split(".")[0] != "gtsam":
            raise
        raise MagycError(
            f"{what}: needs GTSAM, which is not installed; pip install 'gtsam>=4.3' has wheels for Linux "
            "(x86-64, aarch64) and macOS (arm64) with Python 3.11 or later"
        ) from None


def attribute(package: str, public: Mapping[str, str], name: str) -> Any:
    """Return an attribute of a package, as its module-level `__getattr__`.

    Args:
        package: its `__name__`.
        public: {name: module inside the package that holds it}.
        name: the requested name.

    Raises:
        AttributeError: the package has no such name.
        MagycError: it needs GTSAM, which is not installed.
    """
    if name not in public:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    with requires_gtsam(f"{package}.{name}"):
        module = importlib.import_module(f"{package}.{public[name]}")
    return getattr(module, name)
