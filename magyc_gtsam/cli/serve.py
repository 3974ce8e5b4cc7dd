"""`magyc-gtsam serve`: calibrate in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from magyc_gtsam.cli.terminal import show

_GIGABYTE = 1 << 30


def run(
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 takes one that is free.")] = 8642,
    folder: Annotated[Path, typer.Option(metavar="LOGS", help="Folder of logs; results/ is made in it.")] = Path(
        "."
    ),
    host: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Address to listen on, as 0.0.0.0 for every network; the page then needs the token in the address "
            "shown. Default: this machine alone.",
        ),
    ] = None,
    most: Annotated[
        float, typer.Option(metavar="GB", min=0.001, help="Largest log that may be dropped into the page.")
    ] = 2.0,
    open_page: Annotated[bool, typer.Option("--open", help="Show the page in the browser.")] = False,
) -> int:
    """Calibrate in a browser: drop a log, choose an interval, look at the report, copy the parameters.

    Needs the extra `serve`. Ends with Ctrl-C. Results are those of the command line, in LOGS/results.
    """
    from magyc_gtsam.serve.limits import Limits
    from magyc_gtsam.serve.run import serve

    def ready(address: str) -> None:
        show(f"open {address}", "Ctrl-C ends")
        if open_page:
            import webbrowser

            webbrowser.open(address)

    try:
        serve(folder, port, host, Limits(upload=int(most * _GIGABYTE)), ready)
    except KeyboardInterrupt:
        show("ended")
    return 0
