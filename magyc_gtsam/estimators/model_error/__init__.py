"""The calibration error caused by effects that the model lacks, by variance components at the minimum of a fit."""

from magyc_gtsam.estimators.model_error.model_error import ModelError, model_error

__all__ = ["ModelError", "model_error"]
