"""What is said when the online smoother is asked."""

from __future__ import annotations

from dataclasses import replace

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.chain_fit import NEAR, Fit, adapt, begin, descend
from magyc_gtsam.estimators.chain_search import disturbed, moved, short_term_noise, suitable_turn
from magyc_gtsam.estimators.clock_drift import speaks, with_drift
from magyc_gtsam.factors.field_chain import FieldChain
from magyc_gtsam.factors.preintegration import FieldWindows
from magyc_gtsam.online.clocks import drift_of, testable
from magyc_gtsam.online.compressed import CompressedWindows
from magyc_gtsam.online.coverage import coverage
from magyc_gtsam.online.kept import Kept
from magyc_gtsam.online.memory import FIRST
from magyc_gtsam.online.sweep import SWEEP, fit_kept
from magyc_gtsam.online.values import Change, Progress
from magyc_gtsam.online.walking import fit_walked

_MOST_REFITTED = 2400  # windows; the noise levels of longer logs are those of the last sweep
_LEAST_CONVERGED = 120  # windows of the last sweep; noise levels from fewer make no honest covariance


def current_calibration(kept: Kept, compressed: CompressedWindows) -> Calibration | None:
    """As the batch method would fit all samples so far; of a long log, the tail given all before it."""
    m = kept.memory
    if m.head is None:
        return m.report
    ending = kept.recording(None, m.tail)
    if m.past is None and m.front is None and len(kept.numbers()) <= _MOST_REFITTED:
        well_cut = (
            kept.settings.turn is not None or suitable_turn(kept.buffer.magnetometer.value) == kept.buffer.turn
        )
        fit = _refitted(kept, compressed.current(kept)) if well_cut else None
        if fit is not None:
            return _with_clocks(kept, kept.result(ending, fit), fit)
        recording = kept.recording(None)
        fit, rival, _ = fit_kept(kept, recording, False)
        return _with_clocks(kept, kept.result(recording, fit, rival), fit)
    stop = int(kept.buffer.numbers[-1]) + 1
    fit = kept.fit_tail(stop) if m.front is None else fit_walked(kept, stop)
    return with_drift(kept.result(ending, fit, None, m.tail, kept.last), m.drift)


def _with_clocks(kept: Kept, calibration: Calibration, fit: Fit) -> Calibration:
    """With what the clocks did: as the last sweep found, or else as all windows say now."""
    drift = kept.memory.drift
    if drift is None and testable(kept, len(fit.chain.windows)) and speaks(fit):
        drift = drift_of(kept, kept.recording(None), fit, calibration.converged)
    return with_drift(calibration, drift)


def _refitted(kept: Kept, windows: FieldWindows) -> Fit | None:
    """All windows at their minimum, with their own noise levels and weights; None where they must be cut or integrated
    anew."""
    settings, last = kept.settings, kept.last
    short_term = short_term_noise(kept.buffer) if settings.noise is None else None
    # From the sensors' short-term noise, as the batch method: what its tolerances leave is then the same.
    begun = begin(FieldChain(windows, short_term or last.noise), last.parameters, settings.free)
    fit = adapt(descend(begun, NEAR), settings.reject, short_term)
    # Once more: a start so near leaves the directions where their own windows saw them.
    fit = descend(replace(fit, reduced=fit.chain.eliminate(fit.state, fit.weights)))
    newly_disturbed = kept.buffer.length == settings.window and disturbed(fit)
    return None if moved(fit) or (settings.reject and newly_disturbed) else fit


def has_converged(kept: Kept) -> bool:
    """Whether the last sweep held enough, and stood still."""
    return kept.memory.stable and kept.memory.next_sweep >= int(SWEEP * _LEAST_CONVERGED)


def progress_of(kept: Kept, calibration: Calibration | None) -> Progress:
    """How far it is, given the current calibration."""
    m = kept.memory
    windows = m.given_up + len(kept.numbers())
    seen = 0.0 if calibration is None else coverage(calibration, kept.buffer.magnetometer.value)
    weak = calibration.observability.weak if calibration and calibration.observability else ()
    converged = has_converged(kept)
    if m.problem:
        sentence = m.problem
    elif calibration is None:
        sentence = f"collecting: {windows} of {FIRST} windows"
    elif not calibration.converged:
        sentence = calibration.message
    elif not converged:
        sentence = f"the estimate still moves: {weak[0].sentence if weak else 'go on turning'}"
    else:
        sentence = "converged"
    return Progress(None, 0.0, windows, converged, sentence, weak, seen)


def changes_until(kept: Kept, calibration: Calibration | None) -> tuple[Change, ...]:
    """The steps found; after each, what held until the next, after the last what holds now."""
    found = kept.memory.changes
    after = [change.before for change in found[1:]] + [calibration]
    return tuple(replace(change, after=now) for change, now in zip(found, after[: len(found)], strict=True))
