"""`python -m magyc_gtsam`: the command line without the script `magyc-gtsam`."""

import sys

from magyc_gtsam.cli import main

if __name__ == "__main__":  # a spawned process imports this file under another name
    sys.exit(main())
