"""Corrections, solutions, calibrations and ZUPT calls between `ins_node` and `alignment_node` as messages, and back.

A correction is one message, so that no part of it can be lost alone. Its covariance relates position, velocity,
attitude and biases to each other: nav_msgs/Odometry and sensor_msgs/Imu have no place for that, nor for the further
errors of the IMU. Hence a record of named numbers (`ins_nav.messages.named_numbers`).

Every message is checked here, before it has an effect: form, finite numbers, unit quaternions, magnitudes that a
vehicle and an IMU can have, and the covariance. `ins_nav.navigator.correction.CorrectionQueue` decides whether the
stamp fits the samples.
"""

import math
from collections.abc import Collection, Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ins_nav.config.configuration import Configuration
from ins_nav.config.parameters import Value
from ins_nav.errors import InsNavError
from ins_nav.estimation.state_layout import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, POSITION, SOLUTION_SIZE, VELOCITY
from ins_nav.mechanization.nav_state import NavState
from ins_nav.mechanization.stamped_rows import LENGTH_NS
from ins_nav.messages.named_numbers import Fields, NamedNumbers, RejectedMessageError, element, pack, unpack
from ins_nav.navigator.correction import Correction
from ins_nav.stamps import NS

_CORRECTION, _SOLUTION, _CALIBRATION = "correction 1", "solution 1", "calibration 1"
"""Records with the version of their fields."""
_STATE = {"q_nb": slice(0, 4), "velocity": slice(4, 7), "q_en": slice(7, 11), "height": slice(11, 12)}
"""Parts of `NavState`."""
_UNIT = 1e-6
"""Of a unit quaternion's length: ten times what single precision leaves."""
_HEIGHTS = -12e3, 1e6
"""m, ellipsoidal: from the deepest trench to the range of `initial.height`."""
_MAGNITUDES = {"velocity": 1e4, "gyro_bias": 100.0, "accel_bias": 1e3, "imu_errors": 1.0}
"""m/s, rad/s, m/s², and a share of the reading: more than any vehicle has and any IMU measures."""
_LARGEST_SIGMAS = ((POSITION, 2e7), (VELOCITY, 1e4), (ATTITUDE, 2.0 * math.pi), (GYRO_BIAS, 100.0), (ACCEL_BIAS, 1e3))
"""m: half the Earth's circumference, m/s, rad, rad/s, m/s²."""
_SYMMETRIC, _SEMI_DEFINITE = 1e-9, 1e-6
"""Of correlations, where rounding leaves 1e-15."""


def pack_correction(correction: Correction) -> NamedNumbers:
    """A correction for ``ins/feedback``."""
    return pack(_CORRECTION, _fields(correction, "apply", correction.apply_ns))


def read_correction(message: Any) -> Correction:
    """The correction in a message of ``ins/feedback``.

    Raises
    ------
    RejectedMessageError
    """
    correction, apply_ns = _read(unpack(message, _CORRECTION), "apply")
    if not 0 <= apply_ns - correction.stamp_ns <= LENGTH_NS:
        after = (apply_ns - correction.stamp_ns) * 1e-9
        raise RejectedMessageError(f"apply is {after:.1f} s after stamp, not 0 to {LENGTH_NS / NS:.0f} s")
    return correction._replace(apply_ns=apply_ns)


def pack_solution(solution: Correction, aligned_ns: int) -> NamedNumbers:
    """The present solution for ``ins/solution``, and the stamp at which alignment ended."""
    return pack(_SOLUTION, _fields(solution, "alignment_end", aligned_ns))


def read_solution(message: Any) -> tuple[Correction, int]:
    """The solution in a message of ``ins/solution``, and the stamp at which its alignment ended.

    Raises
    ------
    RejectedMessageError
    """
    solution, aligned_ns = _read(unpack(message, _SOLUTION), "alignment_end")
    if aligned_ns > solution.stamp_ns:
        after = (aligned_ns - solution.stamp_ns) * 1e-9
        raise RejectedMessageError(f"alignment_end is {after:.1f} s after stamp, not before it")
    return solution, aligned_ns


def pack_calibration(found: Mapping[str, Value]) -> NamedNumbers:
    """Calibrated parameters, each a number, for ``ins/calibration``; the fields are the parameters' names."""
    return pack(_CALIBRATION, {name: (cast(float, value),) for name, value in found.items()})


def read_calibration(message: Any, configuration: Configuration, names: Collection[str]) -> dict[str, Value]:
    """Calibrated parameters in a message of ``ins/calibration``, checked by their ranges.

    Parameters
    ----------
    message : message
    configuration : Configuration
    names : collection of str
        Parameters that are calibrations.

    Raises
    ------
    RejectedMessageError
    """
    found = unpack(message, _CALIBRATION)
    for name, values in found.items():
        if name not in names or len(values) != 1:
            raise RejectedMessageError(f"{name} is not the name of a calibration of one number")
    try:
        checked = configuration.updated({name: values[0] for name, values in found.items()}).values
    except InsNavError as error:
        raise RejectedMessageError(str(error)) from None
    return {name: checked[name] for name in found}


def read_zupt(message: Any, stamp_ns: int) -> int:
    """Stamp, ns, of the sample at which a ZUPT service was called, in a std_msgs/Header of ``ins/zupt``.

    Parameters
    ----------
    message : message
    stamp_ns : int
        Of the newest sample here.

    Raises
    ------
    RejectedMessageError
        The two are further apart than any queue of samples is long.
    """
    zupt_ns: int = message.stamp.sec * NS + message.stamp.nanosec
    if abs(zupt_ns - stamp_ns) > LENGTH_NS:
        after = (zupt_ns - stamp_ns) * 1e-9
        text = f"stamp is {after:.1f} s after the newest of imu/data_raw, not within {LENGTH_NS / NS:.0f} s of it"
        raise RejectedMessageError(text)
    return zupt_ns


def _fields(correction: Correction, other: str, other_ns: int) -> dict[str, tuple[float, ...]]:
    errors = correction.imu_errors or (0.0,) * (len(correction.covariance) - SOLUTION_SIZE)
    return {
        **_stamp("stamp", correction.stamp_ns),
        **_stamp(other, other_ns),
        **{name: tuple(correction.state)[part] for name, part in _STATE.items()},
        "gyro_bias": correction.gyro_bias,
        "accel_bias": correction.accel_bias,
        "fine_alignment_done": (float(correction.aligned),),
        "imu_errors": errors,
        "covariance": tuple(correction.covariance.ravel().tolist()),
    }


def _stamp(name: str, stamp_ns: int) -> dict[str, tuple[float, ...]]:
    """Seconds and ns apart: both are exact in floating point."""
    sec, nanosec = divmod(stamp_ns, NS)
    return {f"{name}_sec": (float(sec),), f"{name}_nanosec": (float(nanosec),)}


def _read(fields: Fields, other: str) -> tuple[Correction, int]:
    """A correction that takes effect at once, and the stamp of the other name."""
    size = SOLUTION_SIZE + len(fields.get("imu_errors", ()))
    expected = {
        **{f"{name}_{unit}": 1 for name in ("stamp", other) for unit in ("sec", "nanosec")},
        **{name: part.stop - part.start for name, part in _STATE.items()},
        **{"gyro_bias": 3, "accel_bias": 3, "fine_alignment_done": 1, "imu_errors": size - SOLUTION_SIZE},
        "covariance": size**2,
    }
    for name in (*expected, *fields):
        count, wanted = len(fields.get(name, ())), expected.get(name, 0)
        if count != wanted or name not in fields:
            raise RejectedMessageError(f"{name} has {count} numbers, not {wanted}: do all nodes have one version?")
    _check_magnitudes(fields)
    covariance = np.array(fields["covariance"]).reshape(size, size)
    _check_covariance(covariance)
    stamp_ns, other_ns = _read_stamp(fields, "stamp"), _read_stamp(fields, other)
    correction = Correction(
        stamp_ns,
        stamp_ns,
        NavState(*fields["q_nb"], *fields["velocity"], *fields["q_en"], *fields["height"]),
        fields["gyro_bias"],  # type: ignore[arg-type]
        fields["accel_bias"],  # type: ignore[arg-type]
        covariance,
        fields["fine_alignment_done"][0] == 1.0,
        fields["imu_errors"],
    )
    return correction, other_ns


def _read_stamp(fields: Fields, name: str) -> int:
    """ns; of 32 bits each, as in builtin_interfaces/Time."""
    for unit, limit in (("sec", 2**31), ("nanosec", NS)):
        value = fields[f"{name}_{unit}"][0]
        if not (0.0 <= value < limit and value.is_integer()):
            raise RejectedMessageError(f"{name}_{unit} is {value:g}, not a whole number from 0 to {limit - 1}")
    return int(fields[f"{name}_sec"][0]) * NS + int(fields[f"{name}_nanosec"][0])


def _check_magnitudes(fields: Fields) -> None:
    for name, limit in _MAGNITUDES.items():
        for i, value in enumerate(fields[name]):
            if abs(value) > limit:
                raise RejectedMessageError(f"{element(name, i, fields[name])} is {value:g}, more than {limit:g}")
    for name in ("q_nb", "q_en"):
        length = math.hypot(*fields[name])
        if abs(length - 1.0) > _UNIT:
            raise RejectedMessageError(f"{name} has the length {length:.6g}, not 1")
    height = fields["height"][0]
    if not _HEIGHTS[0] <= height <= _HEIGHTS[1]:
        raise RejectedMessageError(f"height is {height:g}, not {_HEIGHTS[0]:g} to {_HEIGHTS[1]:g} m")
    done = fields["fine_alignment_done"][0]
    if done not in (0.0, 1.0):
        raise RejectedMessageError(f"fine_alignment_done is {done:g}, not 0 or 1")


def _check_covariance(covariance: NDArray[np.float64]) -> None:
    """Symmetric, positive semi-definite, and of sigmas that are plausible."""
    variance = covariance.diagonal()
    limits = np.ones(len(variance))
    for block, limit in _LARGEST_SIGMAS:
        limits[block] = limit
    for i in np.flatnonzero((variance < 0.0) | (variance > limits**2)):
        raise RejectedMessageError(f"covariance[{i}, {i}] is {variance[i]:g}, not 0 to {limits[i] ** 2:g}")
    sigma = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    scale = np.outer(sigma, sigma)
    for i, j in np.argwhere(np.abs(covariance) > (1.0 + _SEMI_DEFINITE) * scale):  # before a division can overflow
        raise RejectedMessageError(f"covariance[{i}, {j}] is {covariance[i, j]:g}, more than its variances allow")
    correlation = covariance / scale
    for i, j in np.argwhere(np.abs(correlation - correlation.T) > _SYMMETRIC):
        raise RejectedMessageError(
            f"covariance[{i}, {j}] is {covariance[i, j]:g}, covariance[{j}, {i}] {covariance[j, i]:g}: not symmetric"
        )
    least = float(np.linalg.eigvalsh(correlation)[0])
    if least < -_SEMI_DEFINITE:
        raise RejectedMessageError(f"covariance has an eigenvalue of {least:.2g} as correlation: not positive")
