"""State of a navigator for people: the values of a diagnostic status."""

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ins_nav.estimation.state_layout import (
    ACCEL_BIAS,
    GYRO_BIAS,
    HEADING,
    HEIGHT,
    HORIZONTAL_POSITION,
    HORIZONTAL_VELOCITY,
    TILT,
)
from ins_nav.event_log import ERROR, INFO
from ins_nav.navigator.delayed import DelayedNavigator
from ins_nav.navigator.front_end import Phase
from ins_nav.navigator.realtime import RealtimeNavigator
from ins_nav.stamps import NS

SILENCE = 2.0
"""s without a message on imu/data_raw that is an error: 20 intervals of the slowest IMU."""
_BIAS_UNIT = math.degrees(1.0) * 3600.0


def silence(seconds: float) -> str:
    """Line for a silence of imu/data_raw, s."""
    return f"no messages on imu/data_raw for {seconds:.0f} s: is the driver running?"


def diagnostics(
    navigator: RealtimeNavigator, calibrations: int, silent_for: float = 0.0
) -> tuple[int, str, dict[str, str]]:
    """Level (0 OK, 1 warning, 2 error), one line, and the values of a diagnostic status.

    Parameters
    ----------
    navigator : RealtimeNavigator
    calibrations : int
        ZUPT calibrations since alignment.
    silent_for : float
        Time since the last message on imu/data_raw, s, where that is known.
    """
    front_end, events = navigator.front_end, navigator.events
    stream = front_end.stream
    values = {
        "phase": navigator.phase.value,
        "alignment progress": f"{100.0 * navigator.front_end.progress:.0f} %",
        "imu/data_raw received": str(stream.received),
        "imu/data_raw integrated": str(stream.accepted),
        "imu/data_raw rate": "unknown" if math.isnan(stream.nominal) else f"{1.0 / stream.nominal:.1f} Hz",
        "gyro bias": " ".join(f"{x * _BIAS_UNIT:.4f}" for x in navigator.gyro_bias) + " deg/h",
        "accelerometer bias": " ".join(f"{x:.5f}" for x in navigator.accel_bias) + " m/s^2",
    }
    if navigator.phase in (Phase.FINE, Phase.NAVIGATING):
        sigma = np.sqrt(navigator.accuracy.covariance.diagonal())
        values |= _sigmas(sigma, sigma[HEADING])
        values |= {
            "stopped": str(front_end.detector.stopped).lower(),
            "ZUPT calibrations": str(calibrations),
        }
    values |= {kind: str(count) for kind, count in events.counts.items()}
    level, text = _summary(navigator, silent_for)
    return level, text, values


def alignment_diagnostics(navigator: DelayedNavigator, silent_for: float = 0.0) -> tuple[int, str, dict[str, str]]:
    """The same of the filter: its sigmas, progress of fine alignment, and every aid with its last innovation."""
    stream = navigator.front_end.stream
    values = {
        "phase": navigator.phase.value,
        "coarse alignment progress": f"{100.0 * navigator.front_end.progress:.0f} %",
        "imu/data_raw received": str(stream.received),
        "imu/data_raw used": str(stream.accepted),
    }
    if navigator.filter is not None:
        p = navigator.filter.p
        sigma = np.sqrt(p.diagonal())
        values |= _sigmas(sigma, navigator.filter.heading_stddev)
        values |= {
            "time left by prediction": f"{navigator.time_left:.0f} s",
            "gyro bias": _with_sigma(navigator.gyro_bias, sigma[GYRO_BIAS], _BIAS_UNIT, 4) + " deg/h",
            "accelerometer bias": _with_sigma(navigator.accel_bias, sigma[ACCEL_BIAS], 1.0, 5) + " m/s^2",
        }
    for name, record in navigator.records.items():
        values[f"{name}: accepted, rejected"] = f"{record.accepted}, {record.rejected}"
        if record.last is not None:
            values[f"{name}: innovation"] = _with_sigma(record.last.innovation, record.last.sigma, 1.0, 3)
            values[f"{name}: test ratio"] = f"{record.last.test_ratio:.2f}"
            if record.last.noise_factor > 1.0:
                values[f"{name}: sigma enlarged"] = f"{math.sqrt(record.last.noise_factor):.1f} times"
            if record.accepted:
                age = (navigator.settled_ns - record.accepted_ns) / NS
                values[f"{name}: last accepted"] = f"{age:.1f} s ago"
        values |= {f"{name}: {key}": text for key, text in navigator.status(name).items()}
    values |= {kind: str(count) for kind, count in navigator.events.counts.items()}
    level, text = _summary(navigator, silent_for)
    if level == 0 and navigator.phase is Phase.FINE and navigator.filter is not None:
        stddev = math.degrees(navigator.filter.heading_stddev)
        text = f"fine; heading sigma {stddev:.2f}°, {navigator.time_left:.0f} s left"
    missed = navigator.missed()
    if level == 0 and missed:
        level, text = 1, f"{text}; {'; '.join(missed)}"
    return level, text, values


def _sigmas(sigma: NDArray[np.float64], heading: float) -> dict[str, str]:
    """Of the solution, for people; the array as `ins_nav.estimation.state_layout`."""
    return {
        "position sigma": f"{math.hypot(*sigma[HORIZONTAL_POSITION]):.3f} m",
        "height sigma": f"{sigma[HEIGHT]:.3f} m",
        "velocity sigma": f"{math.hypot(*sigma[HORIZONTAL_VELOCITY]):.4f} m/s",
        "level sigma": f"{math.degrees(max(sigma[TILT])):.5f} deg",
        "heading sigma": f"{math.degrees(heading):.4f} deg",
    }


def _with_sigma(values: Iterable[float], sigmas: Iterable[float], unit: float, digits: int) -> str:
    return ", ".join(f"{x * unit:.{digits}f} ± {s * unit:.{digits}f}" for x, s in zip(values, sigmas, strict=True))


def _summary(navigator: RealtimeNavigator | DelayedNavigator, silent_for: float) -> tuple[int, str]:
    stream = navigator.front_end.stream
    if stream.received == 0:
        return 1, "no messages on imu/data_raw yet"
    if stream.accepted == 0:
        return 2, "every message on imu/data_raw was rejected: see the counts"
    if silent_for >= SILENCE:
        return 2, silence(silent_for)
    recent = [report for report in navigator.events.recent(navigator.front_end.stamp_ns) if report.level != INFO]
    if recent:
        level = 2 if any(report.level == ERROR for report in recent) else 1
        return level, f"{navigator.phase.value}; {recent[-1].text}"
    return 0, navigator.phase.value
