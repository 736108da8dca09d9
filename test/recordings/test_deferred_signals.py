"""A signal does not interrupt the writing of a message."""

import signal
from pathlib import Path
from unittest import mock

import pytest
from recordings_harness import IMU, START_NS, read

from ins_nav.errors import Interrupted
from ins_nav.recordings.bags import (
    BagWriter,
    message,
)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_waits_until_the_message_is_complete(tmp_path: Path, number: int) -> None:
    """The signal arrives while the writer writes a message, which is complete when the handler runs."""
    written = []

    def handle(received: int, _frame: object) -> None:
        written.append(bag._writer.counts.copy())
        raise Interrupted(received)

    before = signal.signal(number, handle)
    try:
        with pytest.raises(Interrupted), BagWriter(tmp_path / "bag") as bag:
            original = bag._writer.storage.write

            def write(*arguments: object) -> None:
                signal.raise_signal(number)
                original(*arguments)

            with mock.patch.object(bag._writer.storage, "write", write):
                bag.write("imu/data", IMU, message(IMU), START_NS)
        assert signal.getsignal(number) is handle
    finally:
        signal.signal(number, before)
    assert [list(counts.values()) for counts in written] == [[1]]
    messages, damage = read(tmp_path / "bag")
    assert len(messages) == 1 and not damage and (tmp_path / "bag" / "metadata.yaml").exists()
