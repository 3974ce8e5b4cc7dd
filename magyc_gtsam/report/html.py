"""What all pages have in common: the skeleton that their templates extend, and writing them."""

from __future__ import annotations

import re
from importlib import resources
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from magyc_gtsam.foreign_text import with_minus
from magyc_gtsam.recording import Recording

_PACKAGE = "magyc_gtsam.report"
_SCRIPTS = ("uplot/uPlot.iife.min.js", "charts.js", "sphere.js", "page.js")
_STYLES = ("uplot/uPlot.min.css", "style.css")


def rendered(template: str, recording: Recording | None = None, **values: Any) -> str:
    """A page as HTML text, self-contained.

    Args:
        template: file name; extends base.html, which says what it needs of `values`.
        recording: what the page is about; None where it is about many.
        values: for the template.
    """
    environment = Environment(
        loader=PackageLoader(_PACKAGE, "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters |= {"minus": with_minus, "sentence": _sentence}
    style, script = (Markup("\n".join(map(_text, names))) for names in (_STYLES, _SCRIPTS))
    return environment.get_template(template).render(recording=recording, style=style, script=script, **values)


def _sentence(text: str) -> Markup:
    """Words as HTML: real minus signs, and what stands between backticks as code."""
    return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", escape(with_minus(text))))


def _text(name: str) -> str:
    return (resources.files(_PACKAGE) / name).read_text(encoding="utf-8")
