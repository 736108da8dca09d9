"""A simulated MEMS IMU for the monitors: a car that stands for a minute, drives, and stands again."""

from typing import Any

import numpy as np

from ins_nav.event_log import EventLog, Report
from ins_nav.mechanization.imu_condition import HiddenErrors
from ins_nav.mechanization.imu_monitor import ImuMonitor

START = 1_700_000_000_000_000_000
STAND, DRIVE = 60.0, 90.0
GYRO_STEP, ACCEL_STEP = 1.22e-4, 9.8e-3
"""Resolution of a TDK ICM-45686 as one driver publishes it, rad/s and m/s²."""
GYRO_NOISE, ACCEL_NOISE = 8e-4, 9e-3
"""Of a sample at 100 Hz."""


def drive(seed: int = 0, rate: float = 100.0, resolution: float = 0.0, noise: float = 1.0) -> np.ndarray:
    """Samples, shape (n, 6): 60 s at rest, 90 s in motion, 30 s at rest.

    Parameters
    ----------
    seed : int
    rate : float
        Hz.
    resolution : float
        Steps of quantization, in units of those of a real MEMS IMU; 0: none.
    noise : float
        In units of that of a real one.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(round((STAND + DRIVE + 30.0) * rate)) / rate
    moving = (time > STAND) & (time < STAND + DRIVE)
    scale = np.sqrt(rate / 100.0) * noise * np.r_[np.full(3, GYRO_NOISE), np.full(3, ACCEL_NOISE)]
    values = scale * rng.standard_normal((len(time), 6))
    vibration = moving[:, None] * np.r_[np.full(3, 0.02), np.full(3, 0.4)] * rng.standard_normal((len(time), 6))
    values += vibration * (1.0 + 0.5 * np.sin(0.3 * time))[:, None]
    values[:, 2] += moving * 0.3 * np.sin(0.4 * time)
    values[:, 3] += moving * 1.0 * np.sin(0.25 * time)
    values[:, 4] += moving * 2.0 * np.sin(0.4 * time)
    values += [1e-3, -2e-3, 5e-4, 0.1, -0.05, 9.81]
    if resolution:
        step = resolution * np.r_[np.full(3, GYRO_STEP), np.full(3, ACCEL_STEP)]
        values = np.rint(values / step) * step
    return values


def standing(time: float) -> bool:
    """Whether the stop detector would say so, with its delay."""
    return 3.0 < time < STAND + 1.0 or time > STAND + DRIVE + 3.0


class Monitored:
    """A monitor fed with samples."""

    def __init__(self, values: np.ndarray, rate: float = 100.0, **options: Any) -> None:
        self.events = EventLog()
        self.monitor = ImuMonitor(self.events)
        self.hidden: list[HiddenErrors] = []
        self.first: dict[str, float] = {}
        """s from the start to the first event of a kind."""
        step_ns = round(1e9 / rate)
        for i, row in enumerate(values.tolist()):
            at = i / rate
            if self.monitor.add(START + i * step_ns, (1.0 / rate, *row), standing(at)):
                self.hidden += self.monitor.hidden
            for kind in self.events.counts.keys() - self.first.keys():
                self.first[kind] = at
        self.reports: list[Report] = self.events.drain()

    @property
    def text(self) -> str:
        return "\n".join(report.text for report in self.reports)

    def hidden_at(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Variances in a second at a time, rates and forces."""
        stamp = START + round(time * 1e9)
        found = [entry for entry in self.hidden if entry.begin_ns < stamp <= entry.end_ns]
        zero = np.zeros(3)
        return sum((e.rate for e in found), zero), sum((e.force for e in found), zero)
