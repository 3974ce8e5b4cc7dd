"""Calibration of one instrument over many logs: constant parameters, a walking hard iron, and its jumps."""

from magyc_gtsam.history.contradictions import Contradiction
from magyc_gtsam.history.history import History
from magyc_gtsam.history.log_factor import LogFactor
from magyc_gtsam.history.many import calibrate_many
from magyc_gtsam.history.model import HistoryModel

__all__ = ["Contradiction", "History", "HistoryModel", "LogFactor", "calibrate_many"]
