"""What all pages have in common: the skeleton that their templates extend, figures, and writing them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from magyc_gtsam.recording import Recording
from magyc_gtsam.report import plots

_PACKAGE = "magyc_gtsam.report"


@dataclass(frozen=True)
class Figure:
    """A figure with its title and caption."""

    svg: Markup
    title: str
    caption: str = ""


def rendered(template: str, recording: Recording, **values: Any) -> str:
    """A page as HTML text, self-contained.

    Args:
        template: file name; extends base.html, which says what it needs of `values`.
        recording: what the page is about.
    """
    environment = Environment(
        loader=PackageLoader(_PACKAGE, "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    style = (resources.files(_PACKAGE) / "style.css").read_text(encoding="utf-8")
    colours = {"raw": plots.RAW, "calibrated": plots.CALIBRATED, "disturbed": plots.DISTURBED}
    return environment.get_template(template).render(
        recording=recording, style=Markup(style), colours=colours, **values
    )


def write_page(path: Path, text: str) -> None:
    """Write a page, in one step."""
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)
