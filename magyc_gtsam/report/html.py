"""Rendering of the templates of all pages, which extend base.html."""

from __future__ import annotations

import re
from importlib import resources
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from magyc_gtsam.foreign_text import with_minus
from magyc_gtsam.option_names import as_options
from magyc_gtsam.recording import Recording

_PACKAGE = "magyc_gtsam.report"
_SCRIPTS = ("uplot/uPlot.iife.min.js", "charts.js", "sphere.js", "page.js")
_STYLES = ("uplot/uPlot.min.css", "style.css")


def rendered(template: str, recording: Recording | None = None, **values: Any) -> str:
    """Return a page as self-contained HTML text.

    Args:
        template: file name of the template; it extends base.html, which lists the values it needs.
        recording: the recording that the page is about; None for a page about many.
        values: values for the template.
    """
    environment = Environment(
        loader=PackageLoader(_PACKAGE, "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
        finalize=lambda value: as_options(value) if type(value) is str else value,
    )
    environment.filters |= {"minus": with_minus, "sentence": _sentence}
    style, script = (Markup("\n".join(map(_text, names))) for names in (_STYLES, _SCRIPTS))
    return environment.get_template(template).render(recording=recording, style=style, script=script, **values)


def _sentence(text: str) -> Markup:
    """Return text as HTML with arguments as options, real minus signs, and text between backticks as code."""
    return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", str(escape(with_minus(as_options(text))))))


def _text(name: str) -> str:
    return (resources.files(_PACKAGE) / name).read_text(encoding="utf-8")
