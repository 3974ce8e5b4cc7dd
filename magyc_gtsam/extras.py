"""Imports of packages that only an extra of this project installs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from magyc_gtsam.factors.errors import MagycError


@contextmanager
def needs(what: str, package: str, extra: str) -> Iterator[None]:
    """Raise an explanatory error for `what` if the import of `package` in the block fails.

    Raises:
        MagycError: instead of the ImportError.
    """
    try:
        yield
    except ImportError:
        raise MagycError(f"{what}: needs {package}: pip install 'magyc-gtsam[{extra}]'") from None
