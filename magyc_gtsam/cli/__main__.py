"""`python -m magyc_gtsam.cli`: the command line, where the script `magyc-gtsam` is not on the path."""

import sys

from magyc_gtsam.cli import main

sys.exit(main())
