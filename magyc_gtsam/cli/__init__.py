"""The command line `magyc-gtsam`: arguments → one call → files and exit code.

One file per command, each with one function `run` that returns the exit code: 0 done, 1 done but the
result must not be trusted, 2 wrong input or arguments. Commands import what they need when they run, so
that `--help` waits for nothing.
"""

from magyc_gtsam.cli.app import main

__all__ = ["main"]
