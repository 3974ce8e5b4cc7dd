"""A field that differs from place to place: a gradient with depth or position, or a magnetic object passed by."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.changes import Setting
from magyc_gtsam.gap.effects.iron import references
from magyc_gtsam.gap.effects.term import AXES, NEARBY, EffectTerm, measured
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.rules import RULES

_WIDTHS = (3.0, 8.0, 20.0)  # s, standard deviations of the bump
_SPACING = 2.0  # of the centres, in widths; the derivative of the bump covers times between them
_CENTRES = 170  # largest number of centres for each width


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


def _bumps(twin: Twin) -> list[dict[str, float]]:
    start, end = float(twin.time[0]), float(twin.time[-1])
    settings = []
    for width in _WIDTHS:
        if width > 0.15 * (end - start):
            continue
        count = min(int((end - start) / (_SPACING * width)), _CENTRES)
        centres = np.linspace(start + width, end - width, count)
        settings += [{"time": float(t), "width": width, "passing": 1.0} for t in centres]
    return settings


def _bumps_nearby(twin: Twin, setting: Setting) -> list[dict[str, float]]:
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
    return (
        f"something magnetic in the surroundings was passed at {setting['time']:.0f} s "
        f"({setting['width']:.0f} s wide, {np.linalg.norm(value[:3]):.2g} µT)"
    )


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
    label="magnetic object passed by",
    physics=(
        "Something magnetic that is fixed in the world is passed: a chain, a pipeline, reinforced concrete. "
        "Its field adds to that of the Earth for some seconds, and its direction turns as it is passed. If "
        "the vehicle does not turn meanwhile, it looks like two jumps of the hard iron."
    ),
    unit="µT",
    matters=0.5e-6,
    prior=1e-3,
    rivals=("hard-iron-step", "hard-iron-drift"),
    parameters=tuple(f"world {a}" for a in AXES),
    say=_say_anomaly,
    motion="pass the same place again on another heading",
    settings=_bumps,
    refined=_bumps_nearby,
    block=lambda setting: float(np.clip(0.5 * setting["width"], 1.0, RULES.block)),
    most=2,
)
