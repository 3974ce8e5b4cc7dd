"""What the online smoother keeps: the latest samples, and what it remembers of all others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.chain_fit import NEAR, Fit, adapt, begin, descend
from magyc_gtsam.estimators.smoother import calibration_of
from magyc_gtsam.factors.field_chain import DELAY
from magyc_gtsam.online.buffers import SampleBuffer
from magyc_gtsam.online.memory import FIRST, Estimate, Memory
from magyc_gtsam.online.settings import Settings
from magyc_gtsam.online.summary import BIAS, ContinuedChain
from magyc_gtsam.recording import Array, Recording


class Kept:
    """Samples and memory, and the operations on both that all parts of the smoother share."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        interval_mean = settings.angular_rate_is == "interval-mean"
        self.buffer = SampleBuffer(settings.window, settings.turn or 0.4, interval_mean)
        self.memory = Memory()

    @property
    def last(self) -> Estimate:
        """What the last fit said; there is one."""
        assert self.memory.estimate is not None
        return self.memory.estimate

    @property
    def delay(self) -> float:
        """s, by which the magnetometer lags as far as is known."""
        estimate = self.memory.estimate
        return float(self.settings.delay or 0.0) if estimate is None else float(estimate.parameters[DELAY])

    def numbers(self, first: int = 0) -> Array:
        """Ascending, of the windows kept and taken, from `first` on."""
        numbers = self.buffer.numbers
        return np.unique(numbers[slice(*np.searchsorted(numbers, [first, self.memory.done]))])

    def recording(self, stop: int | None, first: int | None = None) -> Recording:
        """The samples of the windows from `first` up to `stop`; None: of all."""
        magnetometer, gyroscope = self.buffer.between(first, stop, self.delay)
        return Recording.from_streams(magnetometer, gyroscope, angular_rate_is=self.settings.angular_rate_is)

    def fit_tail(self, stop: int) -> Fit:
        """The tail up to window `stop` at its minimum, given the head."""
        estimate = self.last
        samples = self.buffer.windows(self.memory.tail, stop, self.delay)
        windows = samples.integrate(estimate.parameters[BIAS], self.delay)
        chain = ContinuedChain(windows, estimate.noise, self.memory.head)
        fit = begin(chain, estimate.parameters, self.settings.free)
        return adapt(descend(fit, NEAR), self.settings.reject, None)

    def close(self) -> None:
        """The head joins the past."""
        m = self.memory
        m.given_up += int(np.searchsorted(self.numbers(), m.tail))
        m.past = m.head
        self.buffer.keep_from(m.tail, self.delay)

    def begin_at(self, number: int) -> None:
        """As if the log began with this window."""
        m, buffer = self.memory, self.buffer
        m.given_up += int(np.searchsorted(self.numbers(), number))
        last = buffer.magnetometer.time[int(np.searchsorted(buffer.numbers, m.done)) - 1]
        buffer.begin_at(number, self.settings.window)
        m.done = int(buffer.numbers[np.searchsorted(buffer.magnetometer.time, last)])
        m.past = m.head = m.front = m.estimate = m.swept = m.report = m.drift = None
        m.next_sweep = m.next_search = FIRST
        m.stable = m.settled = m.undecided = False

    def result(
        self,
        recording: Recording,
        fit: Fit,
        rival: Fit | None = None,
        first: int = 0,
        swept: Estimate | None = None,
    ) -> Calibration:
        """Of a fit of the windows from `first` on; where that is the end of what was `swept`, its noise levels are."""
        colour = None if swept is None else swept.colour
        if swept is not None:
            fit = replace(fit, noise_freedom=swept.noise_freedom)
        configuration = {name: value for name, value in self.settings.fit.items() if value is not None}
        if self.settings.clock_drift:
            configuration["clock_drift"] = self.settings.clock_drift
        result = calibration_of(recording, fit, rival, self.settings.field_strength, configuration, colour)
        windows = self.memory.given_up + int(np.searchsorted(self.numbers(), first)) + len(fit.chain.windows)
        return replace(result, diagnostics={**result.diagnostics, "windows": windows})


def continued(fit: Fit) -> ContinuedChain:
    """The chain of a fit, as one that may have a past."""
    chain = fit.chain
    return chain if isinstance(chain, ContinuedChain) else ContinuedChain(chain.windows, chain.noise)


def observable(calibration: Calibration) -> bool:
    """Whether the motion determined it."""
    return calibration.observability is not None and calibration.observability.observable
