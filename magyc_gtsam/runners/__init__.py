"""Runners: optimise any graph, all at once or as it grows."""

from magyc_gtsam.runners.batch import BatchResult, Status, optimize
from magyc_gtsam.runners.incremental import Incremental, IncrementalResult

__all__ = ["BatchResult", "Incremental", "IncrementalResult", "Status", "optimize"]
