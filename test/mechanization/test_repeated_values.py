"""Repeats by quantization, at any resolution and rate, are none; frozen axes, samples and held values are found."""

import itertools

import numpy as np
import pytest
from monitored_imu import drive

from ins_nav.mechanization.repeated_values import RepeatedValues
from ins_nav.mechanization.window_statistics import EVERY_AXIS, window_statistics


def _fed(values: np.ndarray, rate: float = 100.0) -> list[tuple[float, set[int], list[int], list[int]]]:
    """Time at the end of each window with a fault; frozen axes, constant axes, times that values are held."""
    monitor = RepeatedValues()
    size = max(12, round(rate))
    faults = []
    for begin in range(0, len(values) - size, size):
        window = window_statistics(values[begin : begin + size + 1])
        noise = float(np.sqrt(sum(window.fine[:3]))), float(np.sqrt(sum(window.fine[3:])))
        monitor.add(window, 1.0 / rate, noise)
        frozen = {run.axis for run in monitor.runs}
        if frozen or monitor.constant or monitor.held != [1, 1]:
            faults.append(((begin + size) / rate, frozen, monitor.constant, monitor.held))
    return faults


@pytest.mark.parametrize("rate", [10.0, 50.0, 100.0, 400.0])
@pytest.mark.parametrize("resolution", [0.0, 0.3, 1.0, 3.0, 5.0, 8.0, 12.0, 20.0, 50.0])
def test_false_alarms(resolution: float, rate: float) -> None:
    """From no quantization to axes that hardly ever change at rest; 1e-9 a run is stated."""
    for seed in range(2):
        assert _fed(drive(seed, rate, resolution), rate) == []


@pytest.mark.parametrize("resolution", [0.0, 1.0, 4.0])
@pytest.mark.parametrize(("axis", "begin"), [*itertools.product([0, 2, 3, 5], [40.0, 58.5, 90.0])])
def test_a_frozen_axis(axis: int, begin: float, resolution: float) -> None:
    """At rest, before the departure, in motion; for 20 s; no other axis.

    Found by the end of the first whole window; of the second where the axis repeats 9 of 10 times at rest.
    """
    values = drive(1, resolution=resolution)
    first, until = round(begin * 100.0), round((begin + 20.0) * 100.0)
    values[first:until, axis] = values[first - 1, axis]
    faults = _fed(values)
    assert begin + 1.0 <= faults[0][0] <= begin + 2.6
    assert all(frozen == {axis} for _, frozen, _, _ in faults)
    assert begin + 20.0 <= faults[-1][0] <= begin + 21.1


def test_axes_that_never_change_at_rest_are_found_in_motion() -> None:
    """Steps of 12 sigma: only what was learnt in motion shows that the axis is frozen."""
    values = drive(1, resolution=50.0)
    values[10000:13000, 0] = values[9999, 0]
    faults = _fed(values)
    assert faults and 101.0 <= faults[0][0] <= 104.0
    assert all(frozen == {0} for _, frozen, _, _ in faults)


@pytest.mark.parametrize("resolution", [0.0, 1.0, 4.0])
@pytest.mark.parametrize("length", [0.3, 1.5, 10.0])
@pytest.mark.parametrize("begin", [30.0, 100.2])
def test_samples_that_repeat(begin: float, length: float, resolution: float) -> None:
    values = drive(1, resolution=resolution)
    first, until = round(begin * 100.0), round((begin + length) * 100.0)
    values[first:until] = values[first - 1]
    faults = _fed(values)
    assert begin < faults[0][0] <= begin + 1.1
    assert all(frozen == {EVERY_AXIS} for _, frozen, _, _ in faults)
    assert faults[-1][0] <= begin + length + 1.1


@pytest.mark.parametrize("triad", [0, 1])
@pytest.mark.parametrize("times", [2, 3, 4, 8])
def test_values_that_are_held(times: int, triad: int) -> None:
    values = drive(1)
    axes = slice(3 * triad, 3 * triad + 3)
    for offset in range(1, times):
        values[offset::times, axes] = values[::times, axes][: len(values[offset::times])]
    faults = _fed(values)
    assert faults[0][0] == pytest.approx(3.0)
    assert all(held[triad] == times and held[1 - triad] == 1 and not frozen for _, frozen, _, held in faults)


@pytest.mark.parametrize("axis", [0, 4])
def test_an_axis_that_never_changes(axis: int) -> None:
    values = drive(1)
    values[:, axis] = 0.0
    faults = _fed(values)
    assert faults[0][0] == pytest.approx(1.0) and len(faults) == len(values) // 100 - 1
    assert all(constant == [axis] and not frozen for _, frozen, constant, _ in faults)


def test_an_imu_without_noise_may_stand() -> None:
    """A simulator's: constant to the last bit at rest, before and after the drive."""
    values = drive(1, noise=0.0)
    assert _fed(values) == []
