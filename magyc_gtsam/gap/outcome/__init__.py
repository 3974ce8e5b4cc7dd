"""The result of a search: effects, verdict, calibration, and the agreement of model and data."""
