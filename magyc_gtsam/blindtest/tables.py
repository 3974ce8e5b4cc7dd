"""Outcomes as tables: one line per effect and strength, gates, and a Markdown page with both."""

from __future__ import annotations

import csv
import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from magyc_gtsam.blindtest.gates import Gate, gates, missing
from magyc_gtsam.blindtest.scenarios import SETS
from magyc_gtsam.blindtest.scoring import OUTCOMES, WRONG, Outcome

GATE_HEADER = ("gate", "measured", "95 %", "cases", "asked", "")
_TITLES = {
    "none": "Nothing hidden",
    "single": "One effect",
    "pair": "Two effects",
    "withheld": "One effect, its channel withheld",
    "foreign": "An effect that is in no catalogue",
    "real": "One effect put into a real recording",
}


def gate_rows(measured: Sequence[Gate]) -> list[list[str]]:
    """One row per gate."""
    return [
        [
            gate.name,
            f"{100 * gate.share:.1f} %",
            f"{100 * gate.interval[0]:.1f} to {100 * gate.interval[1]:.1f}",
            f"{gate.count} of {gate.total}",
            f"{'≥' if gate.at_least else '≤'} {100 * gate.limit:.0f} %",
            "passed" if gate.passed else "FAILED",
        ]
        for gate in measured
    ]


def outcome_header(outcomes: Sequence[Outcome]) -> list[str]:
    """Of `outcome_rows`: only the kinds that there are."""
    kinds = {o.kind for o in outcomes}
    return ["hidden", "×", *(k for k in OUTCOMES if k in kinds), "wrong names"]


def outcome_rows(outcomes: Sequence[Outcome]) -> list[list[str]]:
    """One row per hidden effects and factor: how often each kind of outcome, and which wrong names."""
    kinds = outcome_header(outcomes)[2:-1]
    rows = []
    keys = {(o.scenario.label, o.scenario.factor) for o in outcomes}
    for name, factor in sorted(keys, key=lambda key: (-key[1], key[0])):
        own = [o for o in outcomes if (o.scenario.label, o.scenario.factor) == (name, factor)]
        count = Counter(o.kind for o in own)
        wrong = Counter(o.said for o in own if o.kind == WRONG)
        rows.append(
            [
                name,
                f"{factor:g}",
                *(f"{count[k]}" if count[k] else "·" for k in kinds),
                ", ".join(f"{said} {n}" if n > 1 else said for said, n in wrong.most_common()),
            ]
        )
    return rows


def write_tables(folder: Path, outcomes: Sequence[Outcome], title: str) -> list[Path]:
    """`outcomes.csv` with every recording, `report.md` with gates and tables."""
    rows = [
        [
            o.number,
            o.scenario.id,
            o.scenario.seed,
            o.kind,
            o.verdict,
            "; ".join(f"{n} ({', '.join(a)})" if a else n for n, a in o.named),
            *(f"{v:.4g}" for v in o.heading or ()),
        ]
        for o in outcomes
    ]
    listing = folder / "outcomes.csv"
    part = listing.with_suffix(".part")
    with open(part, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["number", "scenario", "seed", "kind", "verdict", "named", "heading before", "after"])
        writer.writerows(rows)
    os.replace(part, listing)
    page = folder / "report.md"
    page.write_text(markdown(outcomes, title), encoding="utf-8")
    return [listing, page]


def markdown(outcomes: Sequence[Outcome], title: str) -> str:
    """Gates, and outcomes set by set."""
    lines = [
        f"# {title}",
        "",
        f"{len(outcomes)} recordings.",
        "",
        *_table(GATE_HEADER, gate_rows(gates(outcomes))),
    ]
    short = missing(outcomes)
    if short:
        named = ", ".join(f"{name} {hit} of {runs}" for name, (hit, runs) in short.items())
        lines += ["", f"Named in less than 90 % of their runs at published strength: {named}."]
    for kind in SETS:
        own = [o for o in outcomes if o.scenario.set == kind]
        if own:
            lines += ["", f"## {_TITLES[kind]}", "", *_table(outcome_header(own), outcome_rows(own))]
    return "\n".join(lines) + "\n"


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rows)]
