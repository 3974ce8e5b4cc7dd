"""A skew between the chips, online: decided as in the batch, and anew from what was marginalised."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam import cli
from magyc_gtsam.estimators.smoother.marginal import ContinuedChain
from magyc_gtsam.estimators.smoother.preparation import preintegrate
from magyc_gtsam.estimators.smoother.skew import with_angles
from magyc_gtsam.factors.chain.chain_values import ChainState, SensorNoise
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.rotations import exponential_matrices
from magyc_gtsam.io import write_mcap
from magyc_gtsam.recording import Recording
from magyc_gtsam.simulation.sensor import SOFT_IRON
from magyc_gtsam.study.efficiency import error, nees
from magyc_gtsam.study.known import skewed


def fed(recording: Recording, until: float = np.inf, online: mg.OnlineCalibrator | None = None, **options: object):
    """Every row, ten seconds at a time."""
    online = mg.OnlineCalibrator(**options) if online is None else online
    first = int(np.searchsorted(recording.time, online.taken_until[0], side="right"))
    for i in range(first, int(np.searchsorted(recording.time, until)), 100):
        rows = slice(i, i + 100)
        online.update(recording.time[rows], recording.magnetic_field[rows], recording.angular_rate[rows])
    return online


@pytest.mark.parametrize(("degrees", "horizon"), [(0.0, 3600.0), (0.7, 3600.0), (0.0, 200.0), (0.7, 200.0)])
def test_it_is_decided_as_in_the_batch(degrees: float, horizon: float) -> None:
    simulation = skewed("wide", degrees, 3)
    recording = simulation.recording.between(0, 400)
    online = fed(recording, horizon=horizon)
    now, batch = online.calibration, mg.calibrate(recording)
    assert online.converged
    assert bool(now.terms) == bool(batch.terms) == bool(degrees)
    off = (now.hard_iron - batch.hard_iron) / batch.sigma["hard_iron"]
    assert np.abs(off).max() < (0.01 if horizon > 600 else 0.2)
    np.testing.assert_allclose(now.sigma["hard_iron"], batch.sigma["hard_iron"], rtol=0.1)
    for one, other in zip(now.terms, batch.terms, strict=True):
        np.testing.assert_allclose(one.value, other.value, atol=0.2 * other.sigma.max())
        np.testing.assert_allclose(one.sigma, other.sigma, rtol=0.15)
    assert nees(error(now, simulation.truth), now.covariance) < 31.3  # 99.9 % of 11


def test_it_is_decided_anew_from_what_was_marginalised() -> None:
    """Two motions: the first does not show the yaw part, and is marginalised when the second begins."""
    angle = np.radians([0.0, 0.0, 0.7])
    turn = exponential_matrices(angle[:, None])[:, :, 0]
    first = mg.simulate("tiny", 220, seed=1, soft_iron=SOFT_IRON @ turn).recording
    second = mg.simulate("wide", 200, seed=2, soft_iron=SOFT_IRON @ turn).recording
    both = Recording(
        np.concatenate([first.time, second.time + first.time[-1] + 1]),
        np.vstack([first.magnetic_field, second.magnetic_field]),
        np.vstack([first.angular_rate, second.angular_rate]),
    )
    online = fed(both, until=220.0, horizon=120.0)
    assert all(np.linalg.norm(term.value) < np.radians(0.1) for term in online.calibration.terms)
    open_before = np.sqrt(np.diag(online.calibration.diagnostics["skew"]["covariance"]))
    (term,) = fed(both, online=online).calibration.terms
    np.testing.assert_allclose(-term.value, angle, atol=4 * term.sigma.max())
    assert term.sigma.max() < 0.5 * open_before.max()


def test_a_marginal_holds_what_all_its_windows_say_of_a_skew() -> None:
    simulation = skewed("moderate", 1.0, 5)
    windows = preintegrate(simulation.recording.between(0, 150)).integrate()
    truth = simulation.truth
    vech = truth.soft_iron[np.triu_indices(3)] * truth.field_strength
    parameters = with_angles(np.concatenate([vech, truth.hard_iron, np.zeros(4)]))
    chain = ContinuedChain(windows, SensorNoise(1e-6, 5e-3))
    weights = chain.unweighted()
    state, whole = chain.settle(chain.start(parameters), weights)
    without = ChainState(parameters[:13], state.direction)  # the marginal carries the skew nevertheless
    past = chain.marginalise(without, weights, 40)
    rest = ContinuedChain(windows.part(40, len(windows)), chain.noise, past)
    begun = ChainState(parameters, state.direction[:, 40:])
    _, joined = rest.settle(begun, rest.unweighted())
    scale = 1 / np.sqrt(np.diag(whole.information))
    np.testing.assert_allclose(
        scale * joined.information * scale[:, None], scale * whole.information * scale[:, None], atol=5e-3
    )
    assert isinstance(chain.part(0, 40), FieldChain)
    assert chain.part(3, 40).past is None


def test_it_is_kept_with_the_state(tmp_path: Path) -> None:
    recording = skewed("wide", 1.2, 4).recording.between(0, 330)
    online = fed(recording, until=250.0, horizon=130.0)
    online.save(tmp_path / "state.npz")
    again = mg.OnlineCalibrator.load(tmp_path / "state.npz")
    assert again.calibration.terms
    ends = [fed(recording, online=each).calibration.to_dict() for each in (online, again)]
    assert ends[0] == ends[1]


def test_a_number_and_nothing() -> None:
    recording = skewed("wide", 0.7, 6).recording.between(0, 200)
    held = fed(recording, misalignment=0).calibration
    assert held.terms == ()
    assert "skew" not in held.diagnostics
    (term,) = fed(recording, misalignment=np.radians(1.0)).calibration.terms
    (batch,) = mg.calibrate(recording, misalignment=np.radians(1.0)).terms
    np.testing.assert_allclose(term.value, batch.value, atol=0.05 * batch.sigma.max())
    with pytest.raises(mg.MagycError, match="misalignment must be at least 0 and below"):
        mg.OnlineCalibrator(misalignment=-1.0)


def test_a_skew_that_no_board_has_is_not_believed_online_either() -> None:
    online = fed(skewed("wide", 4.0, 1).recording, until=200.0)
    assert not online.converged
    assert online.calibration.terms == ()
    assert online.calibration.message.startswith("the field varies along the way")


def test_the_command_takes_them(tmp_path: Path) -> None:
    earlier = mg.calibrate(mg.simulate("wide", 120, seed=9).recording)
    earlier.save(tmp_path / "earlier.yaml")
    log = tmp_path / "log.mcap"
    write_mcap(log, mg.simulate("dive", 120, seed=10).recording)
    said = f"online {log} -o {tmp_path}/now.yaml --state {tmp_path}/state.npz --idle 0 --quiet --misalignment 0.5"
    said += f" --prior {tmp_path}/earlier.yaml --hard-iron-walk 40 --location 47.5 19 --date 2026-03-01"
    assert cli.main(said.split()) in (0, 1)
    options = mg.OnlineCalibrator.load(tmp_path / "state.npz").options
    assert options["misalignment"] == pytest.approx(np.radians(0.5))
    assert options["hard_iron_walk"] == pytest.approx(40e-6)
    assert options["prior"]["hard_iron"] == earlier.hard_iron.tolist()
    assert 40e-6 < options["field"][0] < 60e-6
    assert mg.Calibration.load(tmp_path / "now.yaml").configuration["misalignment"] == options["misalignment"]
