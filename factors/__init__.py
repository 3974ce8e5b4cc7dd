"""GTSAM factors."""
