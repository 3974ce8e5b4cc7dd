"""What the documentation takes from the code when it is built: the command line, and the catalogue of effects."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

# Examples and data sets stand beside docs/ in the repository, and are no pages.
_OUTSIDE = re.compile(
    r"\[([^\]]*)\]\((?:\.\./)+(?:examples|datasets|README|benchmarks|CHANGELOG|factors|tests)[^)]*\)"
)


_EXPLANATIONS = {  # each a page of its own part of the code
    "gap.md": "How an effect is named",
    "reliability.md": "How far to trust it",
    "architecture.md": "Architecture",
}


def on_config(config: Any) -> Any:
    """The explanations that are there."""
    pages = next(section["Explanation"] for section in config.nav if "Explanation" in section)
    there = [name for name in _EXPLANATIONS if (Path(config.docs_dir) / name).exists()]
    listed = {path for page in pages for path in page.values()}
    pages += [{_EXPLANATIONS[name]: name} for name in there if name not in listed]
    return config


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Fill in what is generated, and keep links within the site."""
    if "<!-- commands -->" in markdown:
        markdown = markdown.replace("<!-- commands -->", _commands())
    if "<!-- effects -->" in markdown:
        markdown = markdown.replace("<!-- effects -->", _effects())
    markdown = markdown.replace("[, ", r"\[, ")  # an optional key of a factor, and no reference
    return _OUTSIDE.sub(r"\1", markdown)


def _commands() -> str:
    import typer

    from magyc_gtsam.cli.app import app

    group: Any = typer.main.get_command(app)
    context = group.make_context("magyc-gtsam", ["--version"], resilient_parsing=True)
    parts = []
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        inner = command.make_context(name, [], parent=context, resilient_parsing=True)
        parts.append(f"## {name}\n\n```text\n{command.get_help(inner)}\n```\n")
    return "\n".join(parts)


def _effects() -> str:
    from magyc_gtsam.gap.effects import TERMS

    rows = [f"| `{name}` | {term.label} | {term.unit} | {term.motion} |" for name, term in TERMS.items()]
    return "\n".join(["| name | what | unit | shown by |", "|---|---|---|---|", *rows])
