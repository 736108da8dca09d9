"""Heading from outside: messages, an unknown heading, one that is wrong by half a turn, the yaw of the mounting."""

import math
from functools import partial

import numpy as np
import pytest
from aided_harness import PLACE, Fed, drive, imu_events

from ins_nav.aiding.base import Observation, OwnStates, Unusable
from ins_nav.aiding.heading import Heading, HeadingParameters, heading_message
from ins_nav.aiding.parameters import configuration
from ins_nav.aiding.registry import create_aids
from ins_nav.estimation.observation import Solution
from ins_nav.mechanization import nav_state
from ins_nav.mechanization.attitude import heading_from_yaw, to_euler
from ins_nav.recordings.bags import message
from ins_nav.simulation.scenarios import Simulation

a_heading = partial(heading_message, message)
SIGMA = math.radians(2.0)


def _state(yaw: float, pitch: float = 0.0) -> nav_state.NavState:
    q = (-math.sin(0.5 * pitch) * math.sin(0.5 * yaw), math.sin(0.5 * pitch) * math.cos(0.5 * yaw))
    q_gb = (*q, math.cos(0.5 * pitch) * math.sin(0.5 * yaw), math.cos(0.5 * pitch) * math.cos(0.5 * yaw))
    return nav_state.initial_state(0.97, 0.6, 30.0, (0.0, 0.0, 0.0), q_gb)


def _innovation(yaw: float, reads: float, turn: float, pitch: float = 0.3, **parameters: float) -> np.ndarray:
    aid = Heading(HeadingParameters(**parameters))
    own = OwnStates(np.array([aid.states[0].value]), np.zeros((1, 1)))
    solution = Solution(_state(yaw, pitch), (0.0,) * 3, (0.0,) * 3, True, turn)
    measurement = aid.measure(solution, own, Observation(0, "heading", (reads,), np.array([[SIGMA**2]])))
    assert measurement is not None
    return measurement.innovation


def test_messages() -> None:
    aid = create_aids(configuration({"heading.delay": 0.5}).values)["heading"]
    for yaw in (0.0, 3.0, -3.0):
        observation = aid.observe(a_heading(2_000_000_000, yaw, SIGMA**2))
        assert observation.value[0] == pytest.approx(yaw) and observation.stamp_ns == 1_500_000_000
        np.testing.assert_allclose(observation.covariance, [[SIGMA**2]])
    without = aid.observe(a_heading(0, 1.0)).covariance
    np.testing.assert_allclose(without, [[0.035**2]])
    tilted = a_heading(0, 0.0)
    tilted.orientation.y, tilted.orientation.w = math.sin(0.2), math.cos(0.2)  # bow down by 0.4 rad, to the east
    assert aid.observe(tilted).value[0] == pytest.approx(0.0)


@pytest.mark.parametrize("case", ["no orientation", "not a number", "no unit quaternion", "upright"])
def test_messages_without_a_heading(case: str) -> None:
    aid, msg = Heading(HeadingParameters()), a_heading(0, 1.0, SIGMA**2)
    if case == "no orientation":
        msg.orientation_covariance[0] = -1.0
    elif case == "not a number":
        msg.orientation.z = math.nan
    elif case == "no unit quaternion":
        msg.orientation.w = msg.orientation.z = 0.0
    else:
        msg.orientation.x, msg.orientation.z = 0.0, 0.0
        msg.orientation.y = msg.orientation.w = math.sqrt(0.5)
    with pytest.raises(Unusable, match="rejected"):
        aid.observe(msg)


@pytest.mark.parametrize("yaw", [0.4, 3.1, -2.0])
def test_known_heading_is_an_angle(yaw: float) -> None:
    """Half a turn is an innovation of half a turn, not of its sine."""
    assert _innovation(yaw, yaw, 0.0) == pytest.approx(0.0, abs=1e-12)
    assert _innovation(yaw, yaw + 0.3, 0.0) == pytest.approx(-0.3)
    assert abs(_innovation(yaw, yaw + math.pi, 0.0)[0]) == pytest.approx(math.pi)
    # mounted to the left: its x axis is ahead of the body's
    assert _innovation(yaw, yaw + 0.5, 0.0, 0.0, mounting_yaw=0.5) == pytest.approx(0.0, abs=1e-12)


def test_unknown_heading_is_a_direction() -> None:
    # the mean of a direction with an angle of 2° is shorter by 0.6e-3
    np.testing.assert_allclose(_innovation(0.4, 0.4, 1.0), 0.0, atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(_innovation(0.4, 0.4 + math.pi, 1.0)), 2.0, atol=1e-3)


def test_noise_of_a_direction_is_that_of_draws() -> None:
    """Mean and covariance of the innovation at the true heading, with a sigma of 20°."""
    rng, stddev = np.random.default_rng(1), math.radians(20.0)
    aid, own = Heading(HeadingParameters()), OwnStates(np.zeros(1), np.zeros((1, 1)))
    solution = Solution(_state(0.4), (0.0,) * 3, (0.0,) * 3, True, 1.0)
    drawn, sizes = [], []
    for _ in range(4000):
        reads = 0.4 + stddev * rng.standard_normal()
        measurement = aid.measure(solution, own, Observation(0, "heading", (reads,), np.array([[stddev**2]])))
        assert measurement is not None
        drawn.append(measurement.innovation)
        sizes.append(np.trace(measurement.r))
    # 4000 draws of 0.35: 0.006; the variance to 2 %, and to the fourth order in sigma 6 %
    np.testing.assert_allclose(np.mean(drawn, axis=0), 0.0, atol=0.02)
    assert np.mean(sizes) == pytest.approx(np.trace(np.cov(np.transpose(drawn))), rel=0.1)


def _true_yaw(s: Simulation, stamp_ns: int) -> float:
    i = int(np.searchsorted(s.stamps_ns, stamp_ns)) + 1
    return to_euler(tuple(s.trajectory.q_nb[i].tolist()))[2]


def _fed(parameters: dict[str, object], offset: float = 0.0, after: float = 0.0) -> tuple[Fed, Simulation]:
    """Along a drive with a wrong initial heading; readings at 1 Hz, with an error from a time on, s."""
    s, rng = drive(), np.random.default_rng(4)
    fed = Fed(
        {
            **PLACE,
            "alignment.level_duration": 2.0,
            "zupt.zero_velocity": False,
            "alignment.fine_duration": 20.0,
            **parameters,
        }
    )
    for k, event in enumerate(imu_events(s)):
        fed.feed([event])
        if k % 50 == 0:
            yaw = _true_yaw(s, event[0]) + SIGMA * rng.standard_normal() + (offset if k >= 50.0 * after else 0.0)
            fed.aided.add("heading", a_heading(event[0], yaw, SIGMA**2))
    return fed, s


def _heading_error(fed: Fed, s: Simulation) -> float:
    """rad, over its sigma."""
    assert fed.aided.filter is not None and fed.aided.state is not None
    found = to_euler(nav_state.geodetic(fed.aided.state).q_gb)[2]
    error = found - _true_yaw(s, fed.aided.settled_ns)
    return math.remainder(error, 2.0 * math.pi) / fed.aided.filter.heading_stddev


@pytest.mark.parametrize("wrong_deg", [20.0, 100.0, 179.0])
def test_an_unknown_heading_is_found(wrong_deg: float) -> None:
    s = drive()
    given = math.degrees(heading_from_yaw(_true_yaw(s, int(s.stamps_ns[0])))) + wrong_deg
    given = math.remainder(given, 360.0)
    fed, s = _fed({"initial.heading_deg": given, "initial.heading_stddev_deg": 180.0})
    assert fed.aided.filter is not None
    # a hundred readings of 2°, some of them rejected while heading is unknown
    assert fed.aided.filter.heading_stddev < math.radians(0.4)
    assert abs(_heading_error(fed, s)) < 3.0
    assert fed.aided.records["heading"].rejected <= 2


def test_a_heading_wrong_by_half_a_turn_is_rejected() -> None:
    s = drive()
    given = math.degrees(heading_from_yaw(_true_yaw(s, int(s.stamps_ns[0]))))
    parameters: dict[str, object] = {"initial.heading_deg": given, "initial.heading_stddev_deg": 1.0}
    fed, s = _fed(parameters, math.pi, 30.0)
    assert fed.aided.records["heading"].rejected > 60
    assert abs(_heading_error(fed, s)) < 3.0


def test_yaw_of_the_mounting_is_calibrated() -> None:
    """With a known heading: 3° are estimated within their sigma."""
    s = drive()
    given = math.degrees(heading_from_yaw(_true_yaw(s, int(s.stamps_ns[0]))))
    parameters: dict[str, object] = {"initial.heading_deg": given, "initial.heading_stddev_deg": 0.1}
    fed, s = _fed({**parameters, "heading.mounting_yaw_stddev_deg": 5.0}, math.radians(3.0))
    found = fed.aided.calibration
    yaw, stddev = (float(found[f"heading.mounting_yaw{key}_deg"]) for key in ("", "_stddev"))  # type: ignore[arg-type]
    assert 0.05 < stddev < 0.5 and abs(yaw - 3.0) < 3.0 * stddev


@pytest.mark.parametrize("wrong_deg", [40.0, 100.0, 178.0])
def test_a_wrong_initial_heading_is_corrected_at_once(wrong_deg: float) -> None:
    """Consistent readings, and no sign of a fault of theirs: no part of the error remains with a small sigma."""
    s = drive()
    given = math.degrees(heading_from_yaw(_true_yaw(s, int(s.stamps_ns[0])))) + wrong_deg
    parameters: dict[str, object] = {"initial.heading_stddev_deg": 1.0}
    fed, s = _fed({**parameters, "initial.heading_deg": math.remainder(given, 360.0)})
    assert fed.aided.records["heading"].rejected < 10
    assert abs(_heading_error(fed, s)) < 3.0


def test_slow_error_is_not_averaged() -> None:
    """With a deviation of 2° that changes within a minute, 100 readings of 2° leave more than a degree."""
    s = drive()
    given = math.degrees(heading_from_yaw(_true_yaw(s, int(s.stamps_ns[0]))))
    parameters: dict[str, object] = {"initial.heading_deg": given, "initial.heading_stddev_deg": 20.0}
    white, s = _fed(parameters, math.radians(2.0))
    slow, s = _fed(parameters | {"heading.slow_stddev_deg": 2.0}, math.radians(2.0))
    assert abs(_heading_error(white, s)) > 5.0
    assert abs(_heading_error(slow, s)) < 2.0
    assert slow.aided.filter is not None and slow.aided.filter.heading_stddev > math.radians(1.0)
