"""Queue of observations: order, late and early messages, the latest of an aid that keeps it."""

import itertools
from typing import Any

import pytest
from aid_harness import aids_of
from aid_messages import MESSAGES

from ins_nav.aiding.aid_queue import AidQueue
from ins_nav.event_log import EventLog
from ins_nav.stamps import NS

NOW = 1_000 * NS
ROWS = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


class Fed:
    def __init__(self, **overrides: object) -> None:
        self.events = EventLog()
        parameters = {"range.beacons": "a"} | {name.replace("__", "."): value for name, value in overrides.items()}
        self.queue = AidQueue(aids_of(parameters), self.events)

    def add(self, kind: str, stamp_ns: int, *values: Any, now_ns: int = NOW, settled_ns: int = 0) -> bool:
        """Whether there is an observation."""
        topic, make = ("beacon/a/fix", MESSAGES["fix"][1]) if kind == "beacon" else MESSAGES[kind]
        return self.queue.add(topic, make(stamp_ns, *values), now_ns, settled_ns) is not None

    def stamps(self, until_ns: int = 2 * NOW) -> list[int]:
        return [observation.stamp_ns - NOW for observation in self.queue.until(until_ns)]


A_FIX = (0, 60.0, 30.0, 5.0, ROWS)


def test_order_is_by_stamp_and_content_whatever_the_order_of_arrival() -> None:
    messages: list[tuple[Any, ...]] = [
        ("fix", NOW + 2, *A_FIX),
        ("velocity", NOW + 1, (1.0, 2.0, 3.0), ROWS),
        ("depth", NOW + 1, 5.0, 0.1),
        ("depth", NOW + 1, 4.0, 0.1),
    ]
    orders = []
    for order in itertools.permutations(messages):
        fed = Fed()
        assert all(fed.add(*message) for message in order)
        orders.append([(o.stamp_ns, o.aid, o.value) for o in fed.queue.until(2 * NOW)])
    assert all(order == orders[0] for order in orders)
    assert [aid for _, aid, _ in orders[0]] == ["depth", "depth", "gnss_velocity", "gnss"]


def test_observations_leave_up_to_a_stamp() -> None:
    fed = Fed()
    for k in (3, 1, 2):
        fed.add("depth", NOW + k, 5.0, 0.1)
    assert fed.stamps(NOW + 2) == [1, 2] and fed.stamps() == [3]


def test_delay_is_subtracted() -> None:
    fed = Fed(depth__delay=0.5)
    fed.add("depth", NOW, 5.0, 0.1)
    assert fed.stamps() == [-NS // 2]


def test_late_and_early_messages_are_rejected_and_counted() -> None:
    fed = Fed()
    fed.queue.begin(NOW - 5 * NS)
    assert fed.add("depth", NOW - 3 * NS, 5.0, 0.1, settled_ns=NOW - 2 * NS)
    assert fed.add("depth", NOW + 6 * NS, 5.0, 0.1, settled_ns=NOW - 2 * NS)
    assert fed.stamps() == [] and fed.events.counts == {"depth late": 1, "depth ahead": 1}
    texts = [report.text for report in fed.events.drain()]
    assert texts[0].startswith("depth: 3.00 s behind imu/data_raw, rejected: raise aiding.max_delay")
    assert texts[1].startswith("depth: 6.0 s ahead of imu/data_raw, rejected")
    # from before the filter began: nothing to report
    fed.add("depth", NOW - 6 * NS, 5.0, 0.1, settled_ns=NOW - 2 * NS)
    assert fed.events.counts["depth late"] == 1


def test_unusable_messages_are_counted_and_end_silence() -> None:
    fed = Fed()
    assert not fed.add("fix", NOW, -1, 0.0, 0.0, 0.0)
    assert not fed.add("pressure", NOW, -5.0)
    assert fed.events.counts == {"gnss no fix": 1, "pressure unusable": 1}
    assert fed.queue.heard == {"gnss", "pressure"} and fed.stamps() == []


def test_an_aid_that_is_not_enabled_is_read_and_not_queued() -> None:
    """Alignment may still need its place."""
    fed = Fed(gnss__enabled=False)
    assert fed.add("fix", NOW, *A_FIX)
    assert fed.stamps() == [] and fed.queue.heard == set()


def test_topics_of_others_are_ignored() -> None:
    assert Fed().queue.add("elsewhere", MESSAGES["depth"][1](NOW, 5.0), NOW, 0) is None


def test_before_the_first_sample_only_the_latest_is_kept() -> None:
    fed = Fed()
    fed.add("depth", NOW - NS, 5.0, 0.1, now_ns=0)
    fed.add("beacon", NOW - 2 * NS, *A_FIX, now_ns=0)
    fed.add("beacon", NOW - 9 * NS, *A_FIX, now_ns=0)
    assert fed.stamps() == []
    fed.queue.restart()  # alignment restarts
    fed.queue.begin(NOW)
    assert fed.stamps() == [-2 * NS]


@pytest.mark.parametrize(("seconds", "level"), [(10.0, "info"), (60.0, "warn")])
def test_a_late_fix_of_a_beacon_is_used(seconds: float, level: str) -> None:
    fed = Fed()
    fed.queue.begin(NOW - 100 * NS)
    fed.add("beacon", NOW - round(seconds * NS), *A_FIX, settled_ns=NOW - 2 * NS)
    assert fed.stamps() == [-round(seconds * NS)]
    (report,) = fed.events.drain()
    assert report.level == level and "used for the beacon's place at that time" in report.text


def test_old_observations_are_dropped_while_there_is_no_filter() -> None:
    fed = Fed()
    fed.add("depth", NOW, 5.0, 0.1)
    fed.add("depth", NOW + 60 * NS, 5.0, 0.1, now_ns=NOW + 60 * NS)
    assert fed.stamps() == [60 * NS]
