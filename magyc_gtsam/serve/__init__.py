"""`magyc-gtsam serve`: calibrate in a browser. A page, and behind it jobs that are the ordinary command line."""
