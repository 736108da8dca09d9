"""Specific force in the mean: its unit, its scale, its direction."""

import numpy as np
import pytest

from ins_nav.event_log import ERROR, WARN
from ins_nav.mechanization.gravity_monitor import GravityFault, GravityMonitor
from ins_nav.mechanization.window_statistics import window_statistics

UP = np.array([0.1, -0.2, 9.8])


def _fed(forces: list[np.ndarray], rate: float = 0.0) -> list[GravityFault | None]:
    """Seconds of samples at such mean forces, while the body turns."""
    rng = np.random.default_rng(0)
    monitor = GravityMonitor()
    faults = []
    for force in forces:
        values = np.r_[rate, 0.0, 0.0, force] + 0.01 * rng.standard_normal((51, 6))
        faults.append(monitor.add(window_statistics(values), 1.0))
    return faults


@pytest.mark.parametrize(("factor", "unit"), [(1 / 9.80665, "in g"), (1e3 / 9.80665, "in mg"), (3.281, "in ft/s²")])
def test_a_unit_that_changes_under_way_is_named(factor: float, unit: str) -> None:
    faults = _fed([UP] * 20 + [factor * UP] * 5)
    assert faults[:24] == [None] * 24
    fault = faults[24]
    assert fault is not None and fault.level == ERROR
    assert unit in fault.text
    assert fault.error == pytest.approx((factor - 1.0) * 9.8, rel=0.02)


@pytest.mark.parametrize("factor", [0.93, 1.18])
def test_a_scale_that_is_wrong_shows_in_a_minute(factor: float) -> None:
    faults = _fed([factor * UP] * 60)
    assert faults[:59] == [None] * 59
    assert faults[59] is not None and faults[59].level == WARN


def test_hard_driving_is_no_fault() -> None:
    """Up to 0.6 g to any side, every second another one, over two minutes."""
    rng = np.random.default_rng(1)
    sides = rng.uniform(-6.0, 6.0, (120, 2)) / np.sqrt(2.0)
    assert _fed([UP + np.r_[side, 0.0] for side in sides]) == [None] * 120


@pytest.mark.parametrize(
    "change", [lambda f: -f, lambda f: f * [1, 1, -1], lambda f: f[[0, 2, 1]], lambda f: f[[2, 1, 0]]]
)
def test_a_sign_or_axes_that_change_under_way(change: object) -> None:
    """Reported until it is as before."""
    assert callable(change)
    faults = _fed([UP] * 5 + [change(UP)] * 10 + [UP] * 5)
    assert [fault is not None for fault in faults] == [False] * 5 + [True] * 10 + [False] * 5
    fault = faults[5]
    assert fault is not None and fault.level == ERROR and "sign or the axes of linear_acceleration" in fault.text
    assert fault.error > 9.0


def test_a_body_that_turns_over() -> None:
    assert _fed([UP, UP[[0, 2, 1]], -UP, -UP], rate=1.6) == [None] * 4
