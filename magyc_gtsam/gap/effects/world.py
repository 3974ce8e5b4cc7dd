"""A field that differs from place to place: a gradient with depth or position, or a magnetic object that is near."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.changes import Setting
from magyc_gtsam.foreign_text import two_digits
from magyc_gtsam.gap.effects.iron import edges_of, references, step_nearby
from magyc_gtsam.gap.effects.term import AXES, NEARBY, EffectTerm, measured
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.rules import RULES

_WIDTHS = (3.0, 8.0, 20.0)  # s, standard deviations of the bump
_SPACING = 2.0  # of the centres, in widths; the derivative of the bump covers times between them
_CENTRES = 170  # largest number of centres for each width
# Times at which the field of the place may change, and each of some windows at both ends: a log begins and ends where
# the vehicle is picked up and put down.
_PLACES = 100
_AT_ENDS = 20
# times at which it may be the first one again; if the direction of the field changes more than its strength, a stay
# whose end is a few seconds off explains no more than one without an end
_ENDS = 300


def _directions(twin: Twin) -> list[dict[str, float]]:
    """Return the vertical row alone, and all rows of the channel; depth and downward position count as one row."""
    every = references(twin, "position")
    if len(every) < 2:
        return [every]
    rows = twin.windows.channels["position"]
    rows = rows[rows.std(axis=1) > 0]
    alike = np.abs(np.corrcoef(rows)) > RULES.same_row
    own = [i for i in range(len(alike)) if not alike[i, :i].any()]
    vertical = next((i for i in own if alike[i].sum() > 1), len(alike) - 1)
    names = list(every)
    return [{names[i]: every[names[i]] for i in some} for some in ([vertical], own)]


def _widths(twin: Twin) -> list[float]:
    return [width for width in _WIDTHS if width <= 0.15 * twin.duration]


def _bumps(twin: Twin) -> list[dict[str, float]]:
    start, end = float(twin.time[0]), float(twin.time[-1])
    settings = []
    for width in _widths(twin):
        count = min(int((end - start) / (_SPACING * width)), _CENTRES)
        centres = np.linspace(start + width, end - width, count)
        settings += [{"time": float(t), "width": width, "passing": 1.0} for t in centres]
    return settings


def _passings_and_stays(twin: Twin) -> list[dict[str, float]]:
    """Return objects that are passed, and stays beside one at the beginning or at the end of the recording.

    Of two places of which none is known to be undisturbed, that of the longer stay counts as undisturbed.
    """
    middle = 0.5 * float(twin.time[0] + twin.time[-1])
    every = edges_of(twin, twin.n, 0)  # the vehicle may be picked up within the first window
    changes = sorted({*edges_of(twin, _PLACES, 0), *every[:_AT_ENDS], *every[-_AT_ENDS:]})
    return _bumps(twin) + _possible(
        twin, [{"until" if time < middle else "time": float(time)} for time in changes]
    )


def _stays_between(twin: Twin, time: float) -> list[dict[str, float]]:
    """Return stays that begin or end at a time; an object beside which the vehicle is for less was passed.

    One of more than half of the recording is undisturbed, and the field before and after it another one.
    """
    shortest = 2 * max(_widths(twin), default=_WIDTHS[0])
    ends = [float(end) for end in edges_of(twin, _ENDS, 0)]
    half = 0.5 * twin.duration
    pairs = [sorted((time, end), reverse=abs(end - time) > half) for end in ends if abs(end - time) > shortest]
    return _possible(twin, [{"time": begin, "until": end} for begin, end in pairs])


def _possible(twin: Twin, stays: list[dict[str, float]]) -> list[dict[str, float]]:
    """Return those stays in which the vehicle turns, or at whose ends it moves.

    Without turns its hard iron may have changed instead of the place. But a place changes while the vehicle moves, as
    where it is put on a table, and a magnet may be attached at rest.
    """
    ends = _ends(stays)
    moves = (turned(twin, ends - RULES.at_once, ends + RULES.at_once) > RULES.stay_moves) | np.isinf(ends)
    return [stay for stay, one in zip(stays, _turns(twin, stays) | moves.all(axis=1), strict=True) if one]


def _turns(twin: Twin, stays: list[dict[str, float]]) -> np.ndarray:
    """Return in which of the stays the vehicle turns (k,) bool."""
    return np.asarray(turned(twin, *_ends(stays).T) > RULES.stay_turns)


def _ends(stays: list[dict[str, float]]) -> Array:
    """Return when each stay begins and ends (k, 2), s; infinite if it does not."""
    return np.array([[stay.get("time", -np.inf), stay.get("until", np.inf)] for stay in stays]).reshape(-1, 2)


def turned(twin: Twin, start: Array, end: Array) -> Array:
    """Return the root mean square rotation (...), rad, of the vehicle from each start to each end (...), s; at most 1.

    The rate is that beyond the one at rest. Beside a jump of the iron that is not yet in it a model has a wrong bias,
    with which a rest turns: that of BROAD 32 by 0.1 rad within two seconds.
    """
    return twin.problem.track(twin.model.parameters[9:12]).turned(start, end)


def _changes_strength(twin: Twin, value: Array, setting: Setting) -> bool:
    """Return whether a field of the place that does not end changes the strength, too.

    One that is only turned is a turn that the gyroscope missed, as by a wrong sample, after which the world of the
    model is another one for good.
    """
    if "width" in setting or {"time", "until"} <= setting.keys():
        return True
    windows = twin.windows
    soft = windows.need("soft_iron")
    true = np.linalg.solve(soft / np.cbrt(np.linalg.det(soft)), windows.need("field"))
    field = np.einsum("jkn,jn->k", windows.need("to_sensor"), true) / twin.n
    change = abs(float(np.linalg.norm(field + value) - np.linalg.norm(field)))
    return change > RULES.stay_stronger * float(np.linalg.norm(value))


def _nearby(twin: Twin, setting: Setting) -> list[dict[str, float]]:
    if "width" not in setting:
        near = _possible(twin, step_nearby(twin, setting, _PLACES, 0))
        one_end = len(setting) == 1 and _turns(twin, [dict(setting)])[0]
        return near + (_stays_between(twin, *setting.values()) if one_end else [])
    time, width = setting["time"], setting["width"]
    return [
        {"time": time + shift * width, "width": width * stretch, "passing": passing}
        for passing in (0.0, 1.0)
        for stretch in NEARBY
        for shift in (-1.0, -0.6, -0.3, 0.0, 0.3, 0.6, 1.0)
    ]


def _say_gradient(value: Array, sigma: Array, setting: Setting) -> str:
    return f"the field's strength changes by {measured(value[0], sigma[0])} % per unit of depth or position"


def _say_anomaly(value: Array, sigma: Array, setting: Setting) -> str:
    if "width" not in setting:
        return (
            f"the field of the place was another one {_when(setting)}, by {np.linalg.norm(value):.2g} µT: something "
            "magnetic was near the vehicle"
        )
    return (
        f"something magnetic in the surroundings was passed at {setting['time']:.0f} s "
        f"({two_digits(setting['width'])} s wide, {np.linalg.norm(value[:3]):.2g} µT)"
    )


def _when(setting: Setting) -> str:
    """Return "from 10 s to 20 s", "until 20 s", "from 10 s on" or "until 10 s and from 20 s on"."""
    begin, end = (setting.get(name) for name in ("time", "until"))
    if begin is not None and end is not None and begin < end:
        return f"from {begin:.0f} s to {end:.0f} s"
    parts = [f"until {end:.0f} s"] if end is not None else []
    return " and ".join(parts + ([f"from {begin:.0f} s on"] if begin is not None else []))


GRADIENT = EffectTerm(
    name="field-gradient",
    label="field strength that changes with depth or position",
    physics=(
        "A wreck, a pier or magnetic rock changes the field's strength with depth or position. The reading "
        "grows or shrinks by a share, in all axes. Only a recording that visits each depth on several "
        "headings shows that it is not the attitude."
    ),
    unit="% per unit",
    matters=6e-3,
    rivals=("eddy-plane",),
    parameters=("gradient",),
    say=_say_gradient,
    motion="go up and down (or there and back) several times, turning at each depth",
    settings=_directions,
)
ANOMALY = EffectTerm(
    name="local-anomaly",
    label="magnetic object in the surroundings",
    physics=(
        "Something magnetic that is fixed in the world is passed, or the vehicle stays beside it: a chain, a ship's "
        "side, reinforced concrete. Its field adds to that of the Earth, and its direction turns as it is passed. If "
        "the vehicle does not turn or tilt meanwhile, it looks like two jumps of the hard iron."
    ),
    unit="µT",
    matters=0.5e-6,
    prior=1e-3,
    rivals=("hard-iron-step", "hard-iron-drift"),
    parameters=tuple(f"world {a}" for a in AXES),
    say=_say_anomaly,
    motion="pass the same place again on another heading",
    settings=_passings_and_stays,
    refined=_nearby,
    block=lambda setting: float(np.clip(0.5 * setting.get("width", np.inf), 1.0, RULES.block)),
    most=3,
    possible=_changes_strength,
)
