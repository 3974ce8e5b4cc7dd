"""Imports go down only, and the factors stand on gtsam, numpy and scipy alone."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def test_layers(tmp_path: Path) -> None:
    """The contract in pyproject.toml, on a tree in which the factors lie where they are imported from."""
    pytest.importorskip("importlinter")
    unwanted = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "magyc_gtsam", tmp_path / "magyc_gtsam", ignore=unwanted)
    shutil.copytree(ROOT / "factors", tmp_path / "magyc_gtsam" / "factors", ignore=unwanted)
    command = "import sys; from importlinter.cli import lint_imports_command; sys.exit(lint_imports_command())"
    result = subprocess.run(
        [sys.executable, "-c", command, "--config", str(ROOT / "pyproject.toml"), "--no-cache"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert "2 kept, 0 broken" in result.stdout


@pytest.mark.parametrize("file", sorted((ROOT / "factors").glob("*.py")), ids=lambda file: file.stem)
def test_factors_need_no_more_than_gtsam_numpy_and_scipy(file: Path) -> None:
    allowed = {"gtsam", "numpy", "scipy", *sys.stdlib_module_names}
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
