"""Foreign effects from a Python file: functions from the arrays of a recording to those that they change.

So that what a diagnosis must call unknown can come from somebody who knows neither its rules nor the simulator's
effects. A function is called as `effect(arrays, factor, random)`:

- arrays: of a recording without any effect, by name: "time" (N,) s, "magnetic_field" (N, 3) T, "angular_rate" (N, 3)
  rad/s, "acceleration" (N, 3) m/s², "attitude" (N, 4) quaternion x, y, z, w sensor → world, and channels as
  "channel temperature" (N,) and so on. They are copies, to be changed at will.
- factor: on the strength that the function takes for 1; 2, 0.5 and 0.25 are tried as well.
- random: a `numpy.random.Generator` of the recording's own seed.

It gives back a dictionary of the arrays that it changes; time and attitude are not to be changed. Each function of the
file whose name does not begin with an underscore is an effect.
"""

from __future__ import annotations

import importlib.util
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from magyc_gtsam.blindtest.scenarios import FACTORS, Scenario, seed_of
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.storage.checksum import sha256

Function = Callable[[dict[str, Array], float, np.random.Generator], Mapping[str, Array]]
_SENSORS = ("magnetic_field", "angular_rate", "acceleration")
_CHANNEL = "channel "


@dataclass(frozen=True, eq=False)
class Outside:
    """The effects of a file.

    Attributes:
        name: of the file, without its ending.
        mark: the first digits of its checksum, which tell one version of it from another.
        effects: {"file.function": function}.
    """

    name: str
    mark: str
    effects: Mapping[str, Function]

    @classmethod
    def read(cls, path: Path) -> Outside:
        """The functions of a Python file, which is run.

        Raises:
            MagycError: there is no such file, it fails, or it has no function.
        """
        if path.suffix != ".py" or not path.is_file():
            raise MagycError(f"{path}: a Python file (.py) with functions is needed")
        spec = importlib.util.spec_from_file_location(path.stem, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except Exception as problem:
            raise MagycError(
                f"{path}: {type(problem).__name__}: {problem}; the file must run by itself"
            ) from problem
        own = {
            f"{path.stem}.{name}": function
            for name, function in inspect.getmembers(module, inspect.isfunction)
            if not name.startswith("_") and function.__module__ == module.__name__
        }
        if not own:
            raise MagycError(f"{path}: holds no function; define effect(arrays, factor, random) in it")
        return cls(path.stem, sha256(path)[:8], own)

    def scenarios(self, motion: str, runs: int, edition: int, duration: float = 600.0) -> list[Scenario]:
        """Every effect at every strength, as often as the foreign ones of the simulator."""
        result = []
        for name in self.effects:
            for factor in FACTORS:
                for k in range(max(1, round(runs / 30))):
                    label = f"foreign-{motion}-{name}-{self.mark}-x{factor:g}-{k:02d}"
                    seed = seed_of(label, edition)
                    result.append(Scenario(label, "foreign", motion, seed, ((name, factor),), (), duration))
        return result


def changed(recording: Recording, name: str, function: Function, factor: float, seed: int) -> Recording:
    """A recording with an effect from outside in it.

    Raises:
        MagycError: the function fails, or gives back what no recording can hold.
    """
    arrays = {"time": recording.time, "attitude": recording.attitude}
    arrays |= {key: getattr(recording, key) for key in _SENSORS}
    arrays |= {_CHANNEL + key: value for key, value in recording.channels.items()}
    given = {key: np.array(value) for key, value in arrays.items() if value is not None}
    shapes = {key: value.shape for key, value in given.items() if key not in ("time", "attitude")}
    try:
        result = function(given, factor, np.random.default_rng([seed, 3]))
    except Exception as problem:
        raise MagycError(f"{name}: {type(problem).__name__}: {problem}") from problem
    if not isinstance(result, Mapping):
        raise MagycError(f"{name}: gives back {type(result).__name__}, a dictionary of arrays is needed")
    new: dict[str, Any] = {}
    for key, value in result.items():
        array = np.asarray(value, dtype=float)
        if key not in shapes:
            raise MagycError(f"{name}: gives back {key!r}, which is not one of {', '.join(shapes)}")
        if array.shape != shapes[key] or not np.isfinite(array).all():
            raise MagycError(f"{name}: {key!r} must be finite and of shape {shapes[key]}, got shape {array.shape}")
        new[key] = array
    channels = {k: new.get(_CHANNEL + k, v) for k, v in recording.channels.items()}
    return replace(recording, channels=channels, **{key: new[key] for key in _SENSORS if key in new})
