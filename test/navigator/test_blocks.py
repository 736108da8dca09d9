"""Blocks of samples, as `ins_process` has them, against one sample after the other, as a live node has them."""

import math
from typing import Any

import aid_messages
import numpy as np
import pytest
from navigators import Ins

from ins_nav.messages.solution import SolutionMessages
from ins_nav.navigator.correction import NEVER_NS
from ins_nav.navigator.system import ScheduledCalls
from ins_nav.simulation.scenarios import simulate

RATE = 100.0
NS = 1_000_000_000
PARAMETERS: dict[str, Any] = {
    "initial.latitude_deg": 55.7,
    "initial.longitude_deg": 37.6,
    "initial.height": 150.0,
    "alignment.duration": 10.0,
    "imu.mounting_rpy_deg": [0.0, 0.0, 30.0],
    "stop_detector.start_sequence": "zupt2",
    "stop_detector.zupt2_after": 5.0,
}


def _stream() -> tuple[np.ndarray, np.ndarray]:
    """A drive with stops, gaps, repeated and backward stamps, invalid values, a frozen axis; its beginning again."""
    s = simulate("vehicle", 3, rate=RATE, duration=60.0, stand_time=20.0)
    stamps, values = s.stamps_ns.copy(), np.column_stack([s.angular_velocity, s.linear_acceleration])
    stamps[3000], stamps[3500] = stamps[2999], stamps[3490]
    values[3200:3203, 1], values[1500, 4] = math.nan, 1e9
    values[5200:5600, 2] = values[5199, 2]
    kept = np.ones(len(stamps), dtype=bool)
    kept[2500], kept[4000:4070], kept[5000:5003] = False, False, False
    stamps, values = stamps[kept], values[kept]
    return np.concatenate([stamps, stamps[:3000]]), np.vstack([values, values[:3000]])


class Run:
    """A system, and all that it has published."""

    def __init__(self, **parameters: Any) -> None:
        self.system = Ins(PARAMETERS | parameters, aided=True)
        self.out: list[object] = []
        self.calls = ScheduledCalls(self.system, self.out.append, lambda *answer: self.out.append(answer))
        self.messages = SolutionMessages(self.system.realtime)

    def publish(self) -> None:
        entries = self.system.realtime.entries
        for row, stamp_ns in enumerate(entries.stamps.tolist()):
            if self.messages.due(stamp_ns):
                self.messages.fill(entries, row)
                contents = (self.messages.odometry, self.messages.imu, self.messages.fix)
                self.out.append((stamp_ns, self.messages.first, *(content.serialized() for content in contents)))

    def fix(self, stamp_ns: int) -> None:
        aid_messages.add(self.system, "fix", stamp_ns, 0, 55.7, 37.6, 150.0)

    def one_by_one(self, stamps: np.ndarray, values: np.ndarray) -> None:
        for stamp_ns, row in zip(stamps.tolist(), values.tolist(), strict=True):
            if self.system.add_imu(stamp_ns, *row):
                self.publish()
            self.calls.after_sample()

    def in_blocks(self, stamps: np.ndarray, values: np.ndarray) -> int:
        runs = first = 0
        while first < len(stamps):
            count, new = self.system.add_imu_run(stamps[first:], values[first:], self.calls.due_ns)
            if new:
                self.publish()
            self.calls.after_sample()
            first, runs = first + count, runs + 1
        return runs


@pytest.mark.parametrize("parameters", [{}, {"publish.rate": 30.0, "imu.sampling": "instantaneous"}])
def test_blocks_are_sample_after_sample(parameters: dict[str, Any]) -> None:
    """Fixes at 1 Hz, stops, ZUPT calls, faults, a restart: messages and reports are the same to the last bit."""
    stamps, values = _stream()
    one, other = Run(**parameters), Run(**parameters)
    runs = 0
    for first in range(0, len(stamps), 100):
        part = slice(first, first + 100)
        one.one_by_one(stamps[part], values[part])
        runs += other.in_blocks(stamps[part], values[part])
        for run in (one, other):
            run.fix(int(stamps[part][-1]) - 50_000_000)
    assert other.out == one.out
    assert (
        len(one.out) > 1000 and True in one.out and any(item[0] == "zupt2" for item in one.out if type(item) is tuple)
    )
    assert one.system.restarts == 1 and other.system.restarts == 1
    found = [(run.system.events.counts, run.system.events.drain()) for run in (one, other)]
    assert found[0] == found[1] and found[0][0]["frozen axes"] > 1
    assert runs < 0.7 * len(stamps)  # at 100 Hz a block of the stop detector has 10 samples


def test_a_block_that_is_alone() -> None:
    run = Run()
    assert run.system.add_imu_run(np.array([NS]), np.zeros((1, 6)), NEVER_NS) == (1, False)
