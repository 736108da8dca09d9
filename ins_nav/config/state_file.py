"""What is kept from one start to the next: biases, the log's calibration, the last pose.

A file of ROS 2 parameters, so that it can be read, edited, and given to a node as it is. Biases are taken up as first
values with the uncertainty that the parameters name, for a unit's bias changes from one start to the next; how the log
is mounted does not, and its uncertainty is that of the calibration.
"""

import math
import os
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import yaml

from ins_nav.config.configuration import Configuration
from ins_nav.config.parameters import Value, read_file
from ins_nav.errors import InsNavError
from ins_nav.event_log import INFO, WARN, EventLog

_BIASES = ("imu.gyro_bias_deg_per_hour", "imu.accel_bias_mg")
_LOG = ("log.scale", "log.scale_stddev", "log.pitch_deg", "log.yaw_deg", "log.misalignment_stddev_deg")
_POSE = ("latitude_deg", "longitude_deg", "height", "heading_deg", "position_stddev", "stamp")
_LAST = "last_pose"


class StateFileError(InsNavError):
    """The file cannot be written, or is none; the text says why."""


class Pose(NamedTuple):
    """Where it was."""

    latitude_deg: float
    longitude_deg: float
    height: float
    """Ellipsoidal, m."""
    heading_deg: float
    position_stddev: float
    """Horizontal, each axis, m."""
    stamp: float
    """s."""


def log_calibration(values: Sequence[tuple[float, float]]) -> dict[str, Value]:
    """The log's own states, value and sigma each (`measurements.Log`), as parameters; none where none."""
    if not values:
        return {}
    (scale, scale_stddev), (pitch, pitch_stddev), (yaw, yaw_stddev) = values[:3]
    found = scale, scale_stddev, math.degrees(pitch), math.degrees(yaw), math.degrees(max(pitch_stddev, yaw_stddev))
    return dict(zip(_LOG, found, strict=True))


def read_calibration(
    labels: Sequence[str], numbers: Sequence[float], configuration: Configuration
) -> dict[str, Value] | None:
    """The log's parameters by name from a message; None where they are not."""
    if tuple(labels) != _LOG or len(numbers) != len(_LOG):
        return None
    try:
        values = configuration.updated(dict(zip(labels, numbers, strict=True))).values
    except InsNavError:
        return None
    return {name: values[name] for name in _LOG}


def save(path: str | Path, parameters: Mapping[str, Value], pose: Pose) -> None:
    """Write the file; one that is there is replaced at once and whole, or not at all.

    Parameters
    ----------
    path : str or Path
    parameters : mapping
        `_BIASES`, and of the log's what is known.
    pose : Pose

    Raises
    ------
    StateFileError
    """
    tree: dict[str, dict[str, Value]] = {}
    for name, value in parameters.items():
        group, _, key = name.partition(".")
        tree.setdefault(group, {})[key] = value
    tree[_LAST] = dict(pose._asdict())
    text = yaml.safe_dump({"/**": {"ros__parameters": tree}}, sort_keys=False)
    target = Path(path).expanduser()
    part = target.parent / f"{target.name}.part"
    try:
        with part.open("w", encoding="utf-8") as file:
            file.write(f"# Saved by ins_nav at {_date(pose)}, by the stamps of its IMU.\n{text}")
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, target)
    except OSError as error:
        raise StateFileError(f"state_file {path}: {error.strerror}") from None


def take_up(configuration: Configuration, events: EventLog) -> tuple[Configuration, dict[str, Value], Pose | None]:
    """The configuration with the values in ``state_file``, these values, and the last pose, if there is one.

    A file that does not exist yet, or is damaged, is reported and not used: a vehicle must start without it.
    """
    name = configuration.state_file.path
    path = Path(name).expanduser()
    if not name:
        return configuration, {}, None
    if not path.exists():
        events.report(INFO, f"state_file {path} is not there yet: ins_node/save writes it")
        return configuration, {}, None
    try:
        kept, pose = load(path, configuration)
    except StateFileError as error:
        events.report(WARN, f"{error}: nothing of it is used; save again, or remove it")
        return configuration, {}, None
    events.report(INFO, f"state_file {path}: {', '.join(kept)} taken up, as saved {_date(pose)}")
    return configuration.updated(kept), kept, pose


def _date(pose: Pose) -> str:
    return datetime.fromtimestamp(pose.stamp, UTC).isoformat(timespec="seconds")


def load(path: str | Path, configuration: Configuration) -> tuple[dict[str, Value], Pose]:
    """Parameters that take the place of others, and the last pose.

    Raises
    ------
    StateFileError
        There is no such file, it is damaged, or has other parameters.
    """
    try:
        content = read_file(path)
        pose = Pose(*(float(str(content.pop(f"{_LAST}.{key}"))) for key in _POSE))
        _date(pose)
        checked = configuration.updated(content).values
    except KeyError as error:
        raise StateFileError(f"state_file {path}: no {error.args[0]}") from None
    except (InsNavError, TypeError, ValueError, OverflowError) as error:
        raise StateFileError(f"state_file {path}: {error}") from None
    other = content.keys() - {*_BIASES, *_LOG}
    if other:
        raise StateFileError(f"state_file {path}: {min(other)} is not kept in such a file")
    if not all(map(math.isfinite, pose)) or abs(pose.latitude_deg) > 90.0:
        raise StateFileError(f"state_file {path}: {_LAST} has a value that is none")
    return {name: checked[name] for name in content}, pose
