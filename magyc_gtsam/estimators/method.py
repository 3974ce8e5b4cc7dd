"""An entry of the registry of methods, and those of other packages.

These are registered as entry points of the group `magyc_gtsam.methods`, each of which names a `Method` whose `function`
is in that package::

    [project.entry-points."magyc_gtsam.methods"]
    mine = "my_package.method:METHOD"
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import EntryPoint, entry_points


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


GROUP = "magyc_gtsam.methods"


def methods_from_outside(taken: Container[str]) -> dict[str, Method]:
    """Return {name: method} of all installed packages; `problem` says why a method could not be loaded.

    Args:
        taken: names of this package's methods; an outside method of such a name is registered as "package:name".
    """
    found = {}
    for point in _points():
        package = "unknown" if point.dist is None else point.dist.name
        name = f"{package}:{point.name}" if point.name in taken or point.name in found else point.name
        found[name] = _loaded(point, package)
    return found


@cache
def _points() -> tuple[EntryPoint, ...]:
    return tuple(entry_points(group=GROUP))


@cache
def _loaded(point: EntryPoint, package: str) -> Method:
    broken = Method(f"of package {package}", "", (), point.value)
    try:
        method = point.load()
    except Exception as error:  # noqa: BLE001 - a defect of another package is reported when its method is requested
        said = f"package {package} cannot be loaded ({type(error).__name__}: {error}); update or remove it"
        return replace(broken, problem=said)
    if not isinstance(method, Method):
        said = f"package {package}: its entry point {point.value} must be a magyc_gtsam.Method"
        return replace(broken, problem=said)
    return method
