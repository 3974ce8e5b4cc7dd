"""What is shipped: the wheel, the installed package, and the README's own words."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from importlib.metadata import version
from pathlib import Path

import jinja2
import pytest
import yaml

import magyc_gtsam as mg
from magyc_gtsam import cli

ROOT = Path(__file__).parents[1]


def _checkout(folder: Path) -> Path:
    """A copy of the sources without what was built in them."""
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder)
    for name in ("magyc_gtsam", "factors", "datasets"):
        shutil.copytree(
            ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "*.so"), symlinks=True
        )
    return folder


def _build(source: Path, target: Path, **environment: str) -> Path:
    """The wheel, as `pip install .` builds it."""
    if int(version("setuptools").split(".")[0]) < 77:
        pytest.skip("setuptools 77 or newer builds the wheel; it comes with pip install '.[test]'")
    build = f"import setuptools.build_meta as b; b.build_wheel({str(target)!r})"
    result = subprocess.run(
        [sys.executable, "-c", build], cwd=source, env=os.environ | environment, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    return next(target.glob("*.whl"))


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _checkout(tmp_path_factory.mktemp("source"))


@pytest.fixture(scope="module")
def wheel(checkout: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _build(checkout, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def installation(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel as `pip install` lays it out; not editable."""
    folder = tmp_path_factory.mktemp("installation")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--target"]
    result = subprocess.run([*command, str(folder), str(wheel)], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return folder


def _where(folder: Path, **environment: str) -> list[str]:
    """Where `magyc_gtsam.factors` comes from, and whether there is a top-level `factors`."""
    code = (
        "import importlib.util, magyc_gtsam.factors as f; "
        "print(f.__file__); print(importlib.util.find_spec('factors'))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env=os.environ | environment,
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.split()


def test_every_folder_of_code_is_a_package_that_is_shipped() -> None:
    """What is not listed in pyproject.toml imports in a checkout, and is missing in an installation."""
    tomllib = pytest.importorskip("tomllib", reason="Python 3.11")
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["packages"]
    own = {file.parent.relative_to(ROOT) for file in (ROOT / "magyc_gtsam").rglob("*.py")}
    factors = {Path("magyc_gtsam") / file.parent.relative_to(ROOT) for file in (ROOT / "factors").rglob("*.py")}
    assert listed == sorted(".".join(folder.parts) for folder in own | factors)


def test_wheel_holds_every_file_in_its_place(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    sources = {f"magyc_gtsam/{p.relative_to(ROOT / 'magyc_gtsam')}" for p in _files("magyc_gtsam")}
    factors = {f"magyc_gtsam/factors/{p.relative_to(ROOT / 'factors')}" for p in _files("factors")}
    assert len(factors) > 5
    compiled = {name for name in names if re.fullmatch(r"magyc_gtsam/factors/chain/_loops\..*(so|pyd)", name)}
    assert sources | factors == {name for name in names - compiled if ".dist-info/" not in name}
    assert bool(compiled) == (shutil.which("cc") is not None)
    assert any(name.endswith("licenses/LICENSE") for name in names)


def _files(folder: str) -> list[Path]:
    """The files of a folder, without C, which is shipped compiled."""
    every = (p for p in (ROOT / folder).rglob("*") if p.is_file() and "__pycache__" not in p.parts)
    return [p for p in every if p.suffix not in (".c", ".h", ".so")]


def test_wheel_where_links_are_not_to_be_had(wheel: Path, tmp_path: Path) -> None:
    """git writes a link as a file with its target in it there; nor is there a compiler, and so no compiled loops."""
    (tmp_path / "source").mkdir()
    source = _checkout(tmp_path / "source")
    (source / "magyc_gtsam" / "factors").unlink()
    (source / "magyc_gtsam" / "factors").write_text("../factors")
    other = _build(source, tmp_path, CC="false")
    files, expected = (
        {name for name in zipfile.ZipFile(each).namelist() if not name.endswith((".so", ".pyd"))}
        for each in (other, wheel)
    )
    assert "magyc_gtsam/factors/chain/_loops.c" not in files
    assert files == expected


def test_factors_of_an_installation(installation: Path, tmp_path: Path) -> None:
    found, top_level = _where(tmp_path, PYTHONPATH=str(installation))
    assert Path(found) == installation / "magyc_gtsam" / "factors" / "__init__.py"
    assert top_level == "None"


def test_factors_of_this_installation(tmp_path: Path) -> None:
    found, top_level = _where(tmp_path, PYTHONPATH="")
    assert Path(found).parent.name == "factors"
    assert top_level == "None"


def test_one_version() -> None:
    assert version("magyc-gtsam") == mg.__version__
    assert f"## [{mg.__version__}]" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"version: {mg.__version__}" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_documentation_names_the_methods() -> None:
    section = (ROOT / "docs" / "reference" / "methods.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `([a-z0-9-]+)` \|", section, re.MULTILINE)) == set(mg.methods())


@pytest.mark.parametrize("where", ["in the checkout", "elsewhere"])
def test_readme_example_runs(where: str, checkout: Path, installation: Path, tmp_path: Path) -> None:
    """After `pip install .`: Python started in the checkout imports its folders, elsewhere the installation."""
    example = re.search(r"```python\n(.*?)```", _readme(), re.DOTALL)
    assert example
    folder = checkout
    if where == "elsewhere":
        folder = tmp_path
        shutil.copytree(ROOT / "datasets", tmp_path / "datasets")
    result = subprocess.run(
        [sys.executable, "-c", example[1] + "\nprint(mg.__file__)"],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(installation)},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    expected = checkout if where == "in the checkout" else installation
    assert Path(result.stdout.splitlines()[-1]).resolve() == expected.resolve() / "magyc_gtsam" / "__init__.py"
    assert (folder / "cal.yaml").exists()


def test_readme_marks_the_commands_of_the_integration_run() -> None:
    marked = re.findall(r"<!-- ci -->\n```bash\n(.*?)```", _readme(), re.DOTALL)
    assert len(marked) == 2
    assert "pip install ." in marked[0]
    assert "pytest" in marked[1]


def test_readme_shows_what_the_first_command_prints(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = ROOT / "datasets" / "calibration_dive.mcap"
    assert cli.main(["calibrate", str(log), "--output", str(tmp_path / "out")]) == 0
    shown = re.search(r"calibration_dive\.mcap\n```\n\n```\n(.*?)\n…", _readme(), re.DOTALL)
    assert shown is not None
    words = shown[1].split()
    assert len(words) > 50
    assert capsys.readouterr().out.split()[: len(words)] == words


def _readme() -> str:
    return (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_oldest_dependencies_tested_are_the_lower_bounds() -> None:
    """And the container's list names every one of them."""
    text = (ROOT / "pyproject.toml").read_text("utf-8")
    listed = text.split("\ndependencies = [")[1].split("\n]")[0]
    bounds = dict(re.findall(r'^ *"([\w-]+)>=([\d.]+)', listed, re.MULTILINE))
    pins = {
        name: dict(re.findall(r"^([\w.-]+)==(\S+)$", (ROOT / ".ci" / name).read_text("utf-8"), re.MULTILINE))
        for name in ("oldest.txt", "container.txt")
    }
    assert len(bounds) > 10
    assert pins["oldest.txt"].keys() == bounds.keys()
    for name, bound in bounds.items():
        assert pins["oldest.txt"][name].split(".")[: len(bound.split("."))] == bound.split(".")
    assert bounds.keys() <= pins["container.txt"].keys()


def test_the_conda_recipe_asks_for_what_the_project_does() -> None:
    """All but what is not on conda-forge, which the recipe names, and GTSAM, which graphs alone need."""
    text = (ROOT / "conda" / "meta.yaml").read_text(encoding="utf-8")
    recipe = yaml.safe_load(jinja2.Template(text).render(PYTHON="python", compiler="{}-compiler".format))
    assert recipe["package"]["version"] == mg.__version__
    asked = {
        line.replace(" ", "").replace("matplotlib-base", "matplotlib") for line in recipe["requirements"]["run"]
    }
    tomllib = pytest.importorskip("tomllib", reason="Python 3.11")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    absent = re.search(r"Not on conda-forge: pip install ([\w -]+)", text)
    assert absent is not None
    left_out = {"gtsam", *absent[1].split()}
    needed = {each for each in project["dependencies"] if re.split(r"[><=;]", each)[0] not in left_out}
    assert asked == {*needed, f"python{project['requires-python']}"}


def test_the_container_is_made_of_what_there_is() -> None:
    """Its extras and command are the project's, its list of versions is in the image and names what the extras need."""
    tomllib = pytest.importorskip("tomllib", reason="Python 3.11")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = (ROOT / "Dockerfile").read_text(encoding="utf-8").splitlines()
    steps = [tuple(line.split(" ", 1)) for line in lines if line and not line.startswith("#")]
    second = steps.index(("FROM", "python:3.12-slim"))
    # The wheel is built where there is a compiler, by the same version of Python.
    assert steps[:second] == [
        ("FROM", "python:3.12 AS wheel"),
        ("COPY", ". /src"),
        ("RUN", "pip wheel --no-cache-dir --no-deps -w /wheel /src"),
    ]
    assert int(project["requires-python"].removeprefix(">=3.")) <= 12
    (copied, listed), made = steps[second + 1 : second + 3], dict(steps[second + 3 :])
    assert list(made) == ["RUN", "WORKDIR", "ENTRYPOINT", "CMD"]
    assert copied == ("COPY", "--from=wheel /wheel /wheel")
    installed = re.search(r'-c /wheel/(\S+) "\$\(ls /wheel/\*\.whl\)\[([\w,]+)\]"', made["RUN"])
    assert installed is not None
    assert listed == ("COPY", f".ci/{installed[1]} /wheel/")
    pins = f".ci/{installed[1]}"
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    assert not any(pins.startswith(pattern.rstrip("/")) for pattern in ignored if pattern)
    pinned = set(re.findall(r"^([\w.-]+)==", (ROOT / pins).read_text(encoding="utf-8"), re.MULTILINE))
    for extra in installed[2].split(","):
        needed = {re.split(r"[\[><=;!]", each)[0] for each in project["optional-dependencies"][extra]}
        assert needed <= pinned, extra
    assert list(json.loads(made["ENTRYPOINT"])) == list(project["scripts"])
