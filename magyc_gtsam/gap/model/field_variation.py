"""Variation of the field of the place, as variance components that are part of every hypothesis.

On real logs the field is not constant: it changes along the way, and with attitude, because a hand or an arm ties the
position to the attitude. Both are random functions of low rank in the world's axes: cosines of time with the spectrum
of an Ornstein–Uhlenbeck process, and a Gaussian process on rotations (Nyström approximation). With their whitened
columns Z, amplitudes Λ and a window noise ρ, the innovations v after projection on the complement of the model's
columns have the evidence

    ln Z = −½ [ (|v|² − |L⁻¹ √Λ Z v|²) / ρ² + 2 Σ ln L_ii + n ln ρ² ],   L Lᵀ = I + √Λ Z Zᵀ √Λ,

which is maximised over a grid of amplitudes (restricted maximum likelihood).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property, partial
from itertools import product

import numpy as np

from magyc_gtsam.calibration.limits import PLAUSIBLE_FIELD
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.changes import per_axis
from magyc_gtsam.gap.model.amplitudes import EvidenceOfAmplitudes
from magyc_gtsam.gap.model.columns import Columns
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.rules import RULES

_MODES, _MOST_MODES = 60, 240  # cosines of time: as a rule, and where these leave what varies faster
_SHORTEST = 4.0  # s, half the period of the last one; 60 reach it in the real logs, of up to four minutes
_LONG = 1800  # windows, half an hour of them by the second, beyond which more modes take minutes and gigabytes
# Standard deviation of what varies faster than the modes, relative to the noise of a window, that needs no more modes.
_NEGLIGIBLE = 0.5
CORRELATION = (1.0, 4.0, 16.0)  # s
_AMPLITUDES = 1e-6 * 2.0 ** np.arange(-5.0, 4.0)  # T, over ρ, which is 4 or 5 in rooms
_SHARES = (0.0, 0.5, 1.0, 2.0)  # amplitude with attitude over that along the way; attitude alone is not the place
# Further ones of what moves with the sensor: a servo may follow the attitude alone.
_OF_ATTITUDE = (4.0, 8.0, 16.0)
COMBINATIONS = len(CORRELATION) * len(_AMPLITUDES) * len(_SHARES)
_FAST = tuple(time for time in CORRELATION if time <= RULES.longest_colour)  # s, of coloured noise
COLOURS = len(_FAST) * len(_AMPLITUDES)
_TURN = 0.6  # rad, correlation length in attitude: the likeliest of 0.3, 0.6 and 1 on hand-held real logs
_ATTITUDES = 80  # inducing attitudes of the Nyström approximation
_LEAST = 0.05  # smallest eigenvalue of the kernel at the inducing attitudes that is kept
_SWEEPS = 2  # of the coordinate search over the grid
_MOVES = ((-1, 1), (1, -1), (-1, 0), (1, 0), (0, -1), (0, 1))  # of amplitude and share; two keep the attitude's


@dataclass(frozen=True, eq=False)
class FieldVariation:
    """The variation of the field over a recording.

    Attributes:
        gain: gain in log evidence over a constant field, nats.
        along, attitude: standard deviations along the way and with attitude, T.
        colour: standard deviation of coloured noise of the magnetometer beside it, T.
        colour_period: correlation time of that, s.
        faster: standard deviation of what varies along the way faster than the components, by its spectrum, T.
        noise: ρ, relative to the noise of the sensors.
        period: correlation time along the way, s.
        components: (k, 3n) whitened columns, whose amplitudes have the standard deviation ρ; last those of the colour.
        gram: (k, k) products of these.
        colour_columns: number of the latter.
        modes: number of cosines of time.
    """

    gain: float
    along: float
    attitude: float
    colour: float
    colour_period: float
    faster: float
    noise: float
    period: float
    components: Array
    gram: Array
    colour_columns: int
    modes: int

    @property
    def evident(self) -> bool:
        """Return whether the evidence for a variation is sufficient."""
        return self.gain > RULES.field_varies and self.along > 0

    @property
    def coloured(self) -> bool:
        """Return whether the noise beside it is more than what varies faster, which no component describes.

        That varies as noise with a correlation time below the period of the last component. In a field without such
        noise the two have the same size.
        """
        return self.colour**2 > 2 * self.faster**2

    @property
    def fast(self) -> bool:
        """Return whether it is a function of time alone that changes as fast as a sensor's noise."""
        return self.attitude == 0 and self.period <= RULES.longest_colour

    @property
    def size(self) -> float:
        """Return the standard deviation of the variation, along the way and with attitude, T."""
        return float(np.hypot(self.along, self.attitude))

    def share_of(self, twin: Twin) -> float:
        """Return its size relative to the strength of the field in a model, or to the largest plausible one."""
        strength = float(np.sqrt((twin.windows.need("field") ** 2).sum(axis=0).mean()))
        return self.size / min(strength, PLAUSIBLE_FIELD[1])

    def whiten(self, rows: Array) -> Array:
        """Whiten rows (k, 3n), already whitened for the sensors' noise, for the variation of the field too."""
        columns, less = self._whitener
        result: Array = (rows - ((rows @ columns.T) * less) @ columns) / self.noise
        return result

    @cached_property
    def _whitener(self) -> tuple[Array, Array]:
        """Orthonormal rows (r, 3n) that span the components, and the share (r,) of each that whitening removes."""
        value, vector = np.linalg.eigh(self.gram)
        kept = value > 1e-9 * max(float(value.max(initial=0.0)), 1e-300)
        columns = (vector[:, kept] / np.sqrt(value[kept])).T @ self.components
        return columns, 1 - 1 / np.sqrt(1 + value[kept])


def field_variation(
    twin: Twin, in_world: bool = True, coloured: bool = False, modes: int | None = None
) -> FieldVariation:
    """Estimate the amplitudes by maximum evidence of the innovations that a model leaves.

    Args:
        twin: the linearised model.
        in_world: True for functions in the world's axes, which are the place; False for the same functions in the
            sensor's axes, which are a cause that moves with the sensor.
        coloured: whether the magnetometer may have coloured noise, too: the fast functions of time in its own axes.
        modes: number of cosines of time; None for as many as are needed.
    """
    if modes is not None:
        return _estimated(twin, in_world, coloured, modes)
    modes = fewest(twin)
    most = min(_MOST_MODES, twin.n // 2, int(twin.duration / _SHORTEST)) if twin.n <= _LONG else modes
    noise = float(np.median(1 / twin.chain.window_scale))
    found = _estimated(twin, in_world, coloured, modes)
    while modes < most and found.period >= _SHORTEST and found.faster > _NEGLIGIBLE * found.noise * noise:
        modes = min(2 * modes, most)
        found = _estimated(twin, in_world, coloured, modes)
    return found


def _estimated(twin: Twin, in_world: bool, coloured: bool, modes: int) -> FieldVariation:
    put, shares = (_in_world, _SHARES) if in_world else (_in_sensor, (*_SHARES, *_OF_ATTITUDE))
    cosines, courses = waves(twin.time, modes)
    parts = [put(twin, cosines), put(twin, functions_of_attitude(twin.windows.need("to_sensor")))]
    if coloured:
        parts.append(_in_sensor(twin, cosines))
    raw = np.concatenate(parts)
    attitude, last = (
        slice(len(parts[0]), len(parts[0]) + len(parts[1])),
        slice(len(parts[0]) + len(parts[1]), None),
    )
    fast = courses[np.isin(CORRELATION, _FAST)]
    (sizes, shapes), (tones, colours) = _grid(courses), _grid(fast)
    gram = raw @ raw.T
    evidence = EvidenceOfAmplitudes.of(twin.base_columns, twin.residual().reshape(1, -1), raw, gram)

    def of_place(shape: int, share: int) -> Array:
        return np.concatenate([shapes[shape], np.full(len(parts[1]), shares[share] * sizes[shape])])

    # The columns whose amplitudes stay the same during several steps of the search are marginalised once.
    @cache
    def beside_colour(colour: int) -> EvidenceOfAmplitudes:
        return evidence.given(last, colours[colour]) if coloured else evidence

    @cache
    def beside_attitude(deviation: float, colour: int) -> EvidenceOfAmplitudes:
        return beside_colour(colour).given(attitude, np.full(len(parts[1]), deviation))

    @cache
    def beside_place(place: tuple[int, int]) -> EvidenceOfAmplitudes:
        return evidence.given(slice(attitude.stop), of_place(*place))

    @cache  # many of the same points are evaluated
    def log_of_place(colour: int, place: tuple[int, int]) -> float:
        shape, share = place
        return beside_attitude(shares[share] * sizes[shape], colour).log(shapes[shape])[0]

    @cache
    def log_of_colour(place: tuple[int, int], tint: tuple[int, int]) -> float:
        return beside_place(place).log(colours[tint[0]])[0]

    place, tint = (len(shapes) // 3, 1), (len(colours) // 2 if coloured else 0, 0)
    for _ in range(_SWEEPS if coloured else 1):
        place = _climbed(partial(log_of_place, tint[0]), place, len(courses), len(shares))
        tint = _climbed(partial(log_of_colour, place), tint, len(fast), 1) if coloured else tint
    (shape, share), colour = place, tint[0]
    chosen = np.concatenate([of_place(shape, share), colours[colour]] if coloured else [of_place(shape, share)])
    log, noise = evidence.log(chosen)
    constant, _ = evidence.log(np.zeros(len(raw)), fixed=True)
    period = CORRELATION[(shape - 1) % len(CORRELATION)] if shape else 0.0
    use = chosen > 0
    scaled = raw[use]
    scaled *= chosen[use, None]
    along = sizes[shape] * noise
    return FieldVariation(
        log - constant,
        along,
        shares[share] * along,
        tones[colour] * noise,
        _FAST[(colour - 1) % len(_FAST)] if colour else 0.0,
        along * _faster(twin.time, len(cosines), period) if period else 0.0,
        noise,
        period,
        scaled,
        gram[np.ix_(use, use)] * (chosen[use, None] * chosen[use]),
        int((colours[colour] > 0).sum()),
        modes,
    )


def _grid(courses: Array) -> tuple[list[float], list[Array]]:
    """Return the standard deviations of functions of time, T, and those of the amplitudes (3k,) of their modes on each
    axis: first nothing, then each size with each of the courses (c, k)."""
    grid = [(float(size), np.repeat(size * course, 3)) for size, course in product(_AMPLITUDES, courses)]
    return [0.0, *(size for size, _ in grid)], [np.zeros(3 * courses.shape[1]), *(shape for _, shape in grid)]


def fewest(twin: Twin) -> int:
    """Return the number of cosines of time that a variation is first described by."""
    return min(_MODES, twin.n // 4)


def waves(time: Array, modes: int) -> tuple[Array, Array]:
    """Return cosines of time (modes, n), and the standard deviations (3, modes) of their amplitudes.

    These are for each correlation time, with unit variance in sum.
    """
    duration = float(time[-1] - time[0])
    order = np.arange(1, modes + 1)
    cosines = np.sqrt(2) * np.cos(order[:, None] * np.pi * (time - time[0]) / duration)
    power = 1 / (1 + (np.pi * order / duration * np.array(CORRELATION)[:, None]) ** 2)
    return cosines, np.sqrt(power / power.sum(axis=1, keepdims=True))


def _faster(time: Array, modes: int, period: float) -> float:
    """Return the standard deviation of the modes of higher order, relative to that of the first `modes`."""
    step = np.pi * period / float(time[-1] - time[0])
    own = (1 / (1 + (step * np.arange(1, modes + 1)) ** 2)).sum()
    rest = (np.pi / 2 - np.arctan(step * (modes + 0.5))) / step
    return float(np.sqrt(rest / own))


def _climbed(
    log_of: Callable[[tuple[int, int]], float], start: tuple[int, int], courses: int, shares: int
) -> tuple[int, int]:
    """Return the most probable place of 0, no variation, and 1 + courses · amplitude + course, and that of the share.

    The evidence of a course has one maximum over both, which is climbed from that of the course before. One over the
    amplitude and then over the share alone is stuck where the field varies too much along the way and too little with
    attitude: of 219 sets of 31 logs 52 were 3 to 117 nats below the maximum of the grid, and none with `_MOVES`.
    """
    here, last = (max(start[0], 1), start[1]), courses * len(_AMPLITUDES)
    found = [(0, start[1])]
    for course in reversed(range(courses)):
        here = here[0] - (here[0] - 1) % courses + course, here[1]
        better: tuple[int, int] | None = here
        while better is not None:
            here = better
            near = ((here[0] + courses * more, here[1] + share) for more, share in _MOVES)
            inside = (each for each in near if 0 < each[0] <= last and 0 <= each[1] < shares)
            better = next((each for each in inside if log_of(each) > log_of(here)), None)
        found.append(here)
    return max(found, key=log_of)


def _in_world(twin: Twin, profiles: Array) -> Array:
    """Return the whitened columns (3k, 3n) of profiles (k, n) along each of the world's axes, in T as read."""
    return twin.whiten(Columns((profiles[:, None, None] * twin.windows.world_axes).reshape(-1, 3, twin.n), None))


def _in_sensor(twin: Twin, profiles: Array) -> Array:
    """Return the whitened columns (3k, 3n) of profiles (k, n) along each of the sensor's axes."""
    return twin.whiten(Columns(per_axis(profiles), None))


def functions_of_attitude(to_sensor: Array) -> Array:
    """Return basis functions (k, n) of a Gaussian process on rotations with unit variance (Nyström).

    Args:
        to_sensor: (3, 3, n) rotations.
    """
    n = to_sensor.shape[-1]
    some = np.unique(np.linspace(0, n - 1, min(n, _ATTITUDES)).astype(int))
    apart = 3 - np.einsum("abn,abm->nm", to_sensor, to_sensor[..., some])  # 2 − 2 cos θ
    kernel = np.exp(-0.5 * apart / _TURN**2)
    value, vector = np.linalg.eigh(kernel[some])
    kept = value > _LEAST
    result: Array = (kernel @ (vector[:, kept] / np.sqrt(value[kept]))).T
    return result
