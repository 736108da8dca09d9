"""What samples may hide: on base_link's axes, shared out over time."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ins_nav.mechanization.imu_condition import HiddenErrors, ImuCondition

S = 1_000_000_000


def _errors(begin: int, end: int, rate: float = 1.0, force: float = 0.0) -> HiddenErrors:
    return HiddenErrors(begin * S, end * S, np.array([rate, 0.0, 0.0]), np.array([force, 0.0, 0.0]))


def test_times_that_overlap_add() -> None:
    record = ImuCondition(np.eye(3))
    assert record.between(0, 10 * S) is None
    record.add(_errors(2, 4))
    record.add(_errors(3, 5, rate=2.0, force=3.0))
    found = record.between(0, 3_500_000_000)
    assert found is not None
    assert found[0] == pytest.approx([1.5 + 1.0, 0.0, 0.0])
    assert found[1] == pytest.approx([1.5, 0.0, 0.0])
    assert record.between(5 * S, 9 * S) is None
    assert (record.count, record.earliest(0), record.earliest(1)) == (2, 2 * S, 3 * S)


def test_the_mounting_turns_the_axes() -> None:
    record = ImuCondition(Rotation.from_euler("Z", 90.0, degrees=True).as_matrix())
    record.add(_errors(0, 1))
    found = record.between(0, S)
    assert found is not None
    assert found[0] == pytest.approx([0.0, 1.0, 0.0])


def test_what_is_long_past_is_dropped() -> None:
    record = ImuCondition(np.eye(3))
    record.add(_errors(0, 1))
    record.add(_errors(20, 21))
    assert record.between(0, S) is None
    assert record.count == 2
    record.clear()
    assert (record.count, record.between(20 * S, 21 * S)) == (0, None)
