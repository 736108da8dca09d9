"""Layout of the error state: blocks follow each other without gaps, absent ones have no rows."""

import numpy as np
import pytest

from ins_nav.estimation import state_layout
from ins_nav.estimation.state_layout import SIZE, StateLayout


def test_common_blocks_cover_every_state_once() -> None:
    blocks = [getattr(state_layout, name) for name in ("POSITION", "VELOCITY", "ATTITUDE", "GYRO_BIAS", "ACCEL_BIAS")]
    rows = [i for block in blocks for i in range(SIZE)[block]]
    assert [*rows, state_layout.COSINE] == list(range(SIZE))
    assert rows == list(range(SIZE))[state_layout.SOLUTION]
    assert len(rows) == state_layout.SOLUTION_SIZE


def test_parts_of_blocks() -> None:
    rows = np.arange(SIZE)
    layout = state_layout
    np.testing.assert_array_equal(rows[layout.POSITION], [*rows[layout.HORIZONTAL_POSITION], layout.HEIGHT])
    np.testing.assert_array_equal(rows[layout.VELOCITY], [*rows[layout.HORIZONTAL_VELOCITY], layout.VERTICAL_VELOCITY])
    np.testing.assert_array_equal(rows[layout.ATTITUDE], [*rows[layout.TILT], layout.HEADING])
    np.testing.assert_array_equal(rows[layout.BIASES], [*rows[layout.GYRO_BIAS], *rows[layout.ACCEL_BIAS]])
    np.testing.assert_array_equal(layout.POSE, [*rows[layout.POSITION], *rows[layout.ATTITUDE]])
    np.testing.assert_array_equal(rows[layout.NAVIGATION], [*rows[layout.MOTION], *rows[layout.ATTITUDE]])
    np.testing.assert_array_equal(rows[layout.SENSED], [*rows[layout.ATTITUDE], *rows[layout.BIASES]])


def test_further_blocks() -> None:
    layout = StateLayout({"gyro_scale": 3, "log": 2})
    assert layout.size == SIZE + 5
    assert layout["gyro_scale"] == slice(SIZE, SIZE + 3)
    assert layout["log"] == slice(SIZE + 3, SIZE + 5)
    assert "log" in layout and "gnss" not in layout
    np.testing.assert_array_equal(layout.columns("log", "gnss", "gyro_scale"), [19, 20, 16, 17, 18])
    with pytest.raises(KeyError):
        layout["gnss"]
    assert StateLayout().size == SIZE
