"""The documentation builds without a broken link, and says what the code does."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.gap.effects import LABELS, TERMS

ROOT = Path(__file__).parents[1]


def test_readme_is_short() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.split()) <= 700
    for target in re.findall(r"\]\(([^)#]+)", text):
        assert (ROOT / target).exists(), target


def test_links_of_the_other_files_lead_somewhere() -> None:
    for name in ("SECURITY.md", "CONTRIBUTING.md"):
        for target in re.findall(r"\]\(([^)]+)\)", (ROOT / name).read_text(encoding="utf-8")):
            file, _, heading = target.partition("#")
            assert (ROOT / file).exists(), target
            assert not heading or heading in _headings(ROOT / file), target


def test_every_group_of_promises_has_its_measurements_in_the_same_order() -> None:
    page, measured = ROOT / "docs" / "reliability.md", ROOT / "docs" / "reliability_measured.md"
    text = page.read_text(encoding="utf-8")
    assert len(text.split()) <= 1300  # it is read to the end
    groups = re.findall(r"^\*\*\[.+\]\(reliability_measured\.md#([\w-]+)\)\*\*$", text, re.MULTILINE)
    assert len(groups) > 5
    assert _headings(measured) == ["how-it-is-counted", *groups, "not-promised"]


@pytest.mark.parametrize(("name", "most"), [("slam", 1700), ("online", 1600)])
def test_a_page_for_users_is_short_and_its_second_page_is_in_the_same_order(name: str, most: int) -> None:
    text = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    assert len(text.split()) <= most  # with the bars of its tables
    linked = dict.fromkeys(re.findall(rf"\({name}_measured\.md#([\w-]+)\)", text))
    assert list(linked) == _headings(ROOT / "docs" / f"{name}_measured.md")


def _headings(page: Path) -> list[str]:
    titles = re.findall(r"^## (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return [re.sub(r"[^\w]+", "-", title.lower()) for title in titles]


def test_the_documents_count_the_effects() -> None:
    for name in ("README.md", "CHANGELOG.md"):
        words = " ".join((ROOT / name).read_text(encoding="utf-8").split())
        counted = re.findall(r"catalogue of (\d+)|which of (\d+) effects", words)
        assert {int(a or b) for a, b in counted} == {len(LABELS)}, name


def test_every_benchmark_is_named_in_a_document() -> None:
    documents = [ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
    words = "\n".join(file.read_text(encoding="utf-8") for file in documents)
    files = [file.name for file in (ROOT / "benchmarks").glob("*.py")]
    assert len(files) > 20
    assert [name for name in files if f"benchmarks/{name}" not in words] == []


def test_the_site_builds_and_no_link_is_broken(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="pip install '.[docs]'")
    pytest.importorskip("mkdocstrings_handlers.python", reason="pip install '.[docs]'")
    command = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "--quiet",
        "--site-dir",
        str(tmp_path / "site"),
    ]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    commands = (tmp_path / "site" / "reference" / "command-line" / "index.html").read_text(encoding="utf-8")
    for name in ("calibrate", "online", "gap", "export"):
        assert f'id="{name}"' in commands
    assert "--magnetic-field" in commands
    effects = (tmp_path / "site" / "reference" / "effects" / "index.html").read_text(encoding="utf-8")
    assert all(f"<code>{name}</code>" in effects for name in TERMS)
    pictures = re.findall(
        r'<h3 id="([\w-]+)">.*?</h3>\s*<p>.*?</p>\s*<figure[^>]*><svg.*?</svg>', effects, re.DOTALL
    )
    assert pictures == list(LABELS)
    assert "angular_rate_is" in (tmp_path / "site" / "reference" / "api" / "index.html").read_text(
        encoding="utf-8"
    )


def test_the_schema_holds_for_what_is_saved(tmp_path: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads((ROOT / "docs" / "reference" / "calibration.schema.json").read_text(encoding="utf-8"))
    recording = mg.simulate("wide", 60).recording
    for method in ("smoother", "ellipsoid", "sar-ls"):
        mg.calibrate(recording, method).save(tmp_path / "cal.json")
        jsonschema.validate(json.loads((tmp_path / "cal.json").read_text(encoding="utf-8")), schema)
    keys = json.loads((tmp_path / "cal.json").read_text(encoding="utf-8")).keys()
    assert keys <= schema["properties"].keys()
    saved = mg.Calibration(np.eye(3), np.zeros(3)).to_dict()
    jsonschema.validate(saved, schema)
    wrong = [saved | {"soft_iron": [[1]]}]
    wrong += [{k: v for k, v in saved.items() if k != name} for name in schema["required"]]
    for values in wrong:
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(values, schema)
        with pytest.raises(mg.MagycError):
            mg.Calibration.from_dict(values)
