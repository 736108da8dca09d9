"""The state file from one start to the next: biases, calibrations of aids, the last pose.

A ROS 2 parameter file: people can read and edit it, a node accepts it directly. Biases are initial values with the
sigmas of the parameters, since a unit's bias changes from one start to the next; the mounting of the log does not
change, and its sigma is that of the calibration.
"""

import math
import os
from collections.abc import Collection, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import yaml

from ins_nav.config.configuration import Configuration
from ins_nav.config.parameters import Value, read_file
from ins_nav.errors import InsNavError
from ins_nav.event_log import INFO, WARN, EventLog

_BIASES = ("imu.gyro_bias_deg_per_hour", "imu.accel_bias_mg")
_POSE = ("latitude_deg", "longitude_deg", "height", "heading_deg", "position_stddev", "stamp")
_LAST = "last_pose"


class StateFileError(InsNavError):
    """The file cannot be written, or is invalid; the text names the reason."""


class Pose(NamedTuple):
    """Position and heading at the end."""

    latitude_deg: float
    longitude_deg: float
    height: float
    """Ellipsoidal, m."""
    heading_deg: float
    position_stddev: float
    """Horizontal, each axis, m."""
    stamp: float
    """s."""


def save(path: str | Path, parameters: Mapping[str, Value], pose: Pose) -> None:
    """Write the file; an existing one is replaced atomically.

    Parameters
    ----------
    path : str or Path
    parameters : mapping
        `_BIASES`, and calibrations of aids.
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


def read_state(
    configuration: Configuration, events: EventLog, names: Collection[str]
) -> tuple[Configuration, dict[str, Value], Pose | None]:
    """The configuration with the values in ``state_file``, those of calibrations, and the last pose, if there is one.

    A file that does not exist yet, or is damaged, is reported and not used: a vehicle must start without it.

    Parameters
    ----------
    configuration : Configuration
    events : EventLog
    names : collection of str
        Parameters that are calibrations.
    """
    name = configuration.state_file.path
    path = Path(name).expanduser()
    if not name:
        return configuration, {}, None
    if not path.exists():
        events.report(INFO, f"state_file {path} does not exist yet: ins_node/save writes it")
        return configuration, {}, None
    try:
        saved, pose = load(path, configuration, names)
    except StateFileError as error:
        events.report(WARN, f"{error}: the file is not used; save again, or remove it")
        return configuration, {}, None
    events.report(INFO, f"state_file {path}: {', '.join(saved)} read, saved {_date(pose)}")
    calibration = {name: value for name, value in saved.items() if name in names}
    return configuration.updated(saved), calibration, pose


def _date(pose: Pose) -> str:
    return datetime.fromtimestamp(pose.stamp, UTC).isoformat(timespec="seconds")


def load(path: str | Path, configuration: Configuration, names: Collection[str]) -> tuple[dict[str, Value], Pose]:
    """Parameters that replace others, biases and those of ``names``, and the last pose.

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
    other = content.keys() - {*_BIASES, *names}
    if other:
        raise StateFileError(f"state_file {path}: {min(other)} does not belong in such a file")
    if not all(map(math.isfinite, pose)) or abs(pose.latitude_deg) > 90.0:
        raise StateFileError(f"state_file {path}: {_LAST} has an invalid value")
    return {name: checked[name] for name in content}, pose
