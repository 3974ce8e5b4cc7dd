"""Online, what the model does not explain enters the covariance as in the batch, and is kept with the state."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.study.faults.catalogue import FAULTS
from magyc_gtsam.study.faults.signals import record


def test_online_states_the_same_model_error(tmp_path: Path) -> None:
    """At the end, in the middle of a log that is too long to be fitted as a whole, and after a kill."""
    fault = FAULTS["turned-gyroscope"]
    recording = record("wide", 0, fault, fault.strong, "turned-gyroscope").recording("turned")
    batch = mg.calibrate(recording, misalignment=0)
    online = mg.OnlineCalibrator(horizon=400.0, misalignment=0)
    for i in range(0, 6000, 250):
        rows = slice(i, i + 250)
        online.update(recording.time[rows], recording.magnetic_field[rows], recording.angular_rate[rows])
        if i == 5500:
            online.save(tmp_path / "state.npz")
            again = mg.OnlineCalibrator.load(tmp_path / "state.npz")
            assert again.calibration.to_dict() == online.calibration.to_dict()
            online = again
    result = online.calibration
    assert batch.diagnostics["model_error"]["components"] != []
    assert result.diagnostics["model_error"]["components"] != []
    whole, noise = (np.trace(c[6:9, 6:9]) for c in (result.covariance, result.noise_covariance))
    assert whole > 4 * noise
    np.testing.assert_allclose(whole, np.trace(batch.covariance[6:9, 6:9]), rtol=0.75)


def test_a_fit_without_information_on_the_bias_is_no_crash() -> None:
    """A swell of 1.8 s in samples of 1 Hz: the covariance of one refit on the way is infinite."""
    fault = FAULTS["swell-at-1-hz"]
    recording = record("wide", 930, fault, fault.strong, "swell-at-1-hz").recording("swell")
    online = mg.OnlineCalibrator()
    for i in range(0, 600, 20):
        rows = slice(i, i + 20)
        online.update(recording.time[rows], recording.magnetic_field[rows])
        online.update(recording.time[rows], angular_rate=recording.angular_rate[rows])
    assert online.calibration is None or not online.calibration.trusted
