"""`History`: the joint solution of many logs of one instrument, which can be extended, saved and loaded."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cached_property
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import counted, first_of
from magyc_gtsam.history.contradictions import Contradiction, contradictions_of
from magyc_gtsam.history.counted_once import CountedLogs, of_one_kind
from magyc_gtsam.history.doubt import HistoryDoubt, doubt_of
from magyc_gtsam.history.forward import JUMPED, REFITTED, Bank
from magyc_gtsam.history.grouping import Grouping
from magyc_gtsam.history.instrument import Instrument, solve_instrument
from magyc_gtsam.history.log_factor import MICROTESLA, PER_MILLE, LogFactor, factor_of
from magyc_gtsam.history.model import HistoryModel
from magyc_gtsam.history.predicted import log_calibration, next_calibration
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.recording.expected import expect_recording
from magyc_gtsam.storage.files import expect_path, write_text
from magyc_gtsam.storage.json_types import json_types
from magyc_gtsam.storage.mapping import parse_json, parse_yaml

_FORMAT = "magyc-gtsam history 4"
_EARLIER = (
    "magyc-gtsam history 1",
    "magyc-gtsam history 2",
    "magyc-gtsam history 3",
)  # with none or other filters, which are computed again
_WORTH_KEEPING = 10  # number of logs below which filtering again takes no longer than reading the filter
_LIST = ",\n"


class History:
    """The joint solution of many logs of one instrument. Created by `calibrate_many` or `History.load`.

    Indices count the logs in the order given. If all calibrated logs have a date, the random walk runs in days;
    otherwise the logs are equally spaced.

    Attributes:
        factors: the compressed information of each log.
        model: assumptions about the instrument between the logs.
        options: options of `calibrate` for logs that are added.
        counted: the logs by their samples, which count once.
    """

    def __init__(
        self,
        factors: Sequence[LogFactor],
        *,
        model: HistoryModel | None = None,
        options: dict[str, Any] | None = None,
        groups: Sequence[Sequence[int]] | None = None,
        banks: Sequence[Bank] = (),
    ) -> None:
        """Solve compressed logs, continuing the groups and filters of an earlier history, if given."""
        self.options = dict(options or {})
        self.model = model or _model_for(self.options)
        self.counted = CountedLogs()
        self.factors = of_one_kind(self.counted.take(factors))
        self._grouping = Grouping(self.factors, self.model, groups)
        self._banks = tuple(banks)
        if not self.groups:
            each = "; ".join(first_of([f"{factor.name}: {factor.problem}" for factor in self.factors], "logs"))
            logs = counted(len(factors), "log")
            raise MagycError(f"history: no trusted calibration in {logs}, and one is needed ({each})")

    def __len__(self) -> int:
        return len(self.factors)

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """The indices of logs that can be of one instrument, the largest group first.

        A log without a trusted calibration is in no group.
        """
        return self._grouping.groups

    @cached_property
    def _instruments(self) -> tuple[Instrument, ...]:
        """One instrument per group; logs without a calibration count as logs of the largest group."""
        uncalibrated = [i for i, factor in enumerate(self.factors) if factor.mean is None]
        times = self.times
        when = range(len(self)) if times is None else times
        factors = [replace(factor, time=time) for factor, time in zip(self.factors, when, strict=True)]
        members = [list(group) for group in self.groups]
        members[0] += uncalibrated
        return tuple(
            solve_instrument(
                factors,
                sorted(group, key=when.__getitem__),
                self.model,
                dated=times is not None,
                known=self._banks,
            )
            for group in members
        )

    @property
    def times(self) -> tuple[float, ...] | None:
        """The date of each log in s since 1970; None if a calibrated log has none.

        A log that could not be read has the date of the log before it, in the order given.
        """
        if any(factor.time is None and factor.mean is not None for factor in self.factors):
            return None
        last = next(factor.time for factor in self.factors if factor.time is not None)
        result = []
        for factor in self.factors:
            last = last if factor.time is None else factor.time
            result.append(last)
        return tuple(result)

    def _of(self, values: Callable[[Instrument], Array]) -> Array:
        """Return one row per log from the rows of the instruments."""
        result: Array | None = None
        for instrument in self._instruments:
            rows = values(instrument)
            if result is None:
                result = np.zeros((len(self), *rows.shape[1:]))
            result[list(instrument.order)] = rows
        assert result is not None
        return result

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the logs."""
        return tuple(factor.name for factor in self.factors)

    @property
    def hard_iron(self) -> Array:
        """Hard iron (k, 3) in T at each log, from all logs of its instrument; the estimate at a wrong log does not
        use that log.
        """
        return self._of(lambda instrument: instrument.hard_iron) * MICROTESLA

    @property
    def hard_iron_covariance(self) -> Array:
        """Covariance (k, 3, 3) of `hard_iron` in T²."""
        return self._of(lambda instrument: instrument.hard_iron_covariance) * MICROTESLA**2

    @property
    def jumps(self) -> list[tuple[int, Array, Array]]:
        """One (index of the first log after it, size (3,) T, sigma (3,) T) per jump of the hard iron."""
        jumps = []
        for instrument in self._instruments:
            size = np.diff(instrument.hard_iron, axis=0) * MICROTESLA
            for k in np.flatnonzero((instrument.label == JUMPED) | (instrument.label == REFITTED)):
                sigma = np.sqrt(np.diag(instrument.change(int(k)))) * MICROTESLA
                jumps.append((instrument.order[k], size[k - 1], sigma))
        return sorted(jumps, key=lambda jump: jump[0])

    @property
    def refits(self) -> list[int]:
        """The indices of the first logs after a change of the soft iron, which are among those of `jumps`."""
        found = (i.order[k] for i in self._instruments for k in np.flatnonzero(i.label == REFITTED))
        return sorted(found)

    @property
    def walk(self) -> float:
        """The random walk of the largest group's hard iron, T per √day (per √log without dates)."""
        return self._instruments[0].walk * MICROTESLA

    @cached_property
    def contradictions(self) -> tuple[Contradiction, ...]:
        """The logs that are not used: without a calibration, or contradicting the others, and in which parameter."""
        return contradictions_of(self.factors, self.groups, self._instruments)

    @cached_property
    def calibrations(self) -> tuple[Calibration, ...]:
        """One calibration per log from all logs of its instrument."""
        result: dict[int, Calibration] = {}
        for instrument in self._instruments:
            for k, i in enumerate(instrument.order):
                result[i] = log_calibration(self.factors, instrument, k)
        return tuple(result[i] for i in range(len(self)))

    @cached_property
    def doubt(self) -> HistoryDoubt | None:
        """Why `next` must not be used; None if it may."""
        return doubt_of(self.factors, self.groups, self._instruments)

    @cached_property
    def next(self) -> Calibration:
        """The calibration for the next log of the largest group; its covariance includes the walk until then.

        It is not trusted where there is a `doubt`.
        """
        following = next_calibration(self.factors, self._instruments[0])
        if self.doubt is None:
            return following
        return replace(following, converged=False, message=self.doubt.sentence)

    def add(self, recording: Recording, *, time: Any = None) -> History:
        """Add one more log without reading the others again; the result equals that of all logs at once.

        Args:
            recording: the log to add.
            time: s since 1970, or a calendar stamp; None takes it from the recording, if that has a date.

        Returns:
            This history.

        Raises:
            MagycError: not a recording, or no time.
        """
        expect_recording("History.add", recording)
        return self.extend([factor_of(recording, time, self.options)])

    def extend(self, factors: Sequence[LogFactor]) -> History:
        """Add logs that are already compressed, and return this history."""
        self._banks = self._filters
        of_one_kind((*self.factors, *factors))
        added = self.counted.take(factors)
        self.factors = (*self.factors, *added)
        self._grouping.add(added)
        for name in ("_instruments", "calibrations", "next", "contradictions", "doubt"):
            self.__dict__.pop(name, None)
        return self

    @property
    def _filters(self) -> tuple[Bank, ...]:
        """The filters of all instruments, which `extend` and `load` continue."""
        return tuple(instrument.bank for instrument in self._instruments)

    def to_dict(self) -> dict[str, Any]:
        """Return everything needed to restore the history, as JSON types."""
        return {
            "format": _FORMAT,
            "options": json_types(self.options, finite=False),
            "model": asdict(self.model),
            "logs": [factor.to_dict() for factor in self.factors],
            "groups": [list(group) for group in self.groups],
            "filters": [bank.to_dict() for bank in self._filters if len(bank.order) >= _WORTH_KEEPING],
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the history bit for bit as JSON, which is valid YAML and read fast, replacing the file atomically."""
        lines = [
            f"{json.dumps(name)}: "
            + (f"[\n{_LIST.join(map(_dumped, value))}\n]" if isinstance(value, list) else _dumped(value))
            for name, value in self.to_dict().items()
        ]
        write_text(expect_path("save", path), "{\n" + _LIST.join(lines) + "\n}\n")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> History:
        """Read a history that `save` wrote.

        Raises:
            MagycError: the file does not exist, cannot be read or is not a history.
        """
        path = expect_path("History.load", path)
        try:
            data = _parsed(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise MagycError(f"{path}: no such file") from None
        except OSError as error:
            raise MagycError(f"{path}: cannot be read ({error.strerror})") from None
        except UnicodeDecodeError:
            raise MagycError(f"{path}: not a text file; a history.yaml is expected here") from None
        except MagycError as error:
            raise MagycError(f"{path}: {error}") from None
        if not isinstance(data, dict) or data.get("format") not in (_FORMAT, *_EARLIER):
            raise MagycError(f"{path}: not a history (format must be {_FORMAT!r})")
        try:
            model = HistoryModel(**data["model"])
            logs = [LogFactor.from_dict(log) for log in data["logs"]]
            saved = data.get("filters", ()) if data["format"] == _FORMAT else ()
            banks = [Bank.from_dict(bank, len(logs)) for bank in saved]
            return cls(logs, model=model, options=data["options"], groups=data.get("groups"), banks=banks)
        except MagycError as error:
            raise MagycError(f"{path}: {error}") from None
        except (KeyError, TypeError, ValueError) as error:
            raise MagycError(f"{path}: a damaged history ({type(error).__name__}: {error})") from None


def _model_for(options: Mapping[str, Any]) -> HistoryModel:
    """Return the default model, with the prior of the gyroscope's scale that logs are calibrated with."""
    deviation = options.get("gyroscope_scale")
    return HistoryModel(gyroscope_scale=deviation / PER_MILLE) if deviation else HistoryModel()


def _dumped(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)


def _parsed(text: str) -> Any:
    """Parse JSON, which is read faster, or YAML, in which the first format was written."""
    return parse_json(text) if text.startswith("{") else parse_yaml(text)
