"""Runners: optimise any graph, all at once or as it grows."""

from magyc_gtsam.runners.batch import BatchResult, Status, optimize

__all__ = ["BatchResult", "Status", "optimize"]
