"""Reports: known offsets must come out as errors, in tables and figures, and bad input as one line."""

import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ins_nav.cli.report import main
from ins_nav.mechanization.earth import principal_radii
from ins_nav.recordings.bags import BagWriter, header, message
from ins_nav.report import figures
from ins_nav.report.comparison import compare
from ins_nav.report.series import ReportError, read_reference, read_result
from ins_nav.report.table import rows_of, table

START_NS = 1_700_000_000 * 10**9
LAT, LON, HEIGHT = np.radians(55.0), np.pi, 100.0  # where longitude jumps
SPEED = 12.0
TURN = np.radians(3.0)  # rad/s
TRUTH = ("truth/fix", "truth/imu", "truth/odometry")
RESULT = ("fix", "imu/data", "odometry")
RESULT_SIGMAS = {"enu": (1.0, 2.0, 3.0), "turn": (1e-4, 2e-4, 3e-4)}


def write(
    path: Path,
    topics: tuple[str, str, str],
    times: np.ndarray,
    offset=(0.0, 0.0, 0.0),
    turned=(0.0, 0.0, 0.0),
    faster=(0.0, 0.0, 0.0),
    heading_deg=350.0,
    turn=TURN,
    sigmas=None,
) -> Path:
    """A bag of a body that goes east at constant speed and turns left at a constant rate, its nose 2° down.

    Errors: offset east, north, up in m; turned roll, pitch, heading in deg; faster east, north, up in m/s.
    """
    fix_topic, imu_topic, velocity_topic = topics
    sigmas = sigmas or {"enu": (0.0,) * 3, "turn": (0.0,) * 3}
    meridian, prime_vertical = principal_radii(np.sin(LAT))
    with BagWriter(path) as bag:
        for time in times:
            stamp = START_NS + round(time * 1e9)
            east, north, up = SPEED * time + offset[0], offset[1], offset[2]
            fix = message("sensor_msgs/msg/NavSatFix", header=header(stamp, "base_link"))
            fix.latitude = np.degrees(LAT + north / (meridian + HEIGHT))
            lon = LON + east / ((prime_vertical + HEIGHT) * np.cos(LAT))
            fix.longitude = np.degrees((lon + np.pi) % (2.0 * np.pi) - np.pi)
            fix.altitude = HEIGHT + up
            fix.position_covariance[:] = np.diag(np.square(sigmas["enu"])).ravel()
            fix.position_covariance_type = 2
            bag.write(fix_topic, "sensor_msgs/msg/NavSatFix", fix, stamp)

            heading = heading_deg - np.degrees(turn) * time
            body = Rotation.from_euler("ZYX", [90.0 - heading - turned[2], 2.0 + turned[1], turned[0]], degrees=True)
            imu = message("sensor_msgs/msg/Imu", header=header(stamp, "base_link"))
            imu.orientation.x, imu.orientation.y, imu.orientation.z, imu.orientation.w = body.as_quat()
            imu.orientation_covariance[:] = np.diag(np.square(sigmas["turn"])).ravel()
            bag.write(imu_topic, "sensor_msgs/msg/Imu", imu, stamp)

            velocity = np.array([SPEED, 0.0, 0.0]) + faster
            msgtype = "geometry_msgs/msg/TwistWithCovarianceStamped"
            if "odometry" in velocity_topic:
                velocity, msgtype = body.inv().apply(velocity), "nav_msgs/msg/Odometry"
            twist = message(msgtype, header=header(stamp, "map"))
            linear = twist.twist.twist.linear
            linear.x, linear.y, linear.z = velocity
            bag.write(velocity_topic, msgtype, twist, stamp)
    return path


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> Path:
    """Truth at 4 Hz between the stamps of a result at 10 Hz that is off by known amounts from 10 s on."""
    folder = tmp_path_factory.mktemp("bags")
    write(folder / "truth", TRUTH, np.arange(0.03, 100.0, 0.25))
    write(
        folder / "result",
        RESULT,
        np.arange(10.0, 90.0, 0.1),
        offset=(3.0, -4.0, 2.0),
        turned=(0.1, -0.2, 0.5),
        faster=(0.3, 0.4, -0.5),
        sigmas=RESULT_SIGMAS,
    )
    write(folder / "plain", RESULT, np.arange(20.0, 60.0, 0.1))
    return folder


@pytest.fixture(scope="module")
def off(bags):
    result, reference = read_result(bags / "result", "result"), read_reference(bags / "truth")
    return result, reference, compare(result, reference)


def test_known_offsets_are_the_errors(off):
    _, _, errors = off
    assert errors.position.stamps_ns[0] == START_NS + 10_030_000_000
    assert len(errors.position.stamps_ns) == 320
    # 1 mm: radii of curvature were taken at one latitude only
    np.testing.assert_allclose(errors.position.values, np.tile([3.0, -4.0, 2.0], (320, 1)), atol=1e-3)
    # a turn at a constant rate is just what spherical interpolation gives: rounding is left, also across north
    np.testing.assert_allclose(np.degrees(errors.attitude.values), np.tile([0.1, -0.2, 0.5], (320, 1)), atol=1e-9)
    # between samples the velocity is interpolated after its rotation, so rounding only
    np.testing.assert_allclose(errors.velocity.values, np.tile([0.3, 0.4, -0.5], (320, 1)), atol=1e-9)


def test_sigmas_of_the_result_come_along(off, bags):
    _, _, errors = off
    np.testing.assert_allclose(errors.position.stddev, np.tile(RESULT_SIGMAS["enu"], (320, 1)), rtol=1e-12)
    plain = compare(read_result(bags / "plain", "plain"), read_reference(bags / "truth"))
    assert np.isnan(plain.position.stddev).all()
    assert np.isnan(plain.attitude.stddev).all()


@pytest.mark.parametrize(("heading_deg", "roll", "pitch"), [(90.0, 1e-4, 2e-4), (0.0, 2e-4, 1e-4), (270.0, 1e-4, 2e-4)])
def test_sigmas_of_roll_and_pitch_turn_with_the_heading(tmp_path, heading_deg, roll, pitch):
    bag = write(
        tmp_path / "bag", RESULT, np.arange(0.0, 1.0, 0.1), heading_deg=heading_deg, turn=0.0, sigmas=RESULT_SIGMAS
    )
    sigma = read_result(bag, "bag").attitude.stddev
    # the nose is 2° down: roll grows by 1 / cos 2°, the heading takes tan 2° of the roll
    expected = [roll / np.cos(np.radians(2.0)), pitch, np.hypot(3e-4, np.tan(np.radians(2.0)) * roll)]
    np.testing.assert_allclose(sigma, np.tile(expected, (10, 1)), rtol=1e-9)


def test_nothing_is_interpolated_across_a_gap(tmp_path, bags):
    times = np.concatenate([np.arange(20.0, 30.0, 0.1), np.arange(40.0, 50.0, 0.1)])
    result = read_result(write(tmp_path / "gap", RESULT, times), "gap")
    stamps = compare(result, read_reference(bags / "truth")).position.stamps_ns
    seconds = (stamps - START_NS) * 1e-9
    assert not ((seconds > 29.91) & (seconds < 40.0)).any()
    assert seconds.max() > 49.0


def test_a_reference_is_found_by_name(tmp_path, bags):
    both = tmp_path / "both"
    write(both, ("reference/fix", "reference/imu", "reference/velocity"), np.arange(0.0, 50.0, 1.0))
    reference = read_reference(both)
    assert reference.name == "/reference/fix"
    errors = compare(read_result(bags / "result", "result"), reference)
    np.testing.assert_allclose(errors.velocity.values[:, :2], np.tile([0.3, 0.4], (40, 1)), atol=1e-9)
    # another result as the reference: its own topics
    other = read_reference(bags / "plain", "fix")
    errors = compare(read_result(bags / "result", "result"), other)
    np.testing.assert_allclose(np.degrees(errors.attitude.values[:, 2]), 0.5, atol=1e-9)
    assert read_reference(bags / "plain") is None


def test_positions_alone_will_do(tmp_path, bags):
    path = tmp_path / "gnss"
    write(path, ("gnss/fix", "other/imu", "other/velocity"), np.arange(0.0, 50.0, 1.0))
    reference = read_reference(path)
    errors = compare(read_result(bags / "result", "result"), reference)
    assert errors.attitude is None
    assert errors.velocity is None
    assert errors.position.values[:, 0].mean() == pytest.approx(3.0, abs=1e-3)


def test_table_shows_the_errors(off):
    result, _, errors = off
    rows = rows_of(result, errors)
    assert rows["heading error after alignment, deg"] == "+0.5000 (sigma 0.0172)"
    assert rows["horizontal / vertical error after 1 min, m"] == "5.00 / 2.00"
    assert "horizontal / vertical error after 2 min, m" not in rows
    assert rows["horizontal / vertical error RMS, m"] == "5.00 / 2.00"
    assert rows["velocity error RMS, horizontal / up, m/s"] == "0.500 / 0.500"
    assert rows["heading drift to the end, deg"].strip("+-") == "0.0000"
    assert rows["solutions"] == "800"


def test_columns_of_different_length_keep_their_order():
    text = table({"short": {"a": "1", "z": "2"}, "long": {"a": "3", "m": "4", "z": "5"}})
    assert [line.split() for line in text.splitlines()] == [
        ["short", "long"],
        ["a", "1", "3"],
        ["m", "-", "4"],
        ["z", "2", "5"],
    ]


def png_size(path: Path) -> tuple[int, ...]:
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG\r\n")
    return struct.unpack(">II", content[16:24])


def test_command_makes_figure_and_table(bags, tmp_path, capsys):
    picture = tmp_path / "picture.png"
    arguments = [bags / "result", bags / "plain", "--reference", bags / "truth", "-o", picture, "--table"]
    assert main(list(map(str, arguments))) == 0
    said = capsys.readouterr().out
    assert "against /truth/fix" in said
    assert "+0.5000 (sigma" in said
    assert said.endswith(f"{picture}\n")
    assert png_size(picture) == (1600, 1000)


def test_command_without_a_reference(bags, tmp_path, capsys):
    picture = tmp_path / "picture.png"
    assert main([str(bags / "result"), "-o", str(picture)]) == 0
    assert capsys.readouterr().out == f"{picture}\n"
    assert png_size(picture) == (1600, 1000)


def test_heading_curve_does_not_jump_at_north(off):
    result, reference, errors = off
    (heading,) = [
        axes for axes in figures.figure([result], reference, [errors]).axes if axes.get_title("left") == "heading, deg"
    ]
    for line in heading.get_lines():
        values = line.get_ydata()
        assert np.isfinite(values).all()
        assert np.abs(np.diff(values)).max() < 10.0
    assert heading.yaxis.get_major_formatter()(-45.0, 0) == "315"


def test_damaged_bag_is_read_as_far_as_it_goes(bags, tmp_path, capsys):
    content = next((bags / "result").glob("*.mcap")).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[: len(content) // 2])
    assert main([str(cut), "--reference", str(bags / "truth")]) == 0
    said = capsys.readouterr()
    assert "is damaged" in said.err
    assert "+0.5000 (sigma" in said.out


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["truth"], "truth: is not a result bag, it has no /fix; topics: /truth/fix,"),
        (["reslt"], "no such bag (did you mean"),
        (["result", "result"], "the same bag is given twice"),
        (["result", "--reference", "plain"], "plain: has none of truth/fix, reference/fix, gnss/fix"),
        (["result", "--reference", "truth", "--reference-topic", "truth/fx"], "(did you mean /truth/fix?)"),
        (["result", "--reference", "truth", "--reference-topic", "truth/imu"], "/truth/imu is of type sensor_msgs"),
        (["result", "--reference", "early"], "no time in common with /truth/fix"),
        (["result", "-o", "picture.xyz"], "cannot write the figure"),
        (["result", "-o", "no/such/folder.png"], "cannot write the figure: No such file or directory"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(bags, capsys, monkeypatch, arguments, complaint):
    monkeypatch.chdir(bags)
    if "early" in arguments and not Path("early").exists():
        write(Path("early"), TRUTH, np.arange(0.0, 5.0, 0.5))
    assert main(arguments) == 1
    said = capsys.readouterr().err
    assert said.startswith("ins_report: ")
    assert complaint in said
    assert said.count("\n") == 1


def test_a_lone_position_is_no_result(tmp_path):
    with pytest.raises(ReportError, match="fewer than 2 valid positions"):
        read_result(write(tmp_path / "lone", RESULT, np.array([1.0])), "lone")
