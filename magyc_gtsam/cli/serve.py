"""`magyc-gtsam serve`: calibrate in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from magyc_gtsam.cli.terminal import show, show_page


def run(
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 chooses a free one.")] = 8642,
    folder: Annotated[
        Path, typer.Option(metavar="LOGS", help="Folder of logs; results are written to results/ in it.")
    ] = Path("."),
    host: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Address to listen on, for example 0.0.0.0 for all networks; the page then requires the token in the "
            "address shown. Default: this machine only.",
        ),
    ] = None,
    most: Annotated[float, typer.Option(metavar="GB", min=0.001, help="Size limit of a dropped log.")] = 2.0,
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
) -> int:
    """Calibrate in a browser.

    Drop a log, choose an interval, view the report, copy the parameters. Requires the extra `serve`; stop it with
    Ctrl-C. The results are those of the command line, stored in LOGS/results.
    """
    from magyc_gtsam.serve.limits import GIGABYTE, Limits
    from magyc_gtsam.serve.run import serve

    def ready(address: str) -> None:
        show(f"open {address}", "Ctrl-C ends")
        if open_page:
            show_page(address)

    try:
        serve(folder, port, host, Limits(upload=int(most * GIGABYTE)), ready)
    except KeyboardInterrupt:
        show("ended")
    return 0
