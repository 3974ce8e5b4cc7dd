"""The table of folders in docs/architecture.md is that of the sources. Run as a script, this writes it."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "architecture.md"
MARKED = re.compile(r"(?<=<!-- folders -->\n).*(?=<!-- end of folders -->)", re.DOTALL)


def table() -> str:
    """One row for each package: folder, and the first sentence of its docstring."""
    rows = ["", "| folder | what |", "|---|---|"]
    packages = [ROOT / "factors", ROOT / "magyc_gtsam"]
    for package in packages:
        for file in sorted(package.rglob("__init__.py")):
            folder = file.parent.relative_to(ROOT)
            if folder.parts[:2] == ("magyc_gtsam", "factors"):  # the link
                continue
            said = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
            paragraph = " ".join(said.split("\n\n")[0].split())
            rows.append(f"| `{folder.as_posix()}/` | {paragraph} |")
    return "\n".join([*rows, "", ""])


def test_the_table_of_folders_is_up_to_date() -> None:
    found = MARKED.search(PAGE.read_text(encoding="utf-8"))
    assert found
    assert found[0] == table(), "run: python tests/test_architecture.py"


def test_a_file_holds_one_idea_in_at_most_300_lines() -> None:
    files = [file for package in ("factors", "magyc_gtsam") for file in (ROOT / package).rglob("*.py")]
    lengths = {str(file): len(file.read_text(encoding="utf-8").splitlines()) for file in files}
    assert len(lengths) > 400
    assert {name: length for name, length in lengths.items() if length > 300} == {}


def test_every_package_says_what_it_is() -> None:
    assert all(not row.endswith("|  |") for row in table().splitlines())


def test_files_that_the_page_names_are_there() -> None:
    text = MARKED.sub("", PAGE.read_text(encoding="utf-8"))
    named = {name for name in re.findall(r"`([\w./]+/|[\w/]+\.(?:py|toml|md))`", text) if "<" not in name}
    assert len(named) > 20
    missing = [name for name in named if not any((ROOT / place / name).exists() for place in ("", "magyc_gtsam"))]
    assert missing == []


if __name__ == "__main__":
    PAGE.write_text(MARKED.sub(lambda _: table(), PAGE.read_text(encoding="utf-8")), encoding="utf-8")
