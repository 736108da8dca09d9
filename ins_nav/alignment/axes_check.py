"""Signs, axes and unit of a standing IMU: its mean angular rate must be the Earth's, with the right part along gravity.

At rest the gyros measure the Earth's rate, and accelerometers the reaction to gravity. The component of the one along
the other is ``RATE sin(latitude)``, whatever the attitude. An inverted specific force changes its sign, as inverted
gyros do; swapped axes of one of the two change its value. Neither changes the two magnitudes.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ins_nav.alignment.gravity_cone import Blocks
from ins_nav.mechanization.earth import RATE

Array = NDArray[np.float64]

_SPANS = 12
"""Spans of the data whose mean rates give the error of the mean; Student's distribution has one freedom less."""
_SIGMAS = 6.0
"""A consistent IMU fails with a probability of 1e-4 (Student's distribution with 11 degrees of freedom)."""
_TOLERANCE = 0.2 * RATE
"""rad/s: gyros that measure the Earth's rate with a larger error are not tested, and smaller differences pass."""
_SWAPS = {"x and y": [1, 0, 2], "x and z": [2, 1, 0], "y and z": [0, 2, 1]}
_DOWN = -0.5
"""Vertical component of a unit vector that points down."""


def axes_fault(blocks: Blocks, lat: float, gyro_bias_stddev: float) -> str:
    """The reason why gyros and accelerometers cannot both be right; empty where they agree or gyros are too coarse.

    Parameters
    ----------
    blocks : Blocks
        Of a base at rest; the rates of a rocking one vary too much for the test.
    lat : float
        Geodetic latitude, rad.
    gyro_bias_stddev : float
        Sigma of each gyro's bias, rad/s.
    """
    rates, stddev = mean_rate(blocks)
    error = math.hypot(stddev, gyro_bias_stddev)
    up = blocks.force.mean(axis=0)
    up /= np.linalg.norm(up)
    expected = RATE * math.sin(lat)
    if _agrees(np.radians(rates), up, expected) and _SIGMAS * math.radians(error) < _TOLERANCE:
        return "angular_velocity is the Earth's rate in degrees per second, publish it in rad/s"
    if _SIGMAS * error > _TOLERANCE or abs(np.linalg.norm(rates) - RATE) > _TOLERANCE:
        return ""
    if _agrees(rates, up, expected):
        return ""
    text = (
        f"the rate about the vertical is {_per_hour(float(rates @ up)):.2f} °/h, the Earth's at latitude "
        f"{math.degrees(lat):.2f}° is {_per_hour(expected):.2f} °/h: "
    )
    if _agrees(-rates, up, expected):
        if up[2] < _DOWN:
            return (
                f"{text}linear_acceleration points down at rest and has the wrong sign: publish the reaction to "
                "gravity, +9.8 m/s² on the axis that points up (REP-145)"
            )
        return f"{text}angular_velocity or linear_acceleration has the wrong sign: publish both on the axes of REP-145"
    fitting = [axes for axes, order in _SWAPS.items() if _agrees(rates[order], up, expected)]
    swapped = f"are axes {fitting[0]} of one of the two swapped? " if len(fitting) == 1 else ""
    return (
        f"{text}angular_velocity and linear_acceleration are not on the same axes: {swapped}Check the driver; gyros "
        "with a bias of that size need imu.gyro_bias_stddev_deg_per_hour"
    )


def mean_rate(blocks: Blocks) -> tuple[Array, float]:
    """Mean angular rate on b0, rad/s, shape (3,), and the standard error of its worst axis."""
    count = len(blocks.time)
    ends = np.linspace(0, count - 1, min(_SPANS, count - 1) + 1).astype(int)
    attitudes = Rotation.from_quat(blocks.q_b0b[ends])
    turns = (attitudes[1:] * attitudes[:-1].inv()).as_rotvec()
    rates = turns / np.diff(blocks.time[ends])[:, None]
    return rates.mean(axis=0), float(rates.std(axis=0, ddof=1).max()) / math.sqrt(len(rates))


def _agrees(rates: Array, up: Array, expected: float) -> bool:
    """Whether rates are the Earth's in size, and along the vertical."""
    return abs(float(np.linalg.norm(rates)) - RATE) <= _TOLERANCE and abs(float(rates @ up) - expected) <= _TOLERANCE


def _per_hour(rate: float) -> float:
    return math.degrees(rate) * 3600.0
