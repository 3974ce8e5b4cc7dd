"""Studies: the Cramér–Rao bound, the papers' tables, the methods' efficiency, and all methods on one recording."""
