"""Studies: the bound, the papers' tables and how close the methods come, simulated; all methods on one recording."""
