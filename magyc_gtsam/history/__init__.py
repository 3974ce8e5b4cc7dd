"""Many logs of one instrument: what stays, what moved, and when."""

from magyc_gtsam.history.contradictions import Contradiction
from magyc_gtsam.history.history import History, calibrate_many
from magyc_gtsam.history.log_factor import LogFactor
from magyc_gtsam.history.model import HistoryModel

__all__ = ["Contradiction", "History", "HistoryModel", "LogFactor", "calibrate_many"]
