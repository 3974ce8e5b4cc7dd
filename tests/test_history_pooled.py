"""What a history says of the next log beside its filter: scale, delay, misalignment, horizon, and which log is last."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.history import History
from magyc_gtsam.history.log_factor import LogFactor, compress
from magyc_gtsam.history.pooled import misalignment_of, pooled, scale_of

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
from season import dive_factors

DAY = 86400.0
BEGIN = 1.7e9  # s since 1970


@pytest.fixture(scope="module")
def dives() -> tuple[LogFactor, ...]:
    dive, random = dive_factors(("wide",))[0], np.random.default_rng(5)
    assert dive.mean is not None
    means = dive.mean + 0.3 * random.standard_normal((6, len(dive.mean))) @ np.linalg.cholesky(dive.covariance).T
    return tuple(
        replace(dive, name=f"dive {k}", samples=str(k), mean=mean, time=None) for k, mean in enumerate(means)
    )


def of_another_instrument(dive: LogFactor) -> LogFactor:
    assert dive.mean is not None
    mean = dive.mean.copy()
    mean[:5] += [0.2, -0.15, 0.1, 0.05, -0.1]
    mean[-6:-3] += [40.0, -30.0, 20.0]
    return replace(dive, mean=mean)


def test_the_sigma_for_the_next_log_has_the_scatter_of_the_others() -> None:
    """A delay of 0 that became 90 ms in mid-season; equal ones average out."""
    sigma = np.full(10, 0.002)
    mean, even = pooled(np.full(10, 0.03), sigma)
    assert (mean, even) == pytest.approx((0.03, 0.002 / np.sqrt(10)))
    mean, changed = pooled(np.repeat([0.0, 0.09], 5), sigma)
    assert abs(0.09 - mean) < 2 * changed
    assert pooled(np.array([0.03]), np.array([0.002])) == (0.03, 0.002)


@pytest.mark.parametrize("shown", [1, 3, 4, 6])
def test_a_misalignment_that_most_logs_do_not_show_is_not_that_of_the_next(
    dives: tuple[LogFactor, ...], shown: int
) -> None:
    skew = {"misalignment": np.array([0.0, 0.0, 0.02]), "misalignment_covariance": np.eye(3) * 1e-6}
    logs = [replace(dive, **skew) if k < shown else dive for k, dive in enumerate(dives)]  # type: ignore[arg-type]
    assert bool(misalignment_of(logs)) == (shown > 3)


def test_the_scale_has_the_sigma_of_the_strength_that_all_logs_share() -> None:
    """Of a given strength that is 0.5 % uncertain, ten logs know no more; with those of another place it is doubted."""
    calibration = mg.calibrate(mg.simulate("wide", 120, seed=3).recording, field_strength=50e-6)
    factor = compress(calibration, "dive", None)
    assert factor.log_scale_sigma is not None
    step = 1e-3
    scaled = replace(calibration, soft_iron=calibration.soft_iron * (1 + step))
    assert compress(scaled, "dive", None).log_scale == pytest.approx(factor.log_scale + np.log1p(step))
    logs = [replace(factor, log_scale=0.1, log_scale_sigma=0.005)] * 10
    assert scale_of(logs) == pytest.approx((0.1, 0.005))
    other = [replace(each, log_scale=0.1 - np.log(2.0)) for each in logs[:5]]
    assert scale_of([*logs[:5], *other])[1] > 0.3


def test_logs_of_two_places_have_no_common_strength(dives: tuple[LogFactor, ...]) -> None:
    def history(factor: float) -> History:
        scales = [{"log_scale": np.log(factor) * (k % 2), "log_scale_sigma": 0.005} for k in range(len(dives))]
        return History([replace(dive, **known) for dive, known in zip(dives, scales, strict=True)])  # type: ignore[arg-type]

    same, two = history(1.0), history(2.1)
    assert same.next.trusted
    assert not two.next.trusted
    assert two.doubt is not None
    assert "differ by 4" in two.doubt.cause
    sigma = same.next.sigma["soft_iron"][0, 0]
    assert 0.004 < sigma < 0.01


@pytest.mark.parametrize("together", [False, True])
def test_a_last_log_of_another_instrument_is_no_basis_for_the_next(
    dives: tuple[LogFactor, ...], together: bool
) -> None:
    """Added alone or with the others; before the others it is only left out."""
    last = replace(of_another_instrument(dives[-1]), name="last", samples="last")
    history = History([*dives[:5], last]) if together else History(list(dives[:5])).extend([last])
    assert history.doubt is not None
    assert history.doubt.cause.startswith("last, the last log, is of another instrument")
    assert not history.next.trusted
    assert History([last, *dives[:5]]).next.trusted


def test_the_next_trip_is_farther_than_the_next_dive(dives: tuple[LogFactor, ...]) -> None:
    """Three trips of two dives, a month apart; and dives an hour apart."""
    monthly = [0.0, 1 / 24, 30.0, 30 + 1 / 24, 60.0, 60 + 1 / 24]
    hourly = [k / 24 for k in range(6)]
    sigmas, said = [], []
    for days in (monthly, hourly):
        logs = [replace(dive, time=BEGIN + day * DAY) for dive, day in zip(dives, days, strict=True)]
        following = History(logs).next
        sigmas.append(float(following.sigma["hard_iron"].max()))
        said.append(following.message)
    assert sigmas[0] > 2 * sigmas[1]
    assert "for 30 days after the last log" in said[0]
    assert "for 1 h after the last log" in said[1]
    assert "for the next log" in History(list(dives)).next.message
