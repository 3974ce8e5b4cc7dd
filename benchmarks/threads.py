"""What threads of BLAS cost: `calibrate` and `find_gap` with and without them, side by side.

    env -u OMP_NUM_THREADS -u OPENBLAS_NUM_THREADS python benchmarks/threads.py

The public functions hold BLAS to one thread (`factors/one_thread.py`); here the functions inside are called with
the threads that BLAS starts by itself. Printed are medians of the passed and of the processor time, and ratios.
"""

import statistics
import time
from collections.abc import Callable
from pathlib import Path

import magyc_gtsam as mg
from magyc_gtsam.factors.one_thread import one_thread

DIVE = Path(__file__).parent.parent / "datasets" / "calibration_dive.mcap"


def timed(function: Callable[[], object], limited: bool) -> tuple[float, float]:
    """Passed and processor time of a call, ms."""
    time.sleep(0.2)  # threads of the call before spin for a while after it
    wall, processor = time.perf_counter(), time.process_time()
    (one_thread(function) if limited else function)()
    return (time.perf_counter() - wall) * 1e3, (time.process_time() - processor) * 1e3


def main() -> None:
    rec = mg.read(DIVE)

    def calibrate() -> object:
        return mg.calibrate.__wrapped__(rec)

    def find_gap() -> object:
        return mg.find_gap.__wrapped__(rec)

    print(f"{'':12s}{'threads of BLAS':>22s}{'one thread':>22s}{'ratio':>16s}\n{'':12s}", end="")
    print(f"{'passed ms':>11s}{'CPU ms':>11s}" * 2 + f"{'passed':>8s}{'CPU':>8s}")
    for name, function, repeats in (("calibrate", calibrate, 20), ("find_gap", find_gap, 3)):
        function()
        pairs = [(timed(function, False), timed(function, True)) for _ in range(repeats)]
        free, held = ([statistics.median(t[i][k] for t in pairs) for k in (0, 1)] for i in (0, 1))
        print(f"{name:12s}{free[0]:11.1f}{free[1]:11.1f}{held[0]:11.1f}{held[1]:11.1f}", end="")
        print(f"{free[0] / held[0]:8.2f}{free[1] / held[1]:8.2f}")


if __name__ == "__main__":
    main()
