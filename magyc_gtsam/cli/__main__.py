"""`python -m magyc_gtsam.cli`, which is `python -m magyc_gtsam` under its older name, for scripts that have it."""

import sys

from magyc_gtsam.cli import main

if __name__ == "__main__":  # a spawned process imports this file under another name
    sys.exit(main())
