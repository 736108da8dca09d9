"""Jacobians of every registered aid against numerical differences, from its simulated messages.

Each aid is configured twice: by its defaults, and with every option on (states of slow errors, mountings, lever arms).
Nothing here names an aid, but for the names of beacons that two of them need.
"""

import functools
import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulation_harness import path, stamps_of

from ins_nav.aiding.base import NO_STATES, Aid, Observation, OwnStates
from ins_nav.aiding.parameters import configuration
from ins_nav.aiding.registry import aid_classes, create_aids
from ins_nav.config.parameters import Parameter
from ins_nav.estimation.error_model import ErrorModel
from ins_nav.estimation.observation import Measurement, Solution
from ins_nav.estimation.state_layout import ACCEL_BIAS, ATTITUDE, COSINE, GYRO_BIAS, HEADING, POSITION, SIZE, VELOCITY
from ins_nav.mechanization.nav_state import NavState, initial_state
from ins_nav.recordings.bags import message
from ins_nav.simulation.aids import measure_aids
from ins_nav.simulation.parameters import SHARED, resolved

NAMES: dict[str, object] = {"range.beacons": "vessel"}
SIMULATED_NAMES: dict[str, Any] = {"beacon.names": "vessel", "beacon.positions": (300.0, 400.0, -2.0)}
AT = 601
"""Instant of the measurements, 30 s after the start."""
ZERO = (0.0, 0.0, 0.0)
MODEL = ErrorModel(vertical=True, gyro_noise=0.0, accel_noise=0.0)


def every_option(row: Parameter) -> object | None:
    """A value that differs from the default and leads to more states or other axes; None for the default."""
    key = row.name.rpartition(".")[2]
    if key == "lever_arm":
        return [2.0, -1.0, 3.0]
    if key.endswith("rpy_deg"):
        return [5.0, -10.0, 40.0]
    if isinstance(row.default, bool):
        return True
    if key.endswith("stddev") and row.default == 0.0:
        return min(0.1, row.high)
    if key.endswith("_deg") and row.default == 0.0:
        return 3.0
    return None


@functools.cache
def messages() -> dict[str, Any]:
    """The message of each topic that is nearest before the instant, by topic, in order of stamps."""
    rates = {name: (5.0,) if p.many else 5.0 for name, p in SHARED.items() if name.endswith(("rate", "fix_rates"))}
    del rates["rate"], rates["truth.rate"]
    t = path()
    parameters = resolved("test", SHARED, {"rate": 1.0 / t.interval, **rates, **SIMULATED_NAMES})
    found: dict[str, Any] = {}
    for topic, readings in measure_aids(parameters, t, stamps_of(t), 1).items():
        for stamp_ns, msg in readings.messages(message):
            if stamp_ns < stamps_of(t)[AT]:
                found[topic] = msg
    return found


def the_state() -> NavState:
    """The true one, n turned from east-north-up by 0.4 rad."""
    t = path()
    state = initial_state(t.lat[AT], t.lon[AT], t.height[AT], tuple(t.velocity_n[AT]), tuple(t.q_nb[AT]))
    turn = Rotation.from_rotvec([0.0, 0.0, 0.4])
    q_nb = (turn.inv() * Rotation.from_quat(state[0:4])).as_quat()
    q_en = (Rotation.from_quat(state[7:11]) * turn).as_quat()
    return NavState(*q_nb.tolist(), *turn.inv().apply(state[4:7]).tolist(), *q_en.tolist(), state[11])


def solution(state: NavState, gyro_bias: tuple[float, float, float] = ZERO, turn: float = 0.0) -> Solution:
    """Of a known heading, unless ``turn`` is larger."""
    rate = tuple((path().rate[AT] - gyro_bias).tolist())
    return Solution(state, rate, gyro_bias, True, turn, stamp_ns=int(stamps_of(path())[AT]))


Case = tuple[Aid[Any], Observation, np.ndarray]
"""An aid, its observation, and values of its states and of shared ones."""


def cases(options: bool) -> dict[str, Case]:
    rows = [row for kind in aid_classes() for row in kind.rows(NAMES)]
    changed = {row.name: value for row in rows if options and (value := every_option(row)) is not None}
    aids = create_aids(configuration(NAMES | changed).values)
    rng = np.random.default_rng(2)
    found: dict[str, Case] = {}
    for topic in sorted(messages(), key=lambda name: name.startswith("range")):  # what is shared is measured before
        aid = next((aid for aid in aids.values() if aid.topic == topic), None)
        if aid is None:  # of the truth
            continue
        observation = aid.observe(messages()[topic])
        count = len(aid.states) + (len(aids[aid.shares].states) if aid.shares else 0)
        values = 0.02 * rng.standard_normal(count)
        first = measured(aid, solution(the_state()), values, observation)
        assert np.isfinite(first.innovation).all()
        found[aid.name] = aid, observation, values
    return found


def measured(aid: Aid[Any], at: Solution, values: np.ndarray, observation: Observation) -> Measurement:
    own = OwnStates(values, np.zeros((len(values), len(values)))) if len(values) else NO_STATES
    measurement = aid.measure(at, own, observation)
    assert measurement is not None
    return measurement


def test_every_aid_has_simulated_messages() -> None:
    assert {type(aid) for aid, _, _ in cases(False).values()} == set(aid_classes())


STEPS = ((POSITION, 1.0), (VELOCITY, 0.1), (ATTITUDE, 1e-4), (GYRO_BIAS, 1e-4), (ACCEL_BIAS, 1e-3))
"""m, m/s, rad, rad/s, m/s²."""


@pytest.mark.parametrize("options", [False, True], ids=["defaults", "every option"])
@pytest.mark.parametrize("name", list(cases(False)))
def test_columns_of_the_solution(name: str, options: bool) -> None:
    """Central differences through `ErrorModel.apply`."""
    aid, observation, values = cases(options)[name]
    here = the_state()
    h = measured(aid, solution(here), values, observation).h
    for block, step in STEPS:
        for i in range(block.start, block.stop):
            z = []
            for sign in (-1.0, 1.0):
                x = np.zeros(SIZE)
                x[i] = sign * step
                state, gyro_bias, _ = MODEL.apply(x, here, ZERO, ZERO)
                z.append(measured(aid, solution(state, gyro_bias), values, observation).innovation)
            # left out by measurements: the turn of east and north with position, 2e-6 rad/m times 2 m/s, and that of
            # Earth's rate over an arm of 4 m with attitude, 3e-4 m/s a radian
            np.testing.assert_allclose(h[:, i], (z[0] - z[1]) / (2.0 * step), atol=5e-4 if i > 2 else 2e-5, rtol=1e-6)


@pytest.mark.parametrize("options", [False, True], ids=["defaults", "every option"])
@pytest.mark.parametrize("name", list(cases(False)))
def test_columns_of_aid_states_and_shared_ones(name: str, options: bool) -> None:
    aid, observation, values = cases(options)[name]
    measurement = measured(aid, solution(the_state()), values, observation)
    assert measurement.shares == ((aid.shares,) if aid.shares else ())
    assert (0 if measurement.own is None else measurement.own.shape[1]) == len(values)
    for i in range(len(values)):
        change = np.eye(len(values))[i] * 1e-4
        z = [measured(aid, solution(the_state()), values + s * change, observation).innovation for s in (-1.0, 1.0)]
        assert measurement.own is not None
        # rounding of Earth-fixed positions, 1e-9 m, over the step
        np.testing.assert_allclose(measurement.own[:, i], (z[1] - z[0]) / 2e-4, rtol=1e-6, atol=2e-5)


@pytest.mark.parametrize("name", list(cases(False)))
@pytest.mark.parametrize("gamma", [1.0, -2.5, math.pi])
def test_any_heading_error_is_linear(name: str, gamma: float) -> None:
    """Sine and cosine columns of an unknown heading are no approximation, but the change by a turn of any angle."""
    aid, observation, values = cases(True)[name]
    here = the_state()
    x = np.zeros(SIZE)
    x[HEADING], x[COSINE] = math.sin(gamma), 1.0 - math.cos(gamma)
    state, *_ = MODEL.apply(x, here, ZERO, ZERO)
    before, after = (measured(aid, solution(s, turn=1.0), values, observation) for s in (here, state))
    arm = np.linalg.norm(aid.parameters.lever_arm)
    # Earth's rate over an arm of 4 m: 3e-4 m/s; a range of 500 m is curved: twice the arm squared over twice the range
    atol = 4.0 * arm**2 / 1000.0 if aid.shares else 6e-4
    np.testing.assert_allclose(before.innovation - after.innovation, before.h @ x, atol=atol)
