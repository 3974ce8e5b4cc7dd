"""Imports go down only, the factors stand on gtsam, numpy and scipy alone, and no two types share a name."""

from __future__ import annotations

import ast
import functools
import os
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
from structure import circle, sources

ROOT = Path(__file__).parents[1]
CORE = ("chain", "effects")  # of factors/: their modules but `effects/factor.py` need no GTSAM


def test_layers() -> None:
    """The contract in pyproject.toml."""
    pytest.importorskip("importlinter")
    command = "import sys; from importlinter.cli import lint_imports_command; sys.exit(lint_imports_command())"
    result = subprocess.run(
        [sys.executable, "-c", command, "--no-cache"],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert " kept, 0 broken" in result.stdout


FILES = sorted((ROOT / "factors").rglob("*.py"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(ROOT / "factors")))
def test_factors_need_no_more_than_gtsam_numpy_scipy_and_threadpoolctl(file: Path) -> None:
    allowed = {"numpy", "scipy", "threadpoolctl", *sys.stdlib_module_names}
    if file.parent.name not in CORE or file.name == "factor.py":
        allowed.add("gtsam")
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: relative import"
            modules = [node.module or ""]
        elif isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        else:
            continue
        for module in modules:
            own = module == "magyc_gtsam.factors" or module.startswith("magyc_gtsam.factors.")
            assert own or module.split(".")[0] in allowed, f"line {node.lineno}: {module}"


@functools.cache
def modules() -> dict[str, ast.Module]:
    """All modules of the package, parsed."""
    return sources()


def parsed(file: Path) -> ast.Module:
    name = ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    return modules()[name if name.startswith("magyc_gtsam") else f"magyc_gtsam.{name}"]


OWN = [file for file in (ROOT / "magyc_gtsam").rglob("*.py") if file.relative_to(ROOT).parts[1] != "factors"]


def test_a_fault_of_a_sensor_has_one_detector() -> None:
    """`SensorFaults` makes each. Online asks it itself, the batch and the gap through `without_faults`."""
    detectors = {
        "StuckAxes": "an axis that stands still",
        "Repeats": "a magnetometer that repeats its samples",
        "Zeros": "zeros in place of a field",
        "ZeroRates": "zeros in place of a rate",
        "Spikes": "single samples that stand out of all motion",
        "CutOff": "turns beyond the gyroscope's full scale",
        "FullScale": "a field beyond the magnetometer's full scale",
        "StuckBits": "a bit of the magnetometer that always reads the same, or fails",
    }
    parts = {"LargestValue"}  # of `CutOff`, one for each side of each axis
    called: dict[str, set[str]] = {}
    observing = set()
    for file in OWN:
        tree, place = parsed(file), file.relative_to(ROOT / "magyc_gtsam").as_posix()
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                called.setdefault(node.func.id, set()).add(place)
        if place.startswith("sensor_faults/"):
            observing |= {
                node.name
                for node in tree.body
                if isinstance(node, ast.ClassDef)
                and not any("Protocol" in ast.unparse(base) for base in node.bases)
                and "observe" in {part.name for part in node.body if isinstance(part, ast.FunctionDef)}
            }
    assert observing == detectors.keys() | parts
    assert all(called[name] == {"sensor_faults/faults.py"} for name in detectors)
    assert called["SensorFaults"] == {"online/calibrator.py"}
    assert called["without_faults"] == {
        "estimators/__init__.py",
        "gap/prepared.py",
        "gap/validation.py",
    }


def test_a_type_has_its_name_for_itself() -> None:
    where: dict[str, list[str]] = {}
    for file in [*OWN, *FILES]:
        for node in parsed(file).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                where.setdefault(node.name, []).append(str(file.relative_to(ROOT)))
    assert len(where) > 200
    assert {name: files for name, files in where.items() if len(files) > 1} == {}


def test_no_module_imports_itself_by_way_of_others() -> None:
    """Imports in functions and for types count too."""
    assert len(modules()) > 300
    assert circle(modules()) == []
    looped = {name: ast.parse(f"def late():\n    import {other}") for name, other in (("a", "b"), ("b", "a"))}
    assert set(circle(looped)) == {"a", "b"}
