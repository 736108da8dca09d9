"""Diagnostics: level and line of a navigator's state, sigmas, counts."""

import math

from navigators import Filter, Ins

from ins_nav.mechanization import attitude, earth, nav_state
from ins_nav.messages.diagnostics import SILENCE, alignment_diagnostics, diagnostics
from ins_nav.simulation.scenarios import START_NS

NS = 10**9
HERE = {"initial.latitude_deg": 55.7, "initial.longitude_deg": 37.6, "initial.height": 150.0}
SHORT = {"alignment.level_duration": 2.0, "initial.heading_deg": 30.0}
LAT = math.radians(55.7)
LEVEL = attitude.from_euler(0.0, 0.0, math.radians(60.0))  # heading 30°
RATE = nav_state.earth_rate_body(nav_state.initial_state(LAT, math.radians(37.6), 150.0, (0.0, 0.0, 0.0), LEVEL))
STANDING = (*RATE, 0.0, 0.0, earth.normal_gravity(math.sin(LAT), 150.0))


def fed(seconds: float, **overrides: object) -> Ins:
    """A level base that stands, 50 Hz."""
    ins = Ins({**HERE, **SHORT, **overrides})
    for i in range(round(50 * seconds)):
        ins.add_imu(START_NS + i * NS // 50, *STANDING)
    return ins


def test_without_samples() -> None:
    assert diagnostics(fed(0.0).realtime, 0)[:2] == (1, "no messages on imu/data_raw yet")


def test_every_sample_rejected() -> None:
    ins = Ins(HERE)
    for i in range(50):
        ins.add_imu(START_NS + i * NS // 50, math.nan, *STANDING[1:])
    level, text, values = diagnostics(ins.realtime, 0)
    assert (level, text) == (2, "every message on imu/data_raw was rejected: see the counts")
    assert values["not finite"] == "50"


def test_silence_is_an_error() -> None:
    ins = fed(4.0)
    assert diagnostics(ins.realtime, 0, SILENCE - 0.1)[0] == 0
    level, text, _ = diagnostics(ins.realtime, 0, 3.0)
    assert (level, text) == (2, "no messages on imu/data_raw for 3 s: is the driver running?")


def test_navigating() -> None:
    level, text, values = diagnostics(fed(4.0).realtime, 2)
    assert (level, text) == (0, "navigating")
    assert values["imu/data_raw rate"] == "50.0 Hz"
    assert (values["imu/data_raw received"], values["ZUPT calibrations"]) == ("200", "2")
    assert values["heading sigma"].endswith(" deg") and values["position sigma"].endswith(" m")


def test_a_warning_lasts_ten_seconds() -> None:
    ins = fed(4.0)
    ins.events.drain()
    after = START_NS + 4 * NS
    for i in range(2):
        ins.add_imu(after + NS + i * NS // 50, *STANDING)  # after a gap of 1 s
    level, text, values = diagnostics(ins.realtime, 0)
    assert level == 1 and text.startswith("navigating; imu/data_raw: gap of 1.0")
    assert values["long gaps"] == "1"
    for i in range(2, 50 * 11):
        ins.add_imu(after + NS + i * NS // 50, *STANDING)
    assert diagnostics(ins.realtime, 0)[:2] == (0, "navigating")


def test_the_filter_names_aids_of_which_nothing_arrives() -> None:
    aided = Filter({**HERE, **SHORT, "range.beacons": "vessel"})
    for i in range(50 * 40):
        aided.add_imu(START_NS + i * NS // 50, *STANDING)
    level, text, values = alignment_diagnostics(aided.delayed)
    assert level == 1 and "range/vessel: never heard" in text
    assert "time left by prediction" in values and "±" in values["gyro bias"]
