"""Tables of outcomes: one row per effect and strength, gates, and a Markdown page with both."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from magyc_gtsam.blindtest.detectability import seen_by_a_perfect_test
from magyc_gtsam.blindtest.gates import Gate, gates, missing
from magyc_gtsam.blindtest.reliability import RELIABILITY_HEADER, reliability_rows, scores
from magyc_gtsam.blindtest.scenarios import SETS
from magyc_gtsam.blindtest.scoring import IN_SET, OUTCOMES, REFUSED, RIGHT, SILENT, UNKNOWN, WRONG, Outcome
from magyc_gtsam.storage.files import whole_file

_STANDING = (0.0, 4.0, 5.0, 6.0, 8.0, 12.0, 20.0, np.inf)  # sigmas
_SAID = {RIGHT: "named", IN_SET: "named", REFUSED: SILENT}
STANDING_HEADER = ("σ", "recordings", "named", "wrong", "UNKNOWN", "silent", "a perfect test would see")
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
    """Return one row per gate."""
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
    """Return the header of `outcome_rows`, with the kinds of outcome that occur."""
    kinds = {o.kind for o in outcomes}
    return ["hidden", "×", *(k for k in OUTCOMES if k in kinds), "wrong names"]


def outcome_rows(outcomes: Sequence[Outcome]) -> list[list[str]]:
    """Return one row per hidden effects and factor: counts of each kind of outcome, and the wrong names."""
    kinds = outcome_header(outcomes)[2:-1]
    rows = []
    keys = {(o.scenario.label, o.scenario.factor) for o in outcomes}
    for name, factor in sorted(keys, key=lambda key: (-key[1], key[0])):
        selected = [o for o in outcomes if (o.scenario.label, o.scenario.factor) == (name, factor)]
        count = Counter(o.kind for o in selected)
        wrong = Counter(o.said for o in selected if o.kind == WRONG)
        rows.append(
            [
                name,
                f"{factor:g}",
                *(f"{count[k]}" if count[k] else "·" for k in kinds),
                ", ".join(f"{said} {n}" if n > 1 else said for said, n in wrong.most_common()),
            ]
        )
    return rows


def standing_rows(outcomes: Sequence[Outcome]) -> list[list[str]]:
    """Return one row per range of sigmas of single effects: the diagnoses, and the share a perfect test would see."""
    rows = []
    for low, high in pairwise(_STANDING):
        selected = [o for o in outcomes if o.stands_out is not None and low <= o.stands_out < high]
        if selected:
            count = Counter(_SAID.get(o.kind, o.kind) for o in selected)
            sigmas = np.array([o.stands_out for o in selected], dtype=float)
            rows.append(
                [
                    f"{low:g} to {high:g}" if np.isfinite(high) else f"from {low:g}",
                    f"{len(selected)}",
                    *(f"{100 * count[kind] / len(selected):.0f} %" for kind in ("named", WRONG, UNKNOWN, SILENT)),
                    f"{100 * seen_by_a_perfect_test(sigmas):.0f} %",
                ]
            )
    return rows


def write_tables(folder: Path, outcomes: Sequence[Outcome], title: str) -> list[Path]:
    """Write `outcomes.csv` with every recording and `report.md` with gates and tables; return both files."""
    rows = [
        [
            o.number,
            o.scenario.id,
            o.scenario.seed,
            o.kind,
            o.verdict,
            "; ".join(f"{n} ({', '.join(a)})" if a else n for n, a in o.named),
            "" if o.stands_out is None else f"{o.stands_out:.2f}",
            *(f"{v:.4g}" for v in o.heading or ()),
        ]
        for o in outcomes
    ]
    listing = folder / "outcomes.csv"
    with whole_file(listing) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(
            ["number", "scenario", "seed", "kind", "verdict", "named", "sigmas", "heading before", "after"]
        )
        writer.writerows(rows)
    page = folder / "report.md"
    page.write_text(markdown(outcomes, title), encoding="utf-8")
    return [listing, page]


def markdown(outcomes: Sequence[Outcome], title: str) -> str:
    """Return gates and the outcomes of each set as Markdown."""
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
    standing = standing_rows(outcomes)
    if standing:
        lines += ["", "## One effect, by how far it stands out", "", *_table(STANDING_HEADER, standing)]
    stated = reliability_rows(outcomes)
    scored = scores(outcomes)
    if stated and scored is not None:
        lines += ["", "## Whether stated probabilities are true", "", *_table(RELIABILITY_HEADER, stated)]
        lines += [
            "",
            f"Log score {scored.log:.3f}, Brier score {scored.brier:.3f}, {scored.recordings} recordings.",
        ]
    for kind in SETS:
        selected = [o for o in outcomes if o.scenario.set == kind]
        if selected:
            lines += ["", f"## {_TITLES[kind]}", "", *_table(outcome_header(selected), outcome_rows(selected))]
    return "\n".join(lines) + "\n"


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rows)]
