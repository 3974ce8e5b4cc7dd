"""Foreign effects from a Python file, whose functions change the arrays of a recording.

The effects that a diagnosis must call unknown can thus come from somebody who knows neither its rules nor the
simulator's effects. A function is called as `effect(arrays, factor, random)`:

- arrays: the arrays of a recording without any effect, by name: "time" (N,) s, "magnetic_field" (N, 3) T,
  "angular_rate" (N, 3) rad/s, "acceleration" (N, 3) m/s², "attitude" (N, 4) quaternion x, y, z, w sensor → world, and
  channels as "channel temperature" (N,) and so on. They are copies and may be changed.
- factor: factor on the function's own strength; 1, 2, 0.5 and 0.25 are used.
- random: a `numpy.random.Generator` with the recording's seed.

It returns a dictionary of the arrays that it changes, which must not be time or attitude. Each function of the file
whose name does not begin with an underscore is an effect.
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
from magyc_gtsam.storage.files import sha256

Function = Callable[[dict[str, Array], float, np.random.Generator], Mapping[str, Array]]
_SENSORS = ("magnetic_field", "angular_rate", "acceleration")
_CHANNEL = "channel "


@dataclass(frozen=True, eq=False)
class EffectsFromFile:
    """The effects of a file.

    Attributes:
        name: name of the file without suffix.
        mark: first digits of its checksum, which distinguish its versions.
        effects: {"file.function": function}.
    """

    name: str
    mark: str
    effects: Mapping[str, Function]

    @classmethod
    def read(cls, path: Path) -> EffectsFromFile:
        """Run a Python file and return its functions.

        Raises:
            MagycError: the file does not exist, fails or has no function.
        """
        if path.suffix != ".py" or not path.is_file():
            raise MagycError(f"{path}: must be an existing Python file (.py) with functions")
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
        functions = {
            f"{path.stem}.{name}": function
            for name, function in inspect.getmembers(module, inspect.isfunction)
            if not name.startswith("_") and function.__module__ == module.__name__
        }
        if not functions:
            raise MagycError(f"{path}: holds no function; define effect(arrays, factor, random) in it")
        return cls(path.stem, sha256(path)[:8], functions)

    def scenarios(self, motion: str, runs: int, edition: int, duration: float = 600.0) -> list[Scenario]:
        """Return a scenario per effect and strength, as many of each as of the simulator's foreign effects."""
        result = []
        for name in self.effects:
            for factor in FACTORS:
                for k in range(max(1, round(runs / 30))):
                    label = f"foreign-{motion}-{name}-{self.mark}-x{factor:g}-{k:02d}"
                    seed = seed_of(label, edition)
                    result.append(Scenario(label, "foreign", motion, seed, ((name, factor),), (), duration))
        return result


def changed(recording: Recording, name: str, function: Function, factor: float, seed: int) -> Recording:
    """Return a recording with an effect from outside.

    Raises:
        MagycError: the function fails, or returns arrays that a recording cannot hold.
    """
    given = {"time": recording.time, "attitude": recording.attitude}
    given |= {key: getattr(recording, key) for key in _SENSORS}
    given |= {_CHANNEL + key: value for key, value in recording.channels.items()}
    arrays = {key: value for key, value in given.items() if value is not None}
    copies = {key: np.array(value) for key, value in arrays.items()}
    shapes = {key: value.shape for key, value in copies.items() if key not in ("time", "attitude")}
    try:
        result = function(copies, factor, np.random.default_rng([seed, 3]))
    except Exception as problem:
        raise MagycError(f"{name}: {type(problem).__name__}: {problem}") from problem
    if not isinstance(result, Mapping):
        raise MagycError(f"{name}: must return a dictionary of arrays, got {type(result).__name__}")
    new: dict[str, Any] = {}
    for key, value in result.items():
        array = np.asarray(value, dtype=float)
        if key not in shapes:
            raise MagycError(f"{name}: returns {key!r}, which is not one of {', '.join(shapes)}")
        bad = np.count_nonzero(~np.isfinite(array))
        if array.shape != shapes[key] or bad:
            got = f"{bad} values that are not finite" if array.shape == shapes[key] else f"shape {array.shape}"
            raise MagycError(f"{name}: {key!r} must be finite and of shape {shapes[key]}, got {got}")
        new[key] = array
    if all(np.array_equal(new[key], arrays[key]) for key in new):
        raise MagycError(f"{name}: changes nothing at factor {factor:g}; return the changed arrays by their names")
    channels = {k: new.get(_CHANNEL + k, v) for k, v in recording.channels.items()}
    try:
        return replace(recording, channels=channels, **{key: new[key] for key in _SENSORS if key in new})
    except MagycError as problem:
        raise MagycError(f"{name}: returns arrays that a recording cannot hold: {problem}") from None
