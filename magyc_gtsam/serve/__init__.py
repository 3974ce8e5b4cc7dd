"""`magyc-gtsam serve`: calibrate in a browser, through a page whose jobs run the ordinary command line."""
