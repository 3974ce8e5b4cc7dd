"""The twin, the joint refit of its parameters and terms, and what a candidate adds to it."""
