"""Parallel execution of independent units of work, on this machine or on a cluster; each unit gives one row of a table.

The rows do not depend on where a unit runs, to the last bit. Units run in local processes (`concurrent.futures`) or on
a cluster (`dask.distributed`). With a folder for parts each row is written atomically to a Parquet file, and a run
that was interrupted resumes from these files.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeAlias

from magyc_gtsam.extras import needs
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.storage.files import whole_file

Row: TypeAlias = dict[str, Any]
Work: TypeAlias = Callable[[Any], Row]
Rows: TypeAlias = Generator[tuple[str, Row], None, None]
Progress: TypeAlias = Callable[[float], None]

DIED = "the worker process died twice"
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
    """Apply `work` to every unit.

    Args:
        work: function at the top level of a module that takes a unit and returns a row of numbers, texts and lists.
            It must not raise; a failure belongs in the row.
        units: {name: unit}. Units are pickled; with `parts` the names are file names.
        engine: "local", or the address of a Dask scheduler ("tcp://…"; needs the extra `distributed`).
        workers: number of local processes; None for one per core, 1 to work in this process.
        parts: folder with one Parquet file per row (needs the extra `parquet`); rows that exist there are not
            computed again.
        progress: called with the share of finished units, 0 to 1.

    Returns:
        {name: row} in the order of `units`. A unit whose process died twice has the row {"error": DIED}.

    Raises:
        MagycError: the engine is unknown or does not answer, or an extra is missing.
    """
    if engine != "local" and "://" not in engine:
        raise MagycError(
            f"engine {engine!r}: must be 'local' or the address of a scheduler, such as tcp://host:8786"
        )
    rows = {} if parts is None else _parts_in(parts, units)
    remaining = {name: unit for name, unit in units.items() if name not in rows}
    count = workers or os.cpu_count() or 1
    if engine != "local":
        finished = _on_cluster(work, remaining, engine)
    elif count == 1 or len(remaining) < 2:
        finished = ((name, work(unit)) for name, unit in remaining.items())
    else:
        finished = _in_processes(work, remaining, min(count, len(remaining)))
    with closing(finished):  # an interrupt between two rows ends the processes as well
        for name, row in finished:
            rows[name] = row
            if parts is not None:
                _write_part(parts, name, row)
            if progress is not None:
                progress(len(rows) / len(units))
    return {name: rows[name] for name in units}


def _in_processes(work: Work, units: Mapping[str, Any], workers: int) -> Rows:
    """Yield rows as units finish. Each process holds one unit at a time, so few are repeated if a process dies."""
    waiting = list(units)
    before = {name: os.environ.get(name) for name in _THREADS}
    # The processes already use all cores, and with one thread sums keep their order.
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        while waiting:
            running: dict[Future[Row], str] = {}
            with _pool(workers) as pool:
                try:
                    while waiting or running:
                        while waiting and len(running) < workers:
                            name = waiting.pop(0)
                            with _without_interrupts():
                                running[pool.submit(work, units[name])] = name
                        done, _ = wait(running, return_when=FIRST_COMPLETED)
                        for future in done:
                            row = future.result()
                            yield running.pop(future), row
                except BrokenProcessPool:
                    pass  # the units in `running` are repeated below, the waiting ones in a new pool
            for name in running.values():
                yield name, _alone(work, units[name])
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Provide processes that are ended, not waited for, if the block is left by an exception such as an interrupt."""
    others = {*multiprocessing.active_children()}
    with ProcessPoolExecutor(workers, get_context("spawn"), as_worker) as pool:
        try:
            yield pool
        except BaseException:
            for process in {*multiprocessing.active_children()} - others:
                process.terminate()
            raise


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Block SIGINT in processes that are started in the block: it would end them in their imports, with a traceback.

    Once these are done, `as_worker` has them ignore it.
    """
    if os.name == "nt":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _alone(work: Work, unit: Any) -> Row:
    """Work on one unit in a separate process."""
    with _pool(1) as pool:
        try:
            with _without_interrupts():
                future = pool.submit(work, unit)
            return future.result()
        except BrokenProcessPool:
            return {"error": DIED}


def _on_cluster(work: Work, units: Mapping[str, Any], address: str) -> Rows:
    """Yield rows as units finish. The scheduler moves the units of a dead worker to the others."""
    with needs(f"engine {address!r}", "dask.distributed", "distributed"):
        from distributed import Client, KilledWorker, as_completed
    try:
        client = Client(address, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise MagycError(
            f"engine {address!r}: no scheduler answers ({error}); start one or correct the address"
        ) from None
    with client:
        futures = {client.submit(work, unit, pure=False): name for name, unit in units.items()}
        for future in as_completed(list(futures)):
            try:
                row = future.result()
            except KilledWorker:
                row = {"error": DIED}
            yield futures[future], row


def _parquet() -> Any:
    """Import pyarrow with its Parquet module."""
    with needs("parts of a run as Parquet files", "pyarrow", "parquet"):
        import pyarrow
        import pyarrow.parquet
    return pyarrow


def _parts_in(folder: Path, units: Mapping[str, Any]) -> dict[str, Row]:
    """Return the rows that an earlier run wrote."""
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
    """Write rows to one Parquet file, in one step.

    Raises:
        MagycError: the extra `parquet` is not installed.
    """
    arrow = _parquet()
    with whole_file(file) as part:
        arrow.parquet.write_table(arrow.Table.from_pylist(list(rows)), part)


def as_worker() -> None:
    """Make this process end with its parent, and leave interrupts (SIGINT) to the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    if parent is not None:

        def follow() -> None:
            parent.join()
            os._exit(1)

        threading.Thread(target=follow, daemon=True).start()
