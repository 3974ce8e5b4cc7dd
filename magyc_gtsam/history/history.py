"""`calibrate_many`: one instrument over many logs; what stays, what moved, and when."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators import calibrate
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.history.contradictions import Contradiction, contradictions_of
from magyc_gtsam.history.forward import JUMPED, Bank
from magyc_gtsam.history.grouping import Grouping
from magyc_gtsam.history.instrument import Instrument, solve_instrument
from magyc_gtsam.history.log_factor import MICROTESLA, LogFactor, compress, date_of
from magyc_gtsam.history.model import HistoryModel
from magyc_gtsam.history.predicted import log_calibration, next_calibration
from magyc_gtsam.one_thread import one_thread
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.storage.mapping import parse_json, parse_yaml
from magyc_gtsam.storage.whole_file import write_text

_FORMAT = "magyc-gtsam history 2"
_FIRST_FORMAT = "magyc-gtsam history 1"  # without groups and filters, which are made anew
_WORTH_KEEPING = 10  # logs; a filter over fewer is as soon run again
_LIST = ",\n"
Progress = Callable[[float], None]


class History:
    """What many logs say of one instrument. Made by `calibrate_many` or `History.load`.

    Indices are those of the logs in the order given. Where all logs know their date, the random walk runs in days;
    else one log follows the other at equal distances.

    Attributes:
        factors: each log's information, compressed.
        model: what is assumed between the logs.
        options: of `calibrate`, for logs that are added.
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
        """From compressed logs; groups and filters of an earlier history go on where they were."""
        self.model = model or HistoryModel()
        self.options = dict(options or {})
        self.factors = tuple(factors)
        self._grouping = Grouping(self.factors, self.model, groups)
        self._banks = tuple(banks)
        if not self.groups:
            listed = "; ".join(f"{factor.name}: {factor.problem}" for factor in factors[:3])
            raise MagycError(
                f"history: none of the {len(factors)} logs has a calibration to be trusted ({listed})"
            )

    def __len__(self) -> int:
        return len(self.factors)

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Indices of logs that can be of one instrument, the largest group first.

        A log whose calibration must not be trusted is in none.
        """
        return self._grouping.groups

    @cached_property
    def _instruments(self) -> tuple[Instrument, ...]:
        """One for each group; logs without a calibration are with the largest, which says what it was there."""
        lost = [i for i, factor in enumerate(self.factors) if factor.mean is None]
        dated = all(factor.time is not None for factor in self.factors)

        def when(i: int) -> float:
            time = self.factors[i].time
            return float(time) if dated and time is not None else float(i)

        members = [list(group) for group in self.groups]
        members[0] += lost
        return tuple(
            solve_instrument(self.factors, sorted(group, key=when), self.model, dated=dated, known=self._banks)
            for group in members
        )

    def _of(self, values: Callable[[Instrument], Array]) -> Array:
        """One row for each log from the instruments' rows."""
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
        """Of the logs."""
        return tuple(factor.name for factor in self.factors)

    @property
    def hard_iron(self) -> Array:
        """(k, 3) T at each log, by all logs of its instrument; a wrong log's by its neighbours."""
        return self._of(lambda instrument: instrument.posterior.hard_iron) * MICROTESLA

    @property
    def hard_iron_covariance(self) -> Array:
        """(k, 3, 3) T² of `hard_iron`."""
        return self._of(lambda instrument: instrument.posterior.covariance) * MICROTESLA**2

    @property
    def jumps(self) -> list[tuple[int, Array, Array]]:
        """(index of the first log after it, size (3,) T, sigma (3,) T) of each jump of the hard iron."""
        found = []
        for instrument in self._instruments:
            size = np.diff(instrument.posterior.hard_iron, axis=0) * MICROTESLA
            for k in np.flatnonzero(instrument.label == JUMPED):
                sigma = np.sqrt(np.diag(instrument.posterior.change[k - 1])) * MICROTESLA
                found.append((instrument.order[k], size[k - 1], sigma))
        return sorted(found, key=lambda jump: jump[0])

    @property
    def walk(self) -> float:
        """T per √day (per √log without dates), of the largest group's hard iron."""
        return self._instruments[0].walk * MICROTESLA

    @cached_property
    def contradictions(self) -> tuple[Contradiction, ...]:
        """Logs that do not go with the rest, and in what."""
        return contradictions_of(self.factors, self.groups, self._instruments)

    @cached_property
    def calibrations(self) -> tuple[Calibration, ...]:
        """One for each log, with what all logs of its instrument know; one that says nothing has its neighbours'."""
        result: dict[int, Calibration] = {}
        for instrument in self._instruments:
            for k, i in enumerate(instrument.order):
                result[i] = log_calibration(self.factors, instrument, k)
        return tuple(result[i] for i in range(len(self)))

    @cached_property
    def next(self) -> Calibration:
        """The calibration to load for the next log of the largest group; its covariance holds the walk up to it."""
        return next_calibration(self.factors, self._instruments[0], self.model)

    def add(self, recording: Recording, *, time: float | None = None) -> History:
        """Take one more log; the others are not read again, and the result is that of all at once.

        Args:
            recording: the log.
            time: s since 1970; None takes it from the recording, where that knows the date.

        Returns:
            This history.
        """
        return self.extend([factor_of(recording, time, self.options)])

    def extend(self, factors: Sequence[LogFactor]) -> History:
        """As `add`, for logs that are compressed already."""
        self._banks = self._filters
        self.factors = (*self.factors, *factors)
        self._grouping.add(factors)
        for name in ("_instruments", "calibrations", "next", "contradictions"):
            self.__dict__.pop(name, None)
        return self

    @property
    def _filters(self) -> tuple[Bank, ...]:
        """Of all instruments, to go on from."""
        return tuple(instrument.bank for instrument in self._instruments)

    def to_dict(self) -> dict[str, Any]:
        """All that is needed to go on, JSON types."""
        return {
            "format": _FORMAT,
            "options": self.options,
            "model": asdict(self.model),
            "logs": [factor.to_dict() for factor in self.factors],
            "groups": [list(group) for group in self.groups],
            "filters": [bank.to_dict() for bank in self._filters if len(bank.order) >= _WORTH_KEEPING],
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write YAML, in its form that is JSON and is read fast, bit for bit, replacing the file in one step."""
        lines = [
            f"{json.dumps(name)}: "
            + (f"[\n{_LIST.join(map(_dumped, value))}\n]" if isinstance(value, list) else _dumped(value))
            for name, value in self.to_dict().items()
        ]
        write_text(Path(path), "{\n" + _LIST.join(lines) + "\n}\n")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> History:
        """Read what `save` wrote.

        Raises:
            MagycError: no such file, or not a history.
        """
        path = Path(path)
        try:
            data = _parsed(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise MagycError(f"{path}: no such file") from None
        except OSError as error:
            raise MagycError(f"{path}: cannot be read ({error.strerror})") from None
        except (MagycError, UnicodeDecodeError) as error:
            raise MagycError(f"{path}: {error}") from None
        if not isinstance(data, dict) or data.get("format") not in (_FORMAT, _FIRST_FORMAT):
            raise MagycError(f"{path}: not a history (its format should be {_FORMAT!r})")
        try:
            model = HistoryModel(**data["model"])
            logs = [LogFactor.from_dict(log) for log in data["logs"]]
            banks = [Bank.from_dict(bank, len(logs)) for bank in data.get("filters", ())]
            return cls(logs, model=model, options=data["options"], groups=data.get("groups"), banks=banks)
        except MagycError as error:
            raise MagycError(f"{path}: {error}") from None
        except (KeyError, TypeError, ValueError) as error:
            raise MagycError(f"{path}: a damaged history ({type(error).__name__}: {error})") from None


def _dumped(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)


def _parsed(text: str) -> Any:
    """JSON is read far faster; the first format was YAML in its other form."""
    return parse_json(text) if text.startswith("{") else parse_yaml(text)


@one_thread
def calibrate_many(
    recordings: Iterable[Recording],
    *,
    times: Sequence[float] | None = None,
    model: HistoryModel | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> History:
    """Calibrate all logs of an instrument together.

    Args:
        recordings: the logs; of those that `read_many` gives one at a time is in memory.
        times: s since 1970 of each log; None takes them from the recordings, where these know the date.
        model: what is assumed between logs.
        progress: called with the share done, 0 to 1.
        options: of `calibrate`, for every log.

    Raises:
        MagycError: no log, times that do not fit, or no log with a calibration to be trusted.
    """
    if isinstance(recordings, str | os.PathLike):
        raise MagycError(
            f"calibrate_many: {os.fspath(recordings)!r} is a path; give mg.read_many({os.fspath(recordings)!r})"
        )
    logs = recordings if isinstance(recordings, Sequence) else list(recordings)
    if not len(logs):
        raise MagycError("calibrate_many: no recordings")
    if times is not None and len(times) != len(logs):
        raise MagycError(f"times: {len(times)} for {len(logs)} recordings; give one for each")
    factors = []
    for i in range(len(logs)):
        factors.append(_read_factor(logs, i, None if times is None else float(times[i]), options))
        if progress is not None:
            progress((i + 1) / len(logs))
    return History(factors, model=model, options=options)


def _read_factor(logs: Sequence[Recording], i: int, time: float | None, options: dict[str, Any]) -> LogFactor:
    """Of one log, which may be read here; one that cannot be read leaves its reason."""
    try:
        recording = logs[i]
    except MagycError as problem:
        return LogFactor(f"log {i + 1}", time, None, None, problem=str(problem))
    return factor_of(recording, time, options)


def factor_of(recording: Recording, time: float | None, options: dict[str, Any]) -> LogFactor:
    """Calibrate a log and compress it.

    Args:
        recording: the log.
        time: s since 1970; None takes it from the recording.
        options: of `calibrate`.
    """
    when = date_of(recording) if time is None else time
    try:
        calibration = calibrate(recording, **options)
    except MagycError as problem:
        return LogFactor(recording.name, when, None, None, problem=str(problem))
    return compress(calibration, recording.name, when)
