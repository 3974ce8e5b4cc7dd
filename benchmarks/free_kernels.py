"""How fast `calibrate` would be if some of its functions cost nothing: a bound on what a compiled extension could gain.

    python benchmarks/free_kernels.py

The results of these functions are recorded in one call of `calibrate` and handed out again in the next, in the same
order, so that all else runs as always. Prints for each motion and each group of functions (every group adds to those
above it) the processor time of 10 minutes at 10 Hz now and with the functions free, in the median over the recordings,
the ratio, and the share of numpy's time that replacements may take if the whole is to be `--factor` times as fast.
"""

import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"  # read when numpy is loaded

import argparse
import copy
import functools
import importlib
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

import magyc_gtsam as mg

MOTIONS = ("wide", "moderate", "low", "tiny")
_CHAIN, _FIT, _ERROR = "factors.chain", "estimators.smoother", "estimators.model_error"
GROUPS = {
    "elimination, integration, splines": (
        f"{_CHAIN}.field_chain:FieldChain.eliminate",
        f"{_CHAIN}.preintegration:Preintegration.integrate",
        f"{_CHAIN}.banded:forward_solved",
        f"{_ERROR}.motion:WindowMotion.derivative",
        f"{_ERROR}.motion:WindowMotion.integral",
    ),
    "rest of the chain, start, screen": (
        f"{_CHAIN}.banded:backward_solved",
        f"{_CHAIN}.chain_values:Reduced.absorbed",
        *(
            f"{_CHAIN}.field_chain:FieldChain.{name}"
            for name in ("residuals", "move", "start", "settled", "squares")
        ),
        f"{_FIT}.noise_levels:explained",
        f"{_FIT}.starts:from_gyroscope",
        f"{_FIT}.whitened_fit:WhitenedFit.border",
        "sensor_faults.screen:may_be_faulty",
    ),
    "windows, tests of samples": (
        *(f"{_ERROR}.samples:{name}" for name in ("flickers", "too_slow", "one_sided", "coarse_step")),
        f"{_ERROR}.alternating:alternating",
        f"{_FIT}.preparation:preintegrate",
        f"{_FIT}.preparation:short_term_noise",
        f"{_FIT}.clock_drift:find_drift",
    ),
    "columns of the families": (
        *(f"{_FIT}.beside:ColumnProducts.{name}" for name in ("_dense", "_products")),
        f"{_ERROR}.families:ColumnFamily.columns_of",
    ),
}


class Replay:
    """Records the results of functions and hands them out again."""

    def __init__(self) -> None:
        self.mode, self.inside = "live", False
        self.recorded: dict[str, list[Any]] = {}
        self.left: dict[str, Iterator[Any]] = {}

    def play(self) -> None:
        """Hand out copies of what was recorded from now on; results may be written to."""
        self.left = {name: iter([_copy(each) for each in results]) for name, results in self.recorded.items()}
        self.mode = "play"

    def wrapped(self, name: str, function: Callable) -> Callable:
        """Return the function, recorded or replayed; what it calls itself is neither."""

        @functools.wraps(function)
        def call(*arguments: Any, **named: Any) -> Any:
            if self.mode == "play":
                return next(self.left[name])
            if self.mode == "live" or self.inside:
                return function(*arguments, **named)
            self.inside = True
            result = function(*arguments, **named)
            self.inside = False
            self.recorded.setdefault(name, []).append(_copy(result))
            return result

        return call

    @contextmanager
    def of(self, names: list[str]) -> Iterator[None]:
        """Put the wrapped functions in the place of those in `names`, wherever they are imported."""
        replaced = []
        for name in names:
            module, _, path = name.partition(":")
            owner = functools.reduce(
                getattr, path.split(".")[:-1], importlib.import_module(f"magyc_gtsam.{module}")
            )
            function = vars(owner)[path.split(".")[-1]]
            own = [owner] if isinstance(owner, type) else [m for k, m in sys.modules.items() if "magyc_gtsam" in k]
            wrapped = self.wrapped(name, function)
            for place in own:
                for key in [key for key, value in vars(place).items() if value is function]:
                    replaced.append((place, key, function))
                    setattr(place, key, wrapped)
        yield
        for place, key, function in replaced:
            setattr(place, key, function)


def _copy(result: Any) -> Any:
    """Return a copy; groups of columns, which share their axes, and windows of samples are only read."""
    read_only = ("Products", "RateErrors", "UnmodelledColumns", "Preintegration")
    return result if type(result).__name__ in read_only else copy.deepcopy(result)


def timed(recording: mg.Recording) -> tuple[float, mg.Calibration]:
    """Return the processor time of a calibration, ms, and the calibration."""
    begun = time.process_time()
    result = mg.calibrate(recording)
    return 1e3 * (time.process_time() - begun), result


def in_turns(recording: mg.Recording, names: list[str], repeat: int) -> tuple[float, float]:
    """Return the least processor time as always, and with the named functions free."""
    replay, always, free = Replay(), [], []
    with replay.of(names):
        replay.mode = "record"
        recorded = mg.calibrate(recording)
        for _ in range(repeat):
            replay.mode = "live"
            always.append(timed(recording)[0])
            replay.play()
            took, result = timed(recording)
            free.append(took)
        assert result.message == recorded.message
        assert np.allclose(result.hard_iron, recorded.hard_iron, rtol=1e-9)
    return min(always), min(free)


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--repeat", type=int, default=15, help="pairs of calls per recording; the least counts")
    parser.add_argument("--factor", type=float, default=2.0, help="by which the whole is to be faster")
    arguments = parser.parse_args()
    mg.calibrate(mg.simulate("wide", seed=99).recording)  # imports are not part of the time
    print(f"{'free, with those above':36s}{'motion':10s}{'now ms':>8s}{'free ms':>9s}{'ratio':>7s}{'share':>8s}")
    names: list[str] = []
    for title, more in GROUPS.items():
        names += more
        for motion in MOTIONS:
            logs = [mg.simulate(motion, seed=seed).recording for seed in range(arguments.seeds)]
            before, after = np.median([in_turns(log, names, arguments.repeat) for log in logs], axis=0)
            share = (before / arguments.factor - after) / (before - after)
            row = f"{before:8.2f}{after:9.2f}{before / after:7.2f}{share:8.0%}"
            print(f"{title:36s}{motion:10s}{row}", flush=True)


if __name__ == "__main__":
    main()
