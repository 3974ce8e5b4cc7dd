"""`python -m magyc_gtsam.cli`: the command line without the script `magyc-gtsam`."""

import sys

from magyc_gtsam.cli import main

sys.exit(main())
