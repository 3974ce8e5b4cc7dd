"""Arrays of a calibration are freed with it: the command line collects garbage rarely, and a study runs hundreds."""

from __future__ import annotations

import gc

import pytest
from test_online import feed

from magyc_gtsam import OnlineCalibrator, calibrate, find_gap, simulate


@pytest.mark.parametrize("method", [calibrate, find_gap, lambda recording: feed(OnlineCalibrator(), recording)])
def test_no_object_of_a_calibration_waits_for_the_garbage_collection(method):
    recording = simulate("wide", duration=120, seed=3).recording
    method(recording)  # what is imported and cached at first use
    gc.collect()
    gc.disable()
    gc.set_debug(gc.DEBUG_SAVEALL)
    try:
        method(recording)
        gc.collect()
        waiting = {
            type(each).__qualname__ for each in gc.garbage if type(each).__module__.startswith("magyc_gtsam")
        }
    finally:
        gc.set_debug(0)
        gc.garbage.clear()
        gc.enable()
    assert waiting == set()
