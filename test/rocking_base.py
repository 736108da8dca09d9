"""IMU data of a base that rocks in place, in closed form: independent of `ins_nav.simulation`.

Heading stays; roll and pitch are sines of one period and amplitude, apart by a phase. Rates and forces of a sample are
means over its interval, by Gauss quadrature of four points.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ins_nav.mechanization.earth import normal_gravity

Array = NDArray[np.float64]

EARTH_RATE = 7.292115e-5
"""rad/s."""


class Rocking(NamedTuple):
    """A base that rocks.

    Attributes
    ----------
    amplitude : float
        Of roll and pitch, deg.
    period : float
        s.
    apart : float
        Phase of pitch less that of roll, rad.
    start : float
        Phase of roll at the first sample, in periods.
    """

    amplitude: float
    period: float = 5.0
    apart: float = 0.7
    start: float = 0.0


def rocking_base(
    rocking: Rocking, drift: Array, duration: float, rate: float, lat_deg: float = 60.0, heading_deg: float = 45.0
) -> Array:
    """Angular rate, rad/s, and specific force, m/s², on forward-left-up, shape (n, 6), at height 0.

    Parameters
    ----------
    rocking : Rocking
    drift : ndarray, shape (3,)
        Of the gyros, rad/s.
    duration : float
        s.
    rate : float
        Samples per second.
    lat_deg, heading_deg : float
    """
    lat, yaw = math.radians(lat_deg), math.radians(90.0 - heading_deg)
    amplitude, w = math.radians(rocking.amplitude), 2.0 * math.pi / rocking.period
    count = round(duration * rate)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    time = (np.arange(count)[:, None] + 0.5 + 0.5 * nodes) / rate
    phase = w * time.ravel() + 2.0 * math.pi * rocking.start
    roll, roll_rate = amplitude * np.sin(phase), amplitude * w * np.cos(phase)
    pitch, pitch_rate = amplitude * np.sin(phase + rocking.apart), amplitude * w * np.cos(phase + rocking.apart)
    to_body = Rotation.from_euler("ZYX", np.column_stack([np.full(roll.size, yaw), pitch, roll])).inv()
    of_base = np.column_stack([roll_rate, np.cos(roll) * pitch_rate, -np.sin(roll) * pitch_rate])
    of_earth = to_body.apply(EARTH_RATE * np.array([0.0, math.cos(lat), math.sin(lat)]))
    force = to_body.apply([0.0, 0.0, float(normal_gravity(math.sin(lat), 0.0))])
    values = np.column_stack([of_base + of_earth, force]).reshape(count, 4, 6)
    samples: Array = np.einsum("nkj,k->nj", values, 0.5 * weights)
    samples[:, :3] += drift
    return samples


def first_attitude(rocking: Rocking, rate: float, heading_deg: float = 45.0) -> tuple[float, float, float]:
    """Yaw, pitch and roll after the first sample of `rocking_base`, rad."""
    phase = 2.0 * math.pi * (1.0 / (rocking.period * rate) + rocking.start)
    amplitude = math.radians(rocking.amplitude)
    return math.radians(90.0 - heading_deg), amplitude * math.sin(phase + rocking.apart), amplitude * math.sin(phase)
