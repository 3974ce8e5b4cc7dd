"""What is said of a search: effects, verdict, calibration, and how well model and data agree."""
