"""Count lines, files, import circles, integrations of the gyroscope and fault detectors of this checkout."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
LONG = 300  # lines of a file that holds one idea
DEFINED = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def sources() -> dict[str, ast.Module]:
    """Return {module: its syntax tree}."""
    found = {}
    for file in [*(ROOT / "magyc_gtsam").rglob("*.py"), *(ROOT / "factors").rglob("*.py")]:
        parts = file.relative_to(ROOT).with_suffix("").parts
        if parts[:2] != ("magyc_gtsam", "factors"):  # the link
            name = ".".join(parts if parts[0] == "magyc_gtsam" else ("magyc_gtsam", *parts))
            found[name.removesuffix(".__init__")] = ast.parse(file.read_text(encoding="utf-8"), filename=str(file))
    return found


def imported(tree: ast.Module, modules: Mapping[str, ast.Module]) -> set[str]:
    """Return the modules that a module imports anywhere, in functions and for types too."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return modules.keys() & {name if name in modules else name.rpartition(".")[0] for name in names}


def circle(modules: Mapping[str, ast.Module]) -> list[str]:
    """Return the modules of an import circle; empty if there is none."""
    try:
        TopologicalSorter({name: imported(tree, modules) - {name} for name, tree in modules.items()}).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def callers(modules: Mapping[str, ast.Module], function: str) -> list[str]:
    """Return the modules that call a function or a class."""
    return [
        name
        for name, tree in modules.items()
        if any(isinstance(n, ast.Call) and getattr(n.func, "id", "") == function for n in ast.walk(tree))
    ]


def docstring_lines(tree: ast.Module) -> int:
    """Return the number of lines in docstrings."""
    texts = [node.body[0] for node in ast.walk(tree) if isinstance(node, DEFINED) and ast.get_docstring(node)]
    return sum((text.end_lineno or 0) - text.lineno + 1 for text in texts)


def main() -> None:
    modules = sources()
    files = {
        file.resolve(): file.read_text(encoding="utf-8").splitlines() for file in ROOT.glob("factors/**/*.py")
    }
    files |= {file.resolve(): file.read_text("utf-8").splitlines() for file in ROOT.glob("magyc_gtsam/**/*.py")}
    lines = sum(map(len, files.values()))
    blank = sum(not line.strip() for text in files.values() for line in text)
    folders = Counter(file.parent.relative_to(ROOT).as_posix() for file in files)
    detectors = [
        node.name
        for name, tree in modules.items()
        if name.startswith("magyc_gtsam.sensor_faults.")
        for node in tree.body
        if isinstance(node, ast.ClassDef)
        and not any("Protocol" in ast.unparse(base) for base in node.bases)
        and "observe" in {part.name for part in node.body if isinstance(part, ast.FunctionDef)}
    ]
    print(f"lines: {lines}, of them in docstrings {sum(map(docstring_lines, modules.values()))}, blank {blank}")
    print(f"files: {len(files)}, longer than {LONG} lines: {sum(len(text) > LONG for text in files.values())}")
    print("files per folder:", ", ".join(f"{folder} {count}" for folder, count in folders.most_common()))
    print("import circle:", " → ".join(circle(modules)) or "none")
    print("modules that integrate angular rates:", ", ".join(callers(modules, "increments")))
    for detector in sorted(detectors):
        print(f"fault detector {detector}: made in", ", ".join(callers(modules, detector)))


if __name__ == "__main__":
    main()
