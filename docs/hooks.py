"""What the documentation takes from the code when it is built: the command line, and the catalogue of effects."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable
from typing import Any

# Examples and data sets stand beside docs/ in the repository, and are no pages.
_OUTSIDE = re.compile(
    r"\[([^\]]*)\]\((?:\.\./)+(?:examples|datasets|README|benchmarks|CHANGELOG|factors|tests)[^)]*\)"
)


_COLOURS = ("#2b8cdb", "#1f9e89", "#d9730d")
_SECONDS = {"tone": 10, "quantisation": 10, "sample-hold": 10}  # of those that are fast; else all
_METADATA = ("Creator", "Date", "Format", "Type")


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

    from magyc_gtsam.cli.app import application

    group: Any = typer.main.get_command(application())
    context = group.make_context("magyc-gtsam", ["--version"], resilient_parsing=True)
    parts = []
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        inner = command.make_context(name, [], parent=context, resilient_parsing=True)
        parts.append(f"## {name}\n\n```text\n{command.get_help(inner)}\n```\n")
    return "\n".join(parts)


def _effects() -> str:
    from magyc_gtsam.gap.effects import LABELS, PHYSICS, TERMS

    rows = [
        f"| [`{name}`](#{name}) | {term.label} | {term.unit} | {term.motion} |" for name, term in TERMS.items()
    ]
    parts = ["| name | what | unit | shown by |", "|---|---|---|---|", *rows, ""]
    for name, picture in _pictures(LABELS).items():
        label = LABELS[name]
        rivals = ", ".join(f"[`{other}`](#{other})" for other in TERMS[name].rivals) if name in TERMS else ""
        parts += [f"### {label[0].upper()}{label[1:]} {{ #{name} }}", "", f"`{name}`", "", PHYSICS[name], ""]
        parts += [f"Confused with {rivals}.", ""] if rivals else []
        parts += [picture, ""]
    return "\n".join(parts)


def _pictures(names: Iterable[str]) -> dict[str, str]:
    """{name: figure} of what each effect adds to the same simulated recording."""
    from magyc_gtsam.simulation import simulate
    from magyc_gtsam.simulation.environment import CHANNELS

    def simulated(*effects: str) -> Any:
        return simulate("wide", 120, seed=1, channels=CHANNELS, effects=effects).recording

    plain = simulated()
    return {name: _picture(name, plain, simulated(name)) for name in names}


def _picture(name: str, plain: Any, spoilt: Any) -> str:
    import matplotlib
    import numpy as np
    from matplotlib.figure import Figure

    field, rate = (getattr(spoilt, each) - getattr(plain, each) for each in ("magnetic_field", "angular_rate"))
    on_rate = np.abs(rate).max() > 0
    added, label = (rate * 1e3, "angular rate (mrad/s)") if on_rate else (field * 1e6, "field (µT)")
    shown = plain.time < _SECONDS.get(name, 120)
    # Ids that differ between pictures and stay the same from build to build.
    with matplotlib.rc_context({"svg.hashsalt": name, "svg.fonttype": "none", "path.simplify_threshold": 0.5}):
        figure = Figure(figsize=(7.2, 2.3))  # not laid out, which would draw it twice
        axes = figure.add_axes((0.14, 0.2, 0.845, 0.69))
        for axis, colour, values in zip("xyz", _COLOURS, added[shown].T, strict=True):
            axes.plot(plain.time[shown], values, color=colour, linewidth=1, label=axis)
        axes.set(xlabel="Time (s)", ylabel=f"Added to the\n{label}", xlim=(0, plain.time[shown][-1]))
        axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, frameon=False, fontsize=8, borderpad=0)
        axes.spines[["top", "right"]].set_visible(False)
        text = io.StringIO()
        figure.savefig(text, format="svg", transparent=True, metadata=dict.fromkeys(_METADATA))
    svg = text.getvalue()
    svg = " ".join(svg[svg.index("<svg") :].split())
    svg = svg.replace("#000000", "currentColor").replace("<text ", '<text fill="currentColor" ')
    return f"<figure>{svg}</figure>"
