"""What `calibration` keeps of a stop and says of it; and how errors of velocity and position grow together."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ins_nav.estimation.covariance_propagation import Held
from ins_nav.mechanization.nav_state import NavState
from ins_nav.mechanization.strapdown import Sample
from ins_nav.zupt.stationary_rates import StationaryRates

Array = NDArray[np.float64]
Triple = tuple[float, float, float]

_SCHULER_RATE = 1.24e-3
"""rad/s."""
_QUARTER = 0.5 * math.pi / _SCHULER_RATE
"""s: a quarter of Schuler's period."""
_GRAVITY = 9.81


class StopCorrection(NamedTuple):
    """A state to go on from.

    Attributes
    ----------
    stamp_ns : int
        Of an entry of the history.
    state : NavState
    gyro_bias : 3 floats
        From there on, rad/s.
    held : Held or None
        Velocity, where it was taken out.
    calibrated : bool
        Drifts, azimuth and level are those that `ins_nav.zupt.calibration.StopCalibration` has now.
    """

    stamp_ns: int
    state: NavState
    gyro_bias: Triple
    held: Held | None = None
    calibrated: bool = False


@dataclass
class Stop:
    """A stop: the present one, or the first position of ZUPT-1.

    Attributes
    ----------
    began_ns : int
        Its first sample's stamp, on settled data.
    rest : StationaryRates
    bias : 3 floats
        Of the gyros, taken out of the samples given to ``rest``.
    turned, removed : ndarray of shape (3,), float
        Those of `ins_nav.zupt.calibration.StopCalibration` when it began.
    prior : ndarray, shape (4, 4)
        Covariance of drifts and azimuth when the azimuth was last known.
    before : ndarray, shape (3,)
        Turn of S from then to its beginning, per unit of drift, s.
    information : ndarray, shape (4, 4)
        On drifts and the azimuth at its beginning.
    until : float
        Length that is certainly rest, s; infinite while it lasts.
    """

    began_ns: int
    rest: StationaryRates
    bias: Triple
    turned: Array
    removed: float
    prior: Array
    before: Array
    information: Array
    until: float = math.inf


def grown_position(
    time: float, accel_stddev: float, drift_variance: float, gyro_variance: float
) -> tuple[float, float]:
    """Error of position, m, for each m/s of velocity that became wrong in a time, and that velocity's sigma, m/s.

    The regression of one on the other, over a tilt (or an accelerometer's bias) and a drift, each with its
    sigma: between a half and a third of the time. After a quarter of Schuler's period velocity tells little of
    position: nothing is corrected then.

    Parameters
    ----------
    time : float
        s.
    accel_stddev : float
        Of an accelerometer's bias, m/s².
    drift_variance : float
        Of a gyro's, rad²/s².
    gyro_variance : float
        Square of the gyros' angle random walk, rad²/s.
    """
    if time <= 0.0:
        return 0.0, 0.0
    short = min(time, _QUARTER)
    angle = _SCHULER_RATE * short
    sine, cosine = math.sin(angle) / _SCHULER_RATE, (1.0 - math.cos(angle)) / _SCHULER_RATE**2
    way = (short - sine) / _SCHULER_RATE**2
    tilt = (accel_stddev + 1e-6) ** 2
    turn = _GRAVITY**2 * (drift_variance + gyro_variance / short)
    variance = tilt * sine**2 + turn * cosine**2
    grown = (tilt * sine * cosine + turn * cosine * way) / variance
    stddev = math.sqrt(variance * time / short)
    return (min(grown, 0.5 * time) if time <= _QUARTER else 0.0), stddev


def row(state: NavState, i: int) -> Triple:
    """East (0; on n the first axis) or up (2) on the body's axes."""
    x, y, z, w = state[0:4]
    if i == 2:
        return 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
    return 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)


def without(sample: Sample, gyro: Triple, accel: Triple) -> Sample:
    """A sample less biases."""
    h, wx, wy, wz, fx, fy, fz = sample
    return h, wx - gyro[0], wy - gyro[1], wz - gyro[2], fx - accel[0], fy - accel[1], fz - accel[2]
