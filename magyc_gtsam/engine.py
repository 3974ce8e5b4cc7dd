"""One engine for everything that is many: units of work in, one row each out, on this machine or on a cluster.

A unit is independent of the others, so that the rows are the same to the last bit wherever they are made. Locally the
units run in processes (`concurrent.futures`), with an address on a cluster (`dask.distributed`). With a folder for
parts, each row is a Parquet file, written once and in one step; a run that was stopped goes on where it was.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeAlias

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.storage.whole_file import whole_file

Row: TypeAlias = dict[str, Any]
Work: TypeAlias = Callable[[Any], Row]
Progress: TypeAlias = Callable[[float], None]

DIED = "the process that worked on it died, and died again"
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def run_many(
    work: Work,
    units: Mapping[str, Any],
    *,
    engine: str = "local",
    workers: int | None = None,
    parts: Path | None = None,
    progress: Progress | None = None,
) -> dict[str, Row]:
    """Work on all units.

    Args:
        work: a function of a module; a unit in, a row of numbers, texts and lists out. It may raise nothing: what is
            wrong with a unit belongs in its row.
        units: {name: unit}; units are pickled. A name is that of a file where `parts` is given.
        engine: "local", or the address of a Dask scheduler ("tcp://…"; needs the extra `distributed`).
        workers: processes of "local"; None for one a core. 1 works in this process.
        parts: folder of one Parquet file for each row (needs the extra `parquet`); rows that are there are taken.
        progress: called with the share done.

    Returns:
        {name: row} in the order of `units`. A unit on which a process died twice has the row {"error": DIED}.

    Raises:
        MagycError: an engine that is not known or not reachable, or an extra that is missing.
    """
    if engine != "local" and "://" not in engine:
        raise MagycError(
            f"engine {engine!r}: must be 'local' or the address of a scheduler, such as tcp://host:8786"
        )
    rows = {} if parts is None else _parts_in(parts, units)
    left = {name: unit for name, unit in units.items() if name not in rows}
    count = workers or os.cpu_count() or 1
    if engine != "local":
        finished = _on_cluster(work, left, engine)
    elif count == 1 or len(left) < 2:
        finished = ((name, work(unit)) for name, unit in left.items())
    else:
        finished = _in_processes(work, left, min(count, len(left)))
    for name, row in finished:
        rows[name] = row
        if parts is not None:
            _write_part(parts, name, row)
        if progress is not None:
            progress(len(rows) / len(units))
    return {name: rows[name] for name in units}


def _in_processes(work: Work, units: Mapping[str, Any], workers: int) -> Iterator[tuple[str, Row]]:
    """Yield rows as they are done. At most one unit a process is under way: a death leaves few to be repeated."""
    waiting = list(units)
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))  # the processes are the threads, and sums keep their order
    try:
        while waiting:
            running: dict[Future[Row], str] = {}
            with ProcessPoolExecutor(workers, get_context("spawn"), as_worker) as pool:
                try:
                    while waiting or running:
                        while waiting and len(running) < workers:
                            name = waiting.pop(0)
                            running[pool.submit(work, units[name])] = name
                        done, _ = wait(running, return_when=FIRST_COMPLETED)
                        for future in done:
                            row = future.result()
                            yield running.pop(future), row
                except BrokenProcessPool:
                    pass
            for name in running.values():
                yield name, _alone(work, units[name])
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _alone(work: Work, unit: Any) -> Row:
    """In a process of its own."""
    with ProcessPoolExecutor(1, get_context("spawn"), as_worker) as pool:
        try:
            return pool.submit(work, unit).result()
        except BrokenProcessPool:
            return {"error": DIED}


def _on_cluster(work: Work, units: Mapping[str, Any], address: str) -> Iterator[tuple[str, Row]]:
    """Yield rows as they are done. The scheduler gives a dead worker's units to the others."""
    try:
        from distributed import Client, KilledWorker, as_completed
    except ModuleNotFoundError:
        raise MagycError(
            f"engine {address!r}: needs dask.distributed; pip install 'magyc-gtsam[distributed]'"
        ) from None
    try:
        client = Client(address, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise MagycError(f"engine {address!r}: no scheduler answers there ({error})") from None
    with client:
        futures = {client.submit(work, unit, pure=False): name for name, unit in units.items()}
        for future in as_completed(list(futures)):
            try:
                row = future.result()
            except KilledWorker:
                row = {"error": DIED}
            yield futures[future], row


def _parquet() -> Any:
    try:
        import pyarrow
        import pyarrow.parquet
    except ModuleNotFoundError:
        raise MagycError("parts of a run are Parquet files; pip install 'magyc-gtsam[parquet]'") from None
    return pyarrow


def _parts_in(folder: Path, units: Mapping[str, Any]) -> dict[str, Row]:
    """The rows that an earlier run left."""
    arrow = _parquet()
    folder.mkdir(parents=True, exist_ok=True)
    rows: dict[str, Row] = {}
    for name in units:
        file = folder / f"{name}.parquet"
        if file.exists():
            rows[name] = arrow.parquet.read_table(file).to_pylist()[0]
    return rows


def _write_part(folder: Path, name: str, row: Row) -> None:
    write_rows(folder / f"{name}.parquet", [row])


def write_rows(file: Path, rows: Sequence[Row]) -> None:
    """Rows as one Parquet file, in one step.

    Raises:
        MagycError: the extra `parquet` is not installed.
    """
    arrow = _parquet()
    with whole_file(file) as part:
        arrow.parquet.write_table(arrow.Table.from_pylist(list(rows)), part)


def as_worker() -> None:
    """Of a process that works for another: it ends when that is gone, and leaves requests to end to it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    if parent is not None:

        def follow() -> None:
            parent.join()
            os._exit(1)

        threading.Thread(target=follow, daemon=True).start()
