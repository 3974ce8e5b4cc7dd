"""Imports go down only, and the factors stand on gtsam, numpy and scipy alone."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

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
def test_factors_need_no_more_than_gtsam_numpy_and_scipy(file: Path) -> None:
    allowed = {"numpy", "scipy", *sys.stdlib_module_names}
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
