"""A family of any function of time along one fixed direction, such as an actuator or a load without a logged channel.

The direction is the dominant one of a free function of time. Its choice is penalised by the share of the half sphere in
which it explains as much.
"""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.evidence.beside import Beside
from magyc_gtsam.gap.evidence.candidates import COLOUR, COURSE, Batch, Candidates
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.weighing import Weighed, weigh

ONE_WAY = "time:one-way"


def one_way(candidates: Candidates, beside: Beside, power: float) -> dict[str, Weighed]:
    """Return {`ONE_WAY`: its evidence}; empty if there is no function of time among the candidates."""
    for batch in candidates.batches:
        for i, name in enumerate(batch.names):
            if name in (COLOUR, COURSE) and not batch.settings[i]["first"]:
                return {ONE_WAY: _weighed(candidates, batch.rows[i], batch.gram[i], beside, power)}
    return {}


def _weighed(candidates: Candidates, rows: np.ndarray, gram: Array, beside: Beside, explained: float) -> Weighed:
    columns, score_bias = candidates.columns[rows], candidates.score_bias[rows]
    seen = beside.see(columns, score_bias)
    information = gram / beside.noise**2 - seen.reach @ seen.reach.T
    value, vector = np.linalg.eigh(information)
    value, own = np.maximum(value, 0.0), vector.T @ seen.score
    variance = PRIOR.scales[:, None] ** 2
    spread = 1 + variance * value
    best = int(np.argmax((own**2 * variance / spread - np.log(spread)).sum(axis=1)))
    amplitude = (vector @ (variance[best] / spread[best] * own)).reshape(-1, 3)
    direction = np.linalg.svd(amplitude, full_matrices=False)[2][0]
    along = np.einsum("kan,a->kn", columns.reshape(-1, 3, columns.shape[1]), direction)
    walk = along / np.arange(1.0, len(along) + 1)[:, None]  # larger amplitudes of slower functions
    stacked = np.concatenate([along, walk * np.sqrt((along**2).sum() / (walk**2).sum())])
    places = np.arange(len(stacked)).reshape(2, -1)
    own_rows = stacked[places]
    batch = Batch(places, own_rows @ own_rows.swapaxes(1, 2), (ONE_WAY,) * 2, ({}, {}), np.full(2, -np.log(2.0)))
    found = weigh(Candidates(stacked, np.zeros(len(stacked)), (batch,)), beside, explained)[ONE_WAY]
    power = max(float(found.power[int(np.argmax(found.by_scale))]), PRIOR.least_power)
    cost = float(np.log(power / 2.0))  # a solid angle 4π / power of the half sphere 2π
    return found.less(cost)
