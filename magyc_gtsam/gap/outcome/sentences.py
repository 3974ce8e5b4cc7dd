"""The sentences of several effects, with all tones in one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from magyc_gtsam.gap.result import Effect

_TONE = "tone"


def sentences(effects: Sequence[Effect]) -> list[str]:
    """Return a sentence for each effect, of several tones one in the place of the first."""
    tones = [effect for effect in effects if effect.name == _TONE]
    if len(tones) < 2:
        return [effect.sentence for effect in effects]
    frequencies = _enumerated([f"{effect.setting['frequency']:.2f}" for effect in tones])
    sizes = _enumerated([f"{float(np.linalg.norm(effect.value)):.2g}" for effect in tones])
    together = f"tones of {frequencies} Hz, {sizes} {tones[0].unit}, are on the magnetometer"
    return [
        together if effect is tones[0] else effect.sentence
        for effect in effects
        if effect.name != _TONE or effect is tones[0]
    ]


def _enumerated(values: Sequence[str]) -> str:
    return f"{', '.join(values[:-1])} and {values[-1]}"
