"""Covariances of the messages that a solution with the filter goes out as."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from aided_harness import BOTH, NS
from decoding import decoded
from navigators import Ins
from scipy.spatial.transform import Rotation

from ins_nav.cli.process import main
from ins_nav.estimation.error_model import azimuth
from ins_nav.mechanization import nav_state
from ins_nav.mechanization.replay_buffer import Entries
from ins_nav.messages.solution import SolutionMessages
from ins_nav.recordings.bags import BagReader
from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import simulate
from ins_nav.stamps import stamp_of


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("aided") / "bag"
    # what the filter has no states for left out: in a turn a misaligned gyro tilts the level by more than its sigma
    ideal = {f"imu.gyro_{name}": 0.0 for name in ("scale_stddev_ppm", "misalignment_stddev_arcsec")}
    write_bag(simulate("vehicle", 6, duration=150.0, rate=50.0, stand_time=24.0, **ideal), path)
    return path


def _series(path: Path, topic: str) -> dict[int, Any]:
    with BagReader(path) as reader:
        return {stamp_of(m): m for m in map(reader.deserialize, reader.messages([topic]))}


def _v(v: Any) -> np.ndarray:
    return np.array([v.x, v.y, v.z])


def _r(q: Any) -> Rotation:
    return Rotation.from_quat([q.x, q.y, q.z, q.w])


def test_covariances_of_the_messages(bag: Path, tmp_path: Path) -> None:
    """Each on the axes of its message: the errors of the fields, normalized by the covariance beside them."""
    out = tmp_path / "out"
    assert main([str(bag), "-o", str(out), "--param", "alignment.duration:=20", *BOTH]) == 0
    odometry, imu, fix = (_series(out, t) for t in ("odometry", "imu/data", "fix"))
    true_odometry, true_fix = (_series(bag, t) for t in ("truth/odometry", "truth/fix"))
    begin = min(odometry)
    squares: dict[str, list[float]] = {name: [] for name in ("position", "attitude", "twist", "fix")}
    for stamp in sorted(odometry.keys() & true_odometry.keys()):
        if stamp < begin + 10 * NS or stamp % NS:
            continue
        o, t, f, tf, i = odometry[stamp], true_odometry[stamp], fix[stamp], true_fix[stamp], imu[stamp]
        pose, twist = (np.reshape(x.covariance, (6, 6)) for x in (o.pose, o.twist))
        assert np.linalg.eigvalsh(pose)[0] > 0.0 and (twist.diagonal() >= 0.0).all()
        errors = {
            "position": (_v(o.pose.pose.position) - _v(t.pose.pose.position), pose[:3, :3]),
            "attitude": ((_r(o.pose.pose.orientation) * _r(t.pose.pose.orientation).inv()).as_rotvec(), pose[3:, 3:]),
            "twist": ((_v(o.twist.twist.linear) - _v(t.twist.twist.linear))[:2], twist[:2, :2]),
        }
        north = math.radians(f.latitude - tf.latitude) * 6.39e6
        east = math.radians(f.longitude - tf.longitude) * 6.39e6 * math.cos(math.radians(tf.latitude))
        place = np.reshape(f.position_covariance, (3, 3))
        assert f.position_covariance_type == 3
        errors["fix"] = (np.array([east, north, f.altitude - tf.altitude]), place)
        for name, (error, covariance) in errors.items():
            squares[name].append(float(error @ np.linalg.solve(covariance, error)) / len(error))
        # one tangent plane within some 100 m: map and east-north-up are alike
        np.testing.assert_allclose(place, pose[:3, :3], rtol=1e-3, atol=1e-3)
        # meridians converge by 2e-5 rad on the way, which turns as much of heading's variance, 1e-4, into others
        np.testing.assert_allclose(np.reshape(i.orientation_covariance, (3, 3)), pose[3:, 3:], rtol=0.01, atol=2e-9)
        assert np.diag(np.reshape(i.angular_velocity_covariance, (3, 3))).min() > 0.0
        assert np.diag(np.reshape(i.linear_acceleration_covariance, (3, 3))).min() > 0.0
    # one run, whose errors are alike for 10 s; the solution has gone on for some 3 s since its covariance
    for values in squares.values():
        assert 0.05 < np.mean(values) < 2.5, {name: np.mean(v) for name, v in squares.items()}
    diagnostics = list(_series(out, "diagnostics").values())[-1]
    assert [status.name for status in diagnostics.status] == ["ins_process: navigation", "ins_process: alignment"]
    values = {item.key: item.value for item in diagnostics.status[1].values}
    assert {"phase", "position sigma", "heading sigma", "time left by prediction"} <= values.keys()
    assert {"gnss: accepted, rejected", "gnss: innovation", "gnss: test ratio", "gnss: last accepted"} <= values.keys()
    assert "±" in values["gnss: innovation"] and values["phase"] == "fine"


def _filled(state: nav_state.NavState, covariance: np.ndarray, origin: nav_state.MapFrame) -> SolutionMessages:
    ins = Ins({"navigation.vertical_channel": True})
    ins.map, ins.changes = origin, 1
    ins.accuracy.begin(0, state, covariance, (0.0, 0.0))
    out = SolutionMessages(ins)
    assert out.due(0)
    out.fill(Entries(np.zeros(1, dtype=np.int64), np.zeros((1, 7)), np.array([state])))
    return out


def test_frames_of_the_covariances_far_from_the_origin() -> None:
    """1000 km off, n turned by 40° and the body by 70° against it: each variance is where its error is large."""
    origin = nav_state.MapFrame(math.radians(60.0), math.radians(10.0), 0.0)
    here = nav_state.initial_state(
        math.radians(62.0), math.radians(30.0), 0.0, (10.0, 0.0, 0.0),
        (0.0, 0.0, math.sin(math.radians(35.0)), math.cos(math.radians(35.0))),
    )  # fmt: skip
    half = math.radians(20.0)
    q_en = (Rotation.from_quat(here[7:11]) * Rotation.from_quat([0.0, 0.0, math.sin(half), math.cos(half)])).as_quat()
    state = (*here[:7], *map(float, q_en), 0.0)
    assert azimuth(state) == pytest.approx((math.cos(2.0 * half), math.sin(2.0 * half)))
    along = np.zeros((15, 15))
    for k in (0, 3, 6):
        along[k : k + 3, k : k + 3] = np.diag([1e-2, 1e-4, 4e-4])  # all along the first axis of n
    out = _filled(state, along, origin)
    direction_g = Rotation.from_euler("Z", 40.0, degrees=True).apply([1.0, 0.0, 0.0])
    direction_b = Rotation.from_quat(state[0:4]).inv().apply([1.0, 0.0, 0.0])
    odometry, imu, fix = map(decoded, (out.odometry, out.imu, out.fix))
    pose, twist = (np.reshape(x.covariance, (6, 6)) for x in (odometry.pose, odometry.twist))
    for matrix, direction in (
        (np.reshape(fix.position_covariance, (3, 3)), direction_g),
        (np.reshape(imu.orientation_covariance, (3, 3)), direction_g),
        (twist[:3, :3], direction_b),
    ):
        assert direction @ matrix @ direction == pytest.approx(1e-2)
        assert np.trace(matrix) == pytest.approx(1.05e-2)
    # in the map: a step along the first axis of n, applied there
    step = 100.0
    moved = nav_state.corrected(state, (step, 0.0, 0.0))
    direction_m = np.subtract(origin.position(moved), origin.position(state)) / step
    assert direction_m @ pose[:3, :3] @ direction_m == pytest.approx(1e-2, abs=1e-6)
    assert direction_m @ pose[3:, 3:] @ direction_m == pytest.approx(1e-2, abs=1e-6)


@pytest.mark.slow
def test_no_change_is_missed_at_a_low_rate(bag: Path, tmp_path: Path) -> None:
    """Covariances and biases go out with the next solution, whichever sample brought the change."""
    out = tmp_path / "out"
    few = ("--param", "alignment.duration:=20", "--param", "publish.rate:=0.7")
    assert main([str(bag), "-o", str(out), *few, *BOTH]) == 0
    odometry = list(_series(out, "odometry").values())
    variances = {o.pose.covariance[0] for o in odometry[3:]}
    assert len(variances) == len(odometry) - 3
    with BagReader(out) as reader:
        # nothing is found in the first 4.4 s: until it is settled, and has had its time to arrive
        assert reader.topics["/imu/bias"].count >= len(odometry) - 3
