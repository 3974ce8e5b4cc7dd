"""Check of the consistency of the two sensors' axes, signs and units, made before a misfit is attributed to noise.

A field fixed in the world implies ṁ = −(G ω) × (m − h), with G = I if magnetometer and gyroscope are consistent.
Breakout boards and drivers may deliver signed permutations of the axes (48, 24 of which change the handedness), or
degrees instead of radians.
"""

from __future__ import annotations

from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain.gyroscope_track import summed_rate
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.recording.axes import OWN_AXES, axes_text, parse_axes
from magyc_gtsam.recording.time_base import interpolated

_LEAST_SAMPLES = 60  # magnetometer samples of three values each, for nine unknowns and 144 arrangements
_PAIRS = 3000  # pairs of means that are compared
_TURN = 0.3  # rad of rotation between the means of a pair: above their noise, yet small
_LAGS = (0.1, 2.0)  # s between the means of a pair
# Share of the squared misfit below which another arrangement is clearly better, and share of the second-best one's
# above which the best is ambiguous. Of 353 random parts of 35 real logs and 600 logs of the fault study, exchanged at
# random, they detect 805 of 932; as they are they accuse one, a log of 1 Hz. With bounds on what either arrangement
# may leave unexplained it was 742: in a room the true one left 0.26, the others 0.8 to 1.8.
_CLEARLY = 0.5
_ALONE = 0.85

_MATRICES = np.array(
    [
        np.eye(3)[list(order)] * np.array(signs)[:, None]
        for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3))
    ]
)
_EVERY = np.concatenate([_MATRICES, np.zeros((1, 3, 3))])  # and without a gyroscope
_SCALES = {"": 1.0, "deg/s": np.pi / 180, "rad/s": 180 / np.pi}


class SensorsDisagree(MagycError):
    """Error of axes or units in which the two sensors disagree; more data do not mend it."""


class Arrangement(NamedTuple):
    """An arrangement of the gyroscope's axes: ω = matrix · (angular_rate of the log).

    Attributes:
        matrix: (3, 3) G, including the factor of the unit.
        unit: assumed unit of the log's angular rate; "" if rad/s as given.
        unexplained: share of the field's variation that it leaves unexplained.
    """

    matrix: Array
    unit: str
    unexplained: float

    @property
    def axes(self) -> str:
        """The gyroscope's axes in those of the magnetometer, e.g. "x ← −y, y ← x, z ← z"."""
        return axes_words(axes_text(self.matrix))


def axes_words(axes: str) -> str:
    """Return `Recording.gyroscope_axes` in words, e.g. "x ← −y, y ← x, z ← z" of "-y,x,z"."""
    parts = axes.replace("-", "−").split(",")
    return ", ".join(f"{name} ← {part}" for name, part in zip("xyz", parts, strict=True))


def arrangements(recording: Recording) -> list[Arrangement]:
    """Return all signed permutations and units of the gyroscope, the best first."""
    return _ranked(recording)[0]


def _ranked(recording: Recording) -> tuple[list[Arrangement], float]:
    """Return all arrangements, the best first, and the share that is unexplained without a gyroscope.

    Δm = m × Gθ − h × Gθ − m × b' Δt + c Δt is linear in h, b' = G b and c; all arrangements share one
    normal matrix of the products that occur in it.
    """
    found, still = [], {}
    for unit, factor in _SCALES.items():
        change, mid, turn, step = _pairs(recording, factor)
        *left, still[unit] = _unexplained(_normal_matrix(change, mid, turn, step), _EVERY)
        found += [Arrangement(matrix * factor, unit, share) for matrix, share in zip(_MATRICES, left, strict=True)]
    found.sort(key=lambda a: a.unexplained)
    return found, still[found[0].unit]


def _normal_matrix(change: Array, mid: Array, turn: Array, step: Array) -> Array:
    """Return the normal matrix (25, 25) of the products in the model: G_ij, eᵢ θⱼ, m × Δt, Δt, and Δm itself."""
    scale = float(np.linalg.norm(mid, axis=1).mean())
    change, mid, step = change / scale, mid / scale, step[:, None, None]
    columns = np.concatenate(
        [
            np.einsum("nri,nj->nrij", -_skew(mid), turn).reshape(-1, 3, 9),  # G_ij: m × eᵢ θⱼ, negated
            np.einsum("ri,nj->nrij", np.eye(3), turn).reshape(-1, 3, 9),  # eᵢ θⱼ
            -_skew(mid) * step,
            np.eye(3) * step,
            change[:, :, None],
        ],
        axis=2,
    ).reshape(-1, 25)
    return columns.T @ columns


def _unexplained(normal: Array, matrices: Array) -> list[float]:
    """Return the share of Σ‖Δm‖² that each arrangement G, (k, 3, 3), leaves unexplained, with the best h, b' and c."""
    chosen = np.zeros((len(matrices), 25, 10))
    chosen[:, :9, 9] = matrices.reshape(-1, 9)  # Δm − m × Gθ …
    chosen[:, 24, 9] = 1.0
    axes = _skew(matrices.swapaxes(1, 2).reshape(-1, 3)).reshape(-1, 3, 3, 3)
    chosen[:, 9:18, :3] = axes.swapaxes(1, 2).reshape(-1, 9, 3)  # … = [Gθ]× h …
    chosen[:, 18:24, 3:9] = np.eye(6)  # … − m × b' Δt + c Δt
    small = chosen.swapaxes(1, 2) @ normal @ chosen
    size = np.maximum(np.sqrt(np.diagonal(small, axis1=1, axis2=2)), 1e-150)
    small /= size[:, :, None] * size[:, None, :]
    solution = np.linalg.pinv(small[:, :9, :9], rcond=1e-12, hermitian=True) @ small[:, :9, 9:]
    left = (small[:, 9, 9] - (small[:, 9:, :9] @ solution)[:, 0, 0]) * size[:, 9] ** 2
    share: list[float] = (np.maximum(left, 0.0) / max(float(normal[24, 24]), 1e-300)).tolist()
    return share


def check(recording: Recording) -> None:
    """Compare the arrangements; with too few samples, or two almost equally good arrangements, nothing is decided.

    Raises:
        SensorsDisagree: an arrangement other than the given one explains the field's variation clearly better.
    """
    if len(recording.magnetometer.time) < _LEAST_SAMPLES:
        return
    # Even without a gyroscope, a constant bias explains a turn at constant rate.
    ranked, still = _ranked(recording)
    best = ranked[0]
    given = next(a for a in ranked if not a.unit and np.array_equal(a.matrix, np.eye(3)))
    if best.unexplained > min(_CLEARLY * min(given.unexplained, still), _ALONE * ranked[1].unexplained):
        return
    as_given, otherwise = f"{max(1 - given.unexplained, 0):.0%}", f"{1 - best.unexplained:.0%}"
    if best.unit:
        raise SensorsDisagree(
            f"angular_rate: as given it explains {as_given} of the field's changes, read as {best.unit} "
            f"{otherwise}; convert it, or read it in its unit (angular_unit='{best.unit}')"
        )
    own = axes_text(best.matrix @ parse_axes(recording.gyroscope_axes))  # of the sensor, whatever it was given
    remedy = (
        f"bring both to one frame (gyroscope_axes='{own}')" if own != OWN_AXES else "leave out gyroscope_axes="
    )
    raise SensorsDisagree(
        f"the axes of gyroscope and magnetometer disagree: as given the gyroscope explains {as_given} of the "
        f"field's changes, with {axes_words(own)} {otherwise}; {remedy}"
    )


def _pairs(recording: Recording, factor: float) -> tuple[Array, Array, Array, Array]:
    """Return n pairs of means, each over half the time between the two, with the log's rate multiplied by `factor`.

    Means are used because the noise of a low-cost sensor, 2 µT per sample, is half of the change between samples.

    Returns:
        Change and midpoint of the field (n, 3), rotation vector in between (n, 3), and time step (n,).
    """
    time, field = recording.magnetometer
    gyro_time, rate = recording.gyroscope
    rate = rate * factor
    speed = float(np.sqrt(np.mean(rate**2) * 3))  # not the median: the sensor may rest most of the time
    seconds = np.clip(_TURN / max(speed, 1e-6), *_LAGS)
    lag = int(np.clip(round(float(seconds / np.median(np.diff(time)))), 1, (len(time) - 1) // 2))
    first = np.arange(0, len(time) - lag, max((len(time) - lag) // _PAIRS, 1))
    angle = summed_rate(gyro_time, rate)
    at = interpolated(time, gyro_time, angle)
    from scipy.ndimage import uniform_filter1d

    time, field, at = (uniform_filter1d(each, max(lag // 2, 1), axis=0) for each in (time, field, at))
    step = time[first + lag] - time[first]
    turn = at[first + lag] - at[first]
    kept = step < 3 * float(np.median(step))
    change, mid = field[first + lag] - field[first], 0.5 * (field[first + lag] + field[first])
    return change[kept], mid[kept], turn[kept], step[kept]


def _skew(vector: Array) -> Array:
    x, y, z = vector.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
