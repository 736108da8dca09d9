"""Monitors of the IMU: faults that show in its samples alone, second by second.

Frozen axes, samples that repeat, saturation, noise that grows or vanishes, specific force that is not gravity's size.
Each is counted and reported with the axis, the value and the remedy. The samples are used all the same: the errors that
they may hide leave as `HiddenErrors`, by which the filter widens its covariance.
"""

import itertools
import math
from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ins_nav.event_log import ERROR, WARN, EventLog
from ins_nav.mechanization.gravity_monitor import GravityMonitor
from ins_nav.mechanization.imu_condition import HiddenErrors
from ins_nav.mechanization.repeated_values import RepeatedValues, Run
from ins_nav.mechanization.sample_noise import SampleNoise, Triads
from ins_nav.mechanization.saturation import LEAST_REPEATS, saturation
from ins_nav.mechanization.strapdown import Sample
from ins_nav.mechanization.window_statistics import EVERY_AXIS, WindowStatistics, window_statistics

Array = NDArray[np.float64]

TOPIC = "imu/data_raw"
_WINDOW_NS, _MORE_NS = 1_000_000_000, 250_000_000
"""ns: length of a window, and by how much it grows until it has `_LEAST` samples."""
_LEAST = 12
"""Samples in a window."""
_LONGEST_NS = 4_000_000_000
"""ns: a window with too few samples is left out then."""
_CORRELATED = 5.0
"""s over which a motion that a frozen axis does not show lasts: its turn grows evenly within, as a walk beyond."""
_MEMORY = 600
"""Windows of which the largest motion counts as what a frozen or saturated axis may hide: a survey turns every few
minutes."""
_OTHER_UNIT = 15.0
"""Growth of the noise from which on values may be in another unit (57.3 from rad/s to deg/s), and motion is unknown."""
_AXES = ("angular_velocity.x", ".y", ".z", "linear_acceleration.x", ".y", ".z")
_SENSORS = ("angular_velocity", "linear_acceleration")


class ImuMonitor:
    """Collects samples and tests them second by second.

    Parameters
    ----------
    events : EventLog

    Attributes
    ----------
    hidden : list of HiddenErrors
        Of the last window, on the IMU's axes.
    due_ns : int
        Stamp from which on a sample ends the window.
    """

    def __init__(self, events: EventLog) -> None:
        self._events = events
        self.restart()

    def restart(self) -> None:
        """Forget everything: the stamps have jumped."""
        self.hidden: list[HiddenErrors] = []
        self._samples: list[Sequence[float]] = []
        self._last: Sequence[float] | None = None
        self._begin_ns = self.due_ns = 0
        self._repeated = RepeatedValues()
        self._noise = SampleNoise()
        self._swings: deque[Triads] = deque(maxlen=_MEMORY)
        self._force = GravityMonitor()
        self._mean: list[float] = []

    @property
    def noise_limits(self) -> Triads:
        """Upper limits of the white noise of gyros and accelerometers, rad/√s and m/s/√s; infinite until known."""
        return math.sqrt(self._noise.gyro.limit), math.sqrt(self._noise.accel.limit)

    @property
    def constant(self) -> list[str]:
        """Axes that have not changed since the start, as fields of the message."""
        return [_axis(i) for i in self._repeated.constant]

    def add(self, stamp_ns: int, sample: Sample, standing: bool) -> bool:
        """Add a sample; whether a window ended with it and was tested.

        Parameters
        ----------
        stamp_ns : int
        sample : Sample
            On the IMU's axes, of an `ins_nav.mechanization.imu_stream.ImuStream`.
        standing : bool
            The carrier stands.
        """
        self._samples.append(sample)
        return stamp_ns >= self.due_ns and self._end_window(stamp_ns, standing)

    def add_run(self, samples: Array) -> None:
        """Add samples before `due_ns`, shape (n, 7), as `add` would one after the other."""
        self._samples += samples.tolist()

    def _end_window(self, stamp_ns: int, standing: bool) -> bool:
        count, began_ns = len(self._samples), self._begin_ns
        if self._last is not None and count < _LEAST and stamp_ns - began_ns < _LONGEST_NS:
            self.due_ns = stamp_ns + _MORE_NS
            return False
        complete = False
        if self._last is not None and count >= _LEAST:
            flat = itertools.chain(self._last, itertools.chain.from_iterable(self._samples))
            samples = np.fromiter(flat, float, 7 * (count + 1)).reshape(-1, 7)
            interval = (stamp_ns - began_ns) * 1e-9 / count
            complete = True
            self.hidden = self._test(samples[:, 1:], interval, stamp_ns, standing)
        self._last = self._samples[-1]
        self._samples.clear()
        self._begin_ns, self.due_ns = stamp_ns, stamp_ns + _WINDOW_NS
        return complete

    def _test(self, values: Array, interval: float, stamp_ns: int, standing: bool) -> list[HiddenErrors]:
        """Test a window and the last sample before it, shape (n + 1, 6)."""
        window = window_statistics(values)
        self._add_swing(window)
        self._noise.add(window, interval, not standing)
        self._repeated.add(window, interval, self._noise.level)
        hidden = self._noise_errors(stamp_ns)
        hidden += self._frozen(values, interval, stamp_ns)
        hidden += self._held(window, interval, stamp_ns)
        hidden += self._saturated(values, window, interval, stamp_ns)
        hidden += self._force_errors(window, window.samples * interval, stamp_ns)
        return hidden

    def _add_swing(self, window: WindowStatistics) -> None:
        """Largest departure of gyros and of accelerometers from their mean."""
        if not self._swings:
            self._mean = window.mean
        sides = zip(window.low, window.high, self._mean, strict=True)
        swings = [max(high - mean, mean - low) for low, high, mean in sides]
        self._swings.append((max(swings[:3]), max(swings[3:])))
        share = 1.0 / len(self._swings)
        self._mean = [mean + share * (now - mean) for mean, now in zip(self._mean, window.mean, strict=True)]

    def _over_window(self, variances: Array, stamp_ns: int) -> HiddenErrors:
        return HiddenErrors(self._begin_ns, stamp_ns, variances[:3], variances[3:])

    def _noise_errors(self, stamp_ns: int) -> list[HiddenErrors]:
        variances = np.zeros(6)
        for triad, noise in enumerate((self._noise.gyro, self._noise.accel)):
            if noise.ratio > 1.0:
                swing = 0.0 if noise.ratio < _OTHER_UNIT else self._swings[-1][triad]
                variances[3 * triad : 3 * triad + 3] = max(noise.excess, 2.0 * _CORRELATED * swing**2)
                text = (
                    f"{TOPIC}: noise of {_SENSORS[triad]} is {noise.ratio:.3g} times the largest before, the sigmas "
                    "grow with it: vibration, another unit, or a failing sensor"
                )
                self._events.count("noise grown", WARN, text, stamp_ns)
            elif noise.ratio < 1.0:
                text = (
                    f"{TOPIC}: noise of {_SENSORS[triad]} is {noise.ratio:.2g} times the least before: does the driver "
                    "filter, or repeat a sample, or publish another unit?"
                )
                self._events.count("noise vanished", WARN, text, stamp_ns)
        return [self._over_window(variances, stamp_ns)] if variances.any() else []

    def _frozen(self, values: Array, interval: float, stamp_ns: int) -> list[HiddenErrors]:
        if not (self._repeated.runs or self._repeated.constant):
            return []
        hidden = []
        swing = np.repeat(np.array(self._swings).max(axis=0), 3)
        for run in self._repeated.runs:
            end_ns = stamp_ns - round(run.end * interval * 1e9)
            variances = 2.0 * _CORRELATED * np.square(swing)
            if run.axis != EVERY_AXIS:
                variances[np.arange(EVERY_AXIS) != run.axis] = 0.0
            begin_ns = end_ns - round(run.new * interval * 1e9)
            hidden.append(HiddenErrors(begin_ns, end_ns, variances[:3], variances[3:]))
        if self._repeated.runs:
            self._report_frozen(self._repeated.runs, values, interval, stamp_ns)
        for axis in self._repeated.constant:
            variances = np.zeros(6)
            if values[-1, axis] != 0.0:
                variances[axis] = 2.0 * _CORRELATED * swing[axis] ** 2
                hidden.append(self._over_window(variances, stamp_ns))
            text = (
                f"{TOPIC}: {_axis(axis)} is {values[-1, axis]:.6g} in every sample since the start: it is not measured"
            )
            self._events.count("constant axes", WARN, text, stamp_ns)
        return hidden

    def _report_frozen(self, runs: list[Run], values: Array, interval: float, stamp_ns: int) -> None:
        every = runs[0].axis == EVERY_AXIS
        axes = [] if every else [f"{_axis(run.axis)} at {values[-1 - run.end, run.axis]:.6g}" for run in runs]
        text = (
            f"{TOPIC}: {', '.join(axes) or 'every value'} frozen for {runs[0].length * interval:.1f} s: check the "
            "sensor and its driver"
        )
        self._events.count("frozen samples" if every else "frozen axes", ERROR, text, stamp_ns)

    def _held(self, window: WindowStatistics, interval: float, stamp_ns: int) -> list[HiddenErrors]:
        variances = np.zeros(6)
        for triad, times in enumerate(self._repeated.held):
            if times > 1:
                axes = slice(3 * triad, 3 * triad + 3)
                # a change arrives late by half of the hold in the mean: a walk with steps of change x hold / 2
                variances[axes] = 0.25 * times**2 * interval * np.array(window.step[axes])
                text = (
                    f"{TOPIC}: {_SENSORS[triad]} has each value in {times} samples, the sigmas grow with it: "
                    "publish each measurement once"
                )
                self._events.count("repeated values", WARN, text, stamp_ns)
        return [self._over_window(variances, stamp_ns)] if variances.any() else []

    def _saturated(self, values: Array, window: WindowStatistics, interval: float, stamp_ns: int) -> list[HiddenErrors]:
        hidden = []
        for axis in range(EVERY_AXIS):
            if window.repeats[axis] < LEAST_REPEATS:
                continue
            found = saturation(values[:, axis])
            if found is not None:
                variances = np.zeros(6)
                cut = (found.error * interval) ** 2 / (window.samples * interval)
                swing = max(swings[axis // 3] for swings in self._swings)
                variances[axis] = max(cut, 2.0 * _CORRELATED * swing**2 * found.share)
                hidden.append(self._over_window(variances, stamp_ns))
                text = (
                    f"{TOPIC}: {_axis(axis)} is saturated at {found.limit:.6g}, the sigmas grow: use a larger range of "
                    "the sensor, or a softer mount"
                )
                self._events.count("saturated", ERROR, text, stamp_ns)
        return hidden

    def _force_errors(self, window: WindowStatistics, duration: float, stamp_ns: int) -> list[HiddenErrors]:
        fault = self._force.add(window, duration)
        if fault is None:
            return []
        self._events.count(fault.kind, fault.level, f"{TOPIC}: {fault.text}", stamp_ns)
        variances = np.repeat([0.0, 2.0 * _CORRELATED * fault.error**2], 3)
        return [self._over_window(variances, stamp_ns)]


def _axis(i: int) -> str:
    return _AXES[i] if i % 3 == 0 else _AXES[i - i % 3][:-2] + _AXES[i]
