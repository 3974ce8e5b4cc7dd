"""`magyc-gtsam study`: Monte-Carlo studies, printed as tables."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from magyc_gtsam.cli.terminal import show_table, stages


class Study(StrEnum):
    """The studies there are."""

    EFFICIENCY = "efficiency"
    TABLE_ONE = "table-one"


def run(
    study: Annotated[
        Study,
        typer.Argument(
            metavar="STUDY",
            help="efficiency (error over the Cramér–Rao bound, NEES) or table-one (Table I of the MAGYC paper).",
            show_default=False,
        ),
    ],
    runs: Annotated[int, typer.Option(min=1, help="Random recordings per motion.")] = 100,
    disturbed: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="efficiency: share of seconds with up to 50 µT added.")
    ] = 0.0,
    gyroscope_noise: Annotated[float, typer.Option(metavar="MRAD/S", help="Deviation per sample.")] = 5.0,
) -> int:
    """Run a study on simulated recordings and print its table."""
    noise = gyroscope_noise * 1e-3
    if study is Study.EFFICIENCY:
        _efficiency(runs, disturbed, noise)
    else:
        _table_one(runs, noise)
    return 0


def _efficiency(runs: int, disturbed: float, gyroscope_noise: float) -> None:
    from magyc_gtsam.simulation import AMPLITUDES
    from magyc_gtsam.study.efficiency import BLOCKS, efficiency

    rows = []
    with stages() as stage:
        for motion in AMPLITUDES:
            result = efficiency(
                motion,
                runs,
                disturbed=disturbed,
                gyroscope_noise=gyroscope_noise,
                progress=stage(f"{motion}, {runs} runs"),
            )
            low, high = result.band
            rows.append(
                [
                    motion,
                    *(f"{result.ratio[block]:.3f}" for block in BLOCKS),
                    f"{result.rmse['hard iron'] * 1e9:.0f}",
                    f"{result.nees:.2f}",
                    f"{low:.2f} to {high:.2f}",
                    f"{result.refused}",
                ]
            )
    show_table(["RMSE / bound", *BLOCKS, "hard iron nT", "NEES", "95 % band", "refused"], rows)


def _table_one(runs: int, gyroscope_noise: float) -> None:
    from magyc_gtsam.study.table_one import PUBLISHED, table_one

    def spread(values: tuple[float, float, float]) -> str:
        return f"{values[0]:.2f} ({values[1]:.2f} to {values[2]:.2f})"

    with stages() as stage:
        result = table_one(runs, gyroscope_noise=gyroscope_noise, progress=stage(f"{runs} runs"))
    rows = []
    for row in result:
        heading, field = PUBLISHED.get(row.method, {}).get(row.motion, (None, None))
        rows.append(
            [
                f"{row.method}, {row.motion}",
                spread(row.heading),
                "" if heading is None else f"{heading:.3f}",
                spread(row.spread),
                "" if field is None else f"{field:.3f}",
                spread(row.systematic),
            ]
        )
    show_table(["median (5 to 95 %)", "heading °", "paper", "field mG", "paper", "systematic °"], rows)
