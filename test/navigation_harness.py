"""A drive through a navigator without other nodes."""

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from navigators import Ins

from ins_nav.mechanization import earth, nav_state
from ins_nav.simulation.scenarios import Simulation, simulate

Values = tuple[float, ...]


HERE = {"initial.latitude_deg": 55.7, "initial.longitude_deg": 37.6, "initial.height": 150.0}


FREE = {"zupt.zero_velocity": False}
"""Pure inertial navigation."""


HEADING = {"initial.heading_deg": 30.0, "alignment.level_duration": 2.0}


@functools.cache
def city_drive() -> Simulation:
    """Stands for 20 s, then 100 s of streets; perfect sensors."""
    return simulate("vehicle", 0, duration=120.0, stand_time=20.0, rate=100.0, **{"imu.preset": "perfect"})


@functools.cache
def imu_messages(name: str = "vehicle") -> list[tuple[int, Values]]:
    s = city_drive() if name == "vehicle" else standing_base()
    values = np.c_[s.angular_velocity, s.linear_acceleration].tolist()
    return [(int(stamp), tuple(row)) for stamp, row in zip(s.stamps_ns, values, strict=True)]


@functools.cache
def standing_base() -> Simulation:
    return simulate("static", 0, duration=30.0, rate=100.0)


class Fed:
    """A navigator, and every line it told."""

    def __init__(self, **overrides: Any) -> None:
        self.navigator = Ins({name.replace("__", "."): value for name, value in overrides.items()})
        self.said: list[str] = []
        self.solutions = 0

    def feed(self, messages: Sequence[tuple[int, Values]], shift_ns: int = 0) -> "Fed":
        for stamp, values in messages:
            self.solutions += self.navigator.add_imu(stamp + shift_ns, *values)  # type: ignore[arg-type]
        self.said += [report.text for report in self.navigator.events.drain()]
        return self

    def geodetic(self) -> nav_state.Geodetic:
        assert self.navigator.state is not None
        return nav_state.geodetic(self.navigator.state)

    @property
    def counts(self) -> dict[str, int]:
        return self.navigator.events.counts


def distance_to(found: nav_state.Geodetic, s: Simulation, i: int) -> float:
    """Horizontal, m."""
    t = s.trajectory
    true = earth.geodetic_to_ecef(t.lat[i], t.lon[i], found.height)
    return float(np.linalg.norm(earth.geodetic_to_ecef(found.lat, found.lon, found.height) - true))
