"""BLAS runs on one thread while a calibration is computed, and as before after it."""

from __future__ import annotations

import os
import subprocess
import sys

import gtsam
import numpy as np
import pytest
import scipy.linalg  # noqa: F401  # its BLAS is one of those that are limited
from threadpoolctl import threadpool_info, threadpool_limits

import magyc_gtsam as mg
from magyc_gtsam.factors import KeyframeField, NativeFactors, keyframe_field_factor
from magyc_gtsam.factors.one_thread import one_thread


def threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@pytest.fixture(autouse=True)
def two_threads() -> object:
    with threadpool_limits(limits=2, user_api="blas"):
        if not threads():
            pytest.skip("this BLAS is none whose threads can be told")
        yield


@one_thread
def inside() -> set[int]:
    return threads()


def test_one_inside_and_as_before_after() -> None:
    assert inside() == {1}
    assert threads() == {2}


def test_one_in_the_update_of_a_graph_that_brings_a_block() -> None:
    turn, seen = mg.simulate("wide", duration=2.0, seed=0).recording, []
    samples = KeyframeField.from_samples(
        (turn.time, turn.magnetic_field), (turn.time, turn.angular_rate), turn.time[-1]
    )
    block = keyframe_field_factor(0, 1, 2, samples, 1e-6, field=[30e-6, 0, 40e-6], field_unit=50e-6)

    def note(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[np.ndarray] | None) -> np.ndarray:
        if jacobians is not None:
            seen.append(threads())
            jacobians[0] = np.eye(3)
        return values.atPoint3(3)

    unit, values = gtsam.noiseModel.Unit.Create(3), gtsam.Values()
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(block)
    graph.push_back(gtsam.CustomFactor(unit, [3], note))
    graph.addPriorRot3(0, gtsam.Rot3(), unit)
    graph.addPriorVector(1, [1.0, 0, 0, 1, 0, 1], gtsam.noiseModel.Unit.Create(6))
    graph.addPriorPoint3(2, np.zeros(3), unit)
    values.insert(0, gtsam.Rot3())
    values.insert(1, np.array([1.0, 0, 0, 1, 0, 1]))
    values.insert(2, np.zeros(3))
    values.insert(3, np.zeros(3))
    NativeFactors().update(gtsam.ISAM2(), graph, values)
    assert seen
    assert all(each == {1} for each in seen)
    assert threads() == {2}


def test_one_inside_another() -> None:
    @one_thread
    def outer() -> tuple[set[int], set[int]]:
        return inside(), threads()

    assert outer() == ({1}, {1})
    assert threads() == {2}


def test_as_before_after_an_error() -> None:
    with pytest.raises(mg.MagycError):
        mg.calibrate(mg.simulate("wide", duration=20.0, seed=0).recording, field_strength=-1.0)
    assert threads() == {2}


OVERLAP = """
import threading, scipy.linalg
from threadpoolctl import threadpool_info
from magyc_gtsam.factors.one_thread import one_thread

def threads():
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}

before, first_is_in, second_is_out, seen = threads(), threading.Event(), threading.Event(), []

@one_thread
def first():
    first_is_in.set()
    second_is_out.wait(10.0)
    seen.append(threads())

thread = threading.Thread(target=first)
thread.start()
first_is_in.wait(10.0)
seen.append(one_thread(threads)())
second_is_out.set()
thread.join()
print(before, seen, threads())
"""


def test_two_threads_that_overlap_leave_what_was_set() -> None:
    """In a process of its own, whose threads of BLAS nothing has changed."""
    done = subprocess.run(
        [sys.executable, "-c", OVERLAP],
        env=os.environ | {"OPENBLAS_NUM_THREADS": "2"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "{2} [{1}, {1}] {2}"
