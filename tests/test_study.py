"""Small versions of the studies that `magyc-gtsam study` runs at full size."""

from functools import partial

import numpy as np
import pytest

from magyc_gtsam import MagycError, simulate
from magyc_gtsam.estimators import calibrate
from magyc_gtsam.study.bound import cramer_rao
from magyc_gtsam.study.efficiency import BLOCKS, efficiency
from magyc_gtsam.study.table_one import PUBLISHED, table_one


@pytest.mark.parametrize("motion", ["moderate", "low"])
def test_the_smoother_is_at_the_bound_and_honest(motion):
    result = efficiency(motion, 16, method=partial(calibrate, misalignment=0))
    for block in BLOCKS:  # 1.10, and two standard deviations of 16 runs of a block of three or more
        assert result.ratio[block] < 1.10 + 2 / np.sqrt(2 * 16 * 3)
    half = 2.6 * np.sqrt(2 * 11 / 16)
    assert 11 - half < result.nees < 11 + half
    assert result.refused == 0


def test_a_fifth_of_the_data_disturbed():
    result = efficiency("low", 4, disturbed=0.2)
    for block in BLOCKS:
        assert result.ratio[block] < 1.3 + 2 / np.sqrt(2 * 4 * 3)


def test_the_bound_shrinks_with_the_noise():
    quiet, loud = (
        cramer_rao(simulate("wide", 60, seed=1, magnetometer_noise=s * 1e-6, gyroscope_noise=s * 5e-3))
        for s in (1, 2)
    )
    np.testing.assert_allclose(np.diag(loud), 4 * np.diag(quiet), rtol=0.05)
    assert np.linalg.matrix_rank(quiet / np.sqrt(np.outer(np.diag(quiet), np.diag(quiet))), tol=1e-8) == 11


def test_the_bound_needs_no_delay():
    with pytest.raises(MagycError, match="without delay"):
        cramer_rao(simulate("wide", 60, delay=0.02))


def test_table_one_of_the_paper():
    rows = {(row.method, row.motion): row for row in table_one(6, methods=("magyc-bfg", "smoother"))}
    for motion, (heading, _) in PUBLISHED["raw"].items():
        assert rows["raw", motion].heading[0] == pytest.approx(heading, rel=0.05)
    for motion in ("wide", "moderate"):
        heading, spread = PUBLISHED["magyc-bfg"][motion]
        assert rows["magyc-bfg", motion].heading[1] - 0.1 < heading < rows["magyc-bfg", motion].heading[2] + 0.1
        assert rows["magyc-bfg", motion].spread[1] - 0.5 < spread < rows["magyc-bfg", motion].spread[2] + 0.5
    for motion in PUBLISHED["raw"]:
        assert rows["smoother", motion].systematic[2] < 0.3 < rows["magyc-bfg", motion].systematic[2]


def test_boards_are_drawn_as_they_are_believed_to_be():
    from magyc_gtsam.study.known import believed

    sizes = np.array([believed(seed) for seed in range(2000)])
    assert sizes.max() <= 2.0
    assert np.mean(sizes == 0) == pytest.approx(0.1 / 0.82, abs=0.03)  # 18 % of all are drawn again
    assert 0.7 < np.median(sizes) < 1.1  # boards that were measured have 0.7 to 1.3°


def test_the_known_study_tells_a_skew_that_is_asked_from_one_that_is_not(tmp_path):
    from magyc_gtsam.study.known import KnownCase, fact_cells, known_rows, matrix_cell, skew_cells
    from magyc_gtsam.study.rows import Running

    pytest.importorskip("pyarrow")
    units = [KnownCase("skew", "wide", 0.7, seed) for seed in range(2)]
    units += [KnownCase("board", "wide", 0.0, seed) for seed in range(2)]
    units += [KnownCase("fact", "level", 300.0, seed) for seed in range(1)]
    units += [KnownCase("matrix", "wide", 1.0, 0)]
    rows = known_rows(units, Running(tmp_path))
    assert known_rows(units, Running(tmp_path)) == rows  # taken from the parts
    cells = skew_cells("wide", 0.7, rows)
    assert cells["asked"].decided == 1.0
    assert cells["never"].heading > 4 * cells["asked"].heading
    assert cells["never"].hard_iron > 2 * cells["asked"].hard_iron
    board = skew_cells("wide", None, rows)["asked"]
    assert 0 < board.nees < board.of_sensors  # what else an instrument may do widens
    facts = fact_cells("level", 300.0, rows)
    assert facts["+ strength"].stated < 0.5 * facts["+ matrix"].stated < 0.5 * facts["alone"].stated
    assert facts["+ dip"].stated <= facts["+ strength"].stated
    assert facts["online + strength"].stated == pytest.approx(facts["+ strength"].stated, rel=0.05)
    for cell in facts.values():  # one run
        assert 0.1 < cell.error / cell.bound < 3
        assert 0 < cell.ratio <= cell.of_sensors
    assert matrix_cell("wide", 1.0, rows).refused == 1.0
