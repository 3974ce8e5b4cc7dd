"""The motion by the windows of a fit, and columns of unmodelled effects on either sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from magyc_gtsam.estimators.model_error.rest import moving
from magyc_gtsam.estimators.smoother.columns import UnmodelledColumns
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.factors.chain.chain_values import DELAY
from magyc_gtsam.factors.chain.facts import strength_of
from magyc_gtsam.factors.chain.field_windows import NOTHING, Between
from magyc_gtsam.factors.chain.median import median
from magyc_gtsam.factors.chain.rotations import Array, cross
from magyc_gtsam.factors.chain.spline import Spline, crossed
from magyc_gtsam.factors.chain.turning import turn_rates, world_of
from magyc_gtsam.factors.chain.vech import unvech

SLOW = (1, 7)  # half waves in the recording of a slow variation
ALIKE = 1e-9  # lower bound of denominators, e.g. rad/s of a rate


@dataclass(frozen=True, eq=False)
class WindowMotion:
    """The motion at the windows of a fit; arrays are (…, n) with the windows last.

    Attributes:
        time: (n,) s.
        rotation: (3, 3, n) integrated world → sensor. The integration has the bias of the windows, so that this world
            turns against the field, by 0.1 to 0.4 rad in ten minutes.
        world: (3, 3, n) integrated world → the world by the bias of the fit, in which the field has one direction.
        unit: (3, n) direction of the field in the sensor's axes; change: (3, n) 1/s, its derivative with respect to the
            delay, −d/dt.
        rate: (3, n) rad/s, rate of turn.
        direction: (3, n) of the field in the integrated world.
        lever: (3, 3, links) s, minus the integral of the rotation (sensor → integrated world) over each link.
        reading: (3, n) T, predicted by the model; reading_change: (3, n) T/s, its derivative with respect to the delay.
        strength: T, of the field; soft_iron: (3, 3) T, multiplied by the strength.
        delay: s, of the magnetometer behind the gyroscope; gyroscope_step: s, sampling interval of the gyroscope.
        rate_noise: rad/s, standard deviation per axis of a window's rate of turn by the gyroscope's noise.
        step: T, quantisation step of the magnetometer if it is coarse; 0 otherwise.
        between: the motion while the field was not measured.
        window: indices of the columns that are windows; None if all are.
        straight: whether integrals from one window to the next are by trapezoids instead of a spline.
    """

    time: Array
    rotation: Array
    world: Array
    unit: Array
    change: Array
    rate: Array
    direction: Array
    lever: Array
    reading: Array
    reading_change: Array
    strength: float
    soft_iron: Array
    delay: float
    gyroscope_step: float
    rate_noise: float
    step: float = 0.0
    between: Between = NOTHING
    window: np.ndarray | None = None
    straight: bool = False

    @classmethod
    def of(cls, fit: Fit, step: float = 0.0) -> WindowMotion:
        """Return the motion of a fit at its minimum; `step` is the step of a coarse magnetometer, T."""
        windows, parameters = fit.chain.windows, fit.state.parameters
        soft = unvech(parameters[:6])
        rotation = fit.chain.rotation(parameters)
        bias_error = parameters[9:12] - windows.bias
        g = fit.state.direction
        unit, change, rate = turn_rates(rotation, windows.rotation_rate, g)
        apart = np.maximum(np.diff(windows.time), 1e-9)
        return cls(
            time=windows.time,
            rotation=rotation,
            world=world_of(windows, parameters[9:12], g),
            unit=unit,
            change=change,
            rate=rate,
            direction=g,
            lever=windows.lever,
            reading=parameters[6:9, None] + soft @ unit,
            reading_change=soft @ change,
            strength=strength_of(soft),
            soft_iron=soft,
            delay=float(parameters[DELAY]),
            gyroscope_step=median(windows.link_time / apart),
            rate_noise=fit.chain.noise.gyroscope * float(np.sqrt(median(windows.link_time / apart**2))),
            step=step,
            between=replace(windows.between, rate=windows.between.rate - bias_error[:, None]),
        )

    @property
    def hard_iron(self) -> Array:
        """(3,) T."""
        return np.asarray(self.reading[:, 0] - self.soft_iron @ self.unit[:, 0])

    @property
    def along_links(self) -> WindowMotion:
        """The motion with additional times inside the links across which the field was not measured.

        The effect of a gyroscope error on such a link is an integral over the motion there.
        """
        return self._along_gaps if len(self.between) else self  # kept by itself it would stay in memory

    @cached_property
    def _along_gaps(self) -> WindowMotion:
        between = self.between
        at = between.link + 1
        direction = self.direction[:, between.link]
        unit = np.einsum("ijn,jn->in", between.rotation, direction)
        change = cross(between.rate, unit)

        def put(own: Array, more: Array) -> Array:
            return np.insert(own, at, more, axis=-1)

        return replace(
            self,
            time=put(self.time, between.time),
            rotation=put(self.rotation, between.rotation),
            world=put(self.world, self.world[:, :, between.link]),
            unit=put(self.unit, unit),
            change=put(self.change, change),
            rate=put(self.rate, between.rate),
            direction=put(self.direction, direction),
            reading=put(self.reading, self.hard_iron[:, None] + self.soft_iron @ unit),
            reading_change=put(self.reading_change, self.soft_iron @ change),
            between=NOTHING,
            window=np.arange(len(self.time)) + np.searchsorted(between.link, np.arange(len(self.time))),
        )

    @cached_property
    def noisier(self) -> WindowMotion:
        """The motion with the gyroscope's noise added once more to the rate of turn and its derived quantities."""
        rate = np.random.default_rng(0).normal(0.0, self.rate_noise, self.rate.shape)
        change = cross(rate, self.unit)
        return replace(
            self,
            rate=self.rate + rate,
            change=self.change + change,
            reading_change=self.reading_change + self.soft_iron @ change,
        )

    @cached_property
    def by_trapezoids(self) -> WindowMotion:
        """The motion with coarser integrals; where they differ the windows do not resolve the motion between them."""
        return replace(self, straight=True)

    @cached_property
    def moving(self) -> np.ndarray:
        """(n,) bool, windows in which the instrument is not put down."""
        return moving(self.time, self.rotation)

    @cached_property
    def spread(self) -> float:
        """rad/s, root mean square of the rate of turn per axis."""
        return max(root_mean_square(self.rate), ALIKE)

    @cached_property
    def since_mean(self) -> Array:
        """(n,) time since its mean over the windows, relative to that at the end of the recording."""
        since = self.time - self.time.mean()
        return np.asarray(since / since[-1])

    @cached_property
    def relative(self) -> Array:
        """(3, n) rate of turn divided by `spread`."""
        return self.rate / self.spread

    @cached_property
    def reading_curvature(self) -> Array:
        """(3, n) T/s², time derivative of `reading_change`."""
        return self.derivative(self.reading_change)

    def in_sensor(self, profiles: Array) -> UnmodelledColumns:
        """Return the columns of profiles (k, n) along each of the sensor's axes, in units of the field strength."""
        return UnmodelledColumns.on_each_axis(self.strength * profiles)

    def in_world(self, profiles: Array) -> UnmodelledColumns:
        """Return the columns of profiles (k, n) along each of the world's axes, in units of the field strength."""
        return along_axes(profiles, self._world_axes)

    @cached_property
    def attitude(self) -> Array:
        """(3, 3, n) world → sensor."""
        return np.einsum("ijn,kjn->ikn", self.rotation, self.world)

    @cached_property
    def _world_axes(self) -> Array:
        """(3, 3, n) T, the readings of unit fields along the world's axes, axis by axis."""
        return (self.soft_iron @ self.attitude.reshape(3, -1)).reshape(self.attitude.shape).swapaxes(0, 1)

    def on_gyroscope(self, profiles: Array) -> UnmodelledColumns:
        """Return the columns of rate errors ω (k, 3, n) rad/s: links turn by −∫ Rᵀ ω dt more than modelled."""
        return UnmodelledColumns(None, self._links(np.einsum("jin,kjn->kin", self.rotation, profiles)))

    def about_each_axis(self, profiles: Array) -> UnmodelledColumns:
        """Return the 3k columns of rate errors with profiles (k, n) rad/s about each of the sensor's axes."""
        turned = profiles[:, None, None] * self.rotation
        return UnmodelledColumns(None, self._links(turned.reshape(-1, *turned.shape[2:])))

    def slowly_about_each_axis(self, profiles: Array) -> UnmodelledColumns:
        """Return the same columns of profiles that hardly change within a link, by the samples' integrals over it."""
        own = profiles if self.window is None else profiles[:, self.window]
        columns = 0.5 * (own[:, 1:] + own[:, :-1])[:, None, None] * self._by_bias
        return UnmodelledColumns(None, columns.reshape(-1, *columns.shape[2:]))

    @cached_property
    def _by_bias(self) -> Array:
        """(3, 3, links), the columns of an error of the bias, rad per rad/s."""
        return self._across(-self.lever.swapaxes(0, 1))

    def gyroscope_scales(self) -> UnmodelledColumns:
        """Return the three columns of the scale errors of the gyroscope's axes."""
        return UnmodelledColumns(None, self._gyroscope_matrix[:3])

    def gyroscope_scale(self) -> UnmodelledColumns:
        """Return the column of a scale error common to all axes."""
        return UnmodelledColumns(None, self._gyroscope_matrix[:3].sum(axis=0, keepdims=True))

    def gyroscope_cross_axis(self) -> UnmodelledColumns:
        """Return the three columns of a symmetric cross-axis sensitivity: x with y, x with z, y with z."""
        return UnmodelledColumns(None, self._gyroscope_matrix[3:])

    @cached_property
    def _gyroscope_matrix(self) -> Array:
        """Columns (6, 3, links) of a symmetric error of the gyroscope's matrix: xx, yy, zz, xy, xz, yz."""
        turned = np.empty((6, *self.rotation.shape[1:]))
        np.multiply(self.rate[:, None], self.rotation, out=turned[:3])
        for both, (i, j) in zip(turned[3:], ((0, 1), (0, 2), (1, 2)), strict=True):
            np.multiply(self.rate[i], self.rotation[j], out=both)
            both += self.rate[j] * self.rotation[i]
        return self._links(turned)

    def _links(self, turned: Array) -> Array:
        """Return columns of the links (k, 3, n − 1) rad by rate errors (k, 3, n) rad/s in the integrated world."""
        if self.window is None:
            return self._spline.crossed_integrals(turned, self.direction, self.straight)
        return self._across(np.add.reduceat(self.integral(turned), self.window[:-1], axis=-1))

    def _across(self, integral: Array) -> Array:
        """Return columns of the links by the integrals over each of rate errors, (k, 3, links) rad."""
        direction = self.direction if self.window is None else self.direction[:, self.window]
        return crossed(direction[:, :-1], integral)

    def derivative(self, values: Array) -> Array:
        """Return the time derivatives (…, n) of a cubic spline through values (…, n).

        The windows are long relative to the fastest motion (in a swell the phase advances by some 2 rad from one to the
        next), where central differences retain 0.4 of a derivative and a spline 0.85.
        """
        return self._spline.slopes(values)

    def integral(self, values: Array) -> Array:
        """Return the integrals (…, n − 1) of the spline through values (…, n) from each window to the next."""
        return self._spline.integrals(values, self.straight)

    @cached_property
    def _spline(self) -> Spline:
        return Spline.at(self.time)

    def waves(self, first: int, stop: int) -> Array:
        """Return (stop − first, n) cosines of unit mean square with `first` to `stop` − 1 half waves."""
        return self._slow_waves[first - SLOW[0] : stop - SLOW[0]] if stop <= SLOW[1] else self._waves(first, stop)

    @cached_property
    def _slow_waves(self) -> Array:
        return self._waves(*SLOW)

    def _waves(self, first: int, stop: int) -> Array:
        share = (self.time - self.time[0]) / max(float(self.time[-1] - self.time[0]), 1e-9)
        result = np.empty((max(stop, 2), len(share)))
        result[0] = np.sqrt(2)
        slowest = np.cos(np.pi * share)
        np.multiply(result[0], slowest, out=result[1])
        slowest *= 2
        for k in range(2, stop):  # cos kφ = 2 cos φ cos (k − 1)φ − cos (k − 2)φ
            np.multiply(slowest, result[k - 1], out=result[k])
            result[k] -= result[k - 2]
        return result[first:stop]


def root_mean_square(values: Array) -> float:
    """Return the root of the mean square of all values."""
    return float(np.sqrt(np.vdot(values, values) / values.size))


def along_axes(profiles: Array, axes: Array) -> UnmodelledColumns:
    """Return the columns of the windows that are the products of profiles (q, n) with axes (b, 3, n) T, q b of them."""
    columns = profiles[:, None, None] * axes
    return UnmodelledColumns(columns.reshape(-1, *columns.shape[2:]), None)
