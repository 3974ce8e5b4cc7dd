"""Online calibration while the vehicle moves, in constant time and memory."""

from magyc_gtsam.online.calibrator import OnlineCalibrator
from magyc_gtsam.online.engine import Change, Progress

__all__ = ["Change", "OnlineCalibrator", "Progress"]
