"""Aids: what each measures, as an innovation, its Jacobian and its noise.

An aid is a class that holds its mounting and turns a solution and a measured value into a `Measurement`, or None
when the value says nothing. The sign is computed less measured everywhere; the columns are those of
`error_model`. Lever arms are from the IMU, body axes. A new one needs the formula of what it measures and
three facts about errors: a vector on body axes, turned to n, is wrong by ``phi x vector``; velocity on body axes by
``rot_bn dv``; position by ``dp``.

A sine and a cosine stand for heading (`error_model`): a horizontal vector that turns with heading has its own
components in the column of the cosine.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ins_nav.estimation.error_model import ABSENT, Array, SlowState, Vector, azimuth, rotation_matrix
from ins_nav.estimation.observation import Measurement, Solution
from ins_nav.estimation.state_layout import ATTITUDE, COSINE, GYRO_BIAS, HEIGHT, POSITION, SIZE, VELOCITY
from ins_nav.mechanization import nav_state
from ins_nav.mechanization.attitude import rotate
from ins_nav.mechanization.earth import geodetic_to_ecef

_NONE: Vector = (0.0, 0.0, 0.0)


class GnssPosition:
    """Latitude, longitude and height of an antenna.

    Parameters
    ----------
    lever_arm : 3 floats
        m.
    horizontal : bool
        Leave height alone.
    """

    def __init__(self, lever_arm: Vector = _NONE, horizontal: bool = False) -> None:
        self._lever_arm = lever_arm
        self._rows = 2 if horizontal else 3

    def measure(self, solution: Solution, lat: float, lon: float, height: float, covariance: ArrayLike) -> Measurement:
        """rad and m; covariance on east, north, up, shape (3, 3), m². Height is not looked at when it is left alone."""
        state = solution.state
        arm = rotate(state[0:4], *self._lever_arm)
        if self._rows == 2:
            height = state[11] + arm[2]
        away = np.array(nav_state.position_ecef(state)) - geodetic_to_ecef(lat, lon, height)
        z = np.add(_from_earth(state, away), arm)
        z[2] = state[11] + arm[2] - height  # the chord leaves the surface by d² / 2R
        h: Array = np.zeros((3, SIZE))
        h[:, POSITION] = np.eye(3)
        _turned(h, arm)
        return _rows(z, h, _on_n(state, covariance), self._rows, POSITION)


class GnssVelocity:
    """Velocity of an antenna on east, north, up.

    Parameters
    ----------
    lever_arm : 3 floats
        m.
    horizontal : bool
        Leave the vertical component alone.
    """

    def __init__(self, lever_arm: Vector = _NONE, horizontal: bool = False) -> None:
        self._lever_arm = lever_arm
        self._rows = 2 if horizontal else 3

    def measure(self, solution: Solution, velocity: Vector, covariance: ArrayLike) -> Measurement:
        """m/s; covariance on east, north, up, shape (3, 3), m²/s²."""
        state = solution.state
        rot_nb = rotation_matrix(state[0:4])
        swing = rot_nb @ np.cross(_rate_to_earth(solution), self._lever_arm)
        c, s = azimuth(state)
        east, north, up = velocity
        z = np.add(state[4:7], swing) - [c * east + s * north, c * north - s * east, up]
        h: Array = np.zeros((3, SIZE))
        h[:, VELOCITY] = np.eye(3)
        travel = swing + np.multiply(state[4:7], 1.0 if solution.travels else (0.0, 0.0, 1.0))
        _turned(h, travel)
        h[:, GYRO_BIAS] = rot_nb @ _cross_matrix(self._lever_arm)
        r = _on_n(state, covariance)
        if not solution.travels:
            r[:2, :2] += solution.turn * (state[4] ** 2 + state[5] ** 2) * np.eye(2)
        return _rows(z, h, r, self._rows, VELOCITY)


class Depth:
    """Depth below the sea surface.

    Parameters
    ----------
    lever_arm : 3 floats
        m.
    """

    def __init__(self, lever_arm: Vector = _NONE) -> None:
        self._lever_arm = lever_arm

    def height(self, solution: Solution) -> float:
        """Ellipsoidal height of the gauge, m."""
        return solution.state[11] + rotate(solution.state[0:4], *self._lever_arm)[2]

    def measure(self, solution: Solution, depth: float, variance: float, surface: float) -> Measurement:
        """m, down positive; m²; ellipsoidal height of the surface, m, which may be a state of its own."""
        arm = rotate(solution.state[0:4], *self._lever_arm)
        h: Array = np.zeros((3, SIZE))
        h[HEIGHT, HEIGHT] = 1.0
        _turned(h, arm)
        z = np.array([solution.state[11] + arm[2] - surface + depth])
        return Measurement(z, h[2:], np.array([[variance]]), slice(HEIGHT, HEIGHT + 1), np.array([[-1.0]]))


class Log:
    """Velocity relative to the ground, or the water, on the sensor's own axes: Doppler log, odometer.

    It reads ``(1 + scale) v + (0, a_y, a_z) x v``; its own states are scale and the two angles, rad, by which the
    direction of its x axis is wrong. v is the velocity of the sensor on its nominal axes; where it measures through
    water, less the current, whose east and north components, m/s, are two states more. What it reads may be off by a
    slow error besides, three states on its axes, m/s.

    Parameters
    ----------
    rpy : 3 floats
        Roll, pitch, yaw of the sensor's axes on the body's (REP-103), rad.
    lever_arm : 3 floats
        m.
    scale, pitch, yaw : SlowState
        Errors of the unit.
    current : SlowState or None
        Each component; None: it measures over the ground.
    slow : SlowState or None
        On each axis; None: its error is white.
    """

    def __init__(
        self,
        rpy: Vector = _NONE,
        lever_arm: Vector = _NONE,
        scale: SlowState = ABSENT,
        pitch: SlowState = ABSENT,
        yaw: SlowState = ABSENT,
        current: SlowState | None = None,
        slow: SlowState | None = None,
    ) -> None:
        currents = () if current is None else (current,) * 2
        slows = () if slow is None else (slow,) * 3
        self.states: tuple[SlowState, ...] = (scale, pitch, yaw, *currents, *slows)
        self._current = slice(3, 3 + len(currents))
        self._slow = slice(self._current.stop, len(self.states))
        self._rot_sb: Array = Rotation.from_euler("ZYX", rpy[::-1]).as_matrix().T
        self._lever_arm = lever_arm

    def measure(
        self, solution: Solution, own: Sequence[float] | Array, velocity: Vector, covariance: ArrayLike
    ) -> Measurement | None:
        """m/s, NaN where there is none; covariance on the sensor's axes, shape (3, 3), m²/s²; own states in use."""
        axes = np.flatnonzero(np.isfinite(velocity))
        if not len(axes):
            return None
        scale, a_y, a_z = map(float, own[:3])
        body = np.add(nav_state.velocity_body(solution.state), np.cross(_rate_to_earth(solution), self._lever_arm))
        rot_nb = rotation_matrix(solution.state[0:4])
        to_n = _east_north(solution.state)
        through_water = self._current.stop > self._current.start
        current = to_n @ np.asarray(own[self._current]) if through_water else np.zeros(3)
        x, y, w = map(float, self._rot_sb @ (body - rot_nb.T @ current))
        reads = np.array([[1.0 + scale, -a_z, a_y], [a_z, 1.0 + scale, 0.0], [-a_y, 0.0, 1.0 + scale]])
        z = reads @ (x, y, w) - velocity
        reads = reads @ self._rot_sb
        with_slow = self._slow.stop > self._slow.start
        if with_slow:
            z = z + own[self._slow]
        h: Array = np.zeros((3, SIZE))
        h[:, VELOCITY] = reads @ rot_nb.T
        h[:, GYRO_BIAS] = reads @ _cross_matrix(self._lever_arm)
        columns = np.array([[x, w, -y], [y, 0.0, x], [w, -x, 0.0]])
        if through_water:  # it stays where it is when attitude is wrong
            h[:, ATTITUDE] = -reads @ rot_nb.T @ _cross_matrix(current.tolist())
            h[:, COSINE] = -reads @ rot_nb.T @ current
            columns = np.hstack([columns, -reads @ rot_nb.T @ to_n])
        if with_slow:
            columns = np.hstack([columns, np.eye(3)])
        r = np.asarray(covariance, float)[np.ix_(axes, axes)]
        return Measurement(z[axes], h[axes], r, VELOCITY, columns[axes])


class BeaconRange:
    """Slant range to a beacon; its own states are the scale (error of the sound speed) and the bias, m.

    It reads ``(1 + scale) distance + bias``.

    Parameters
    ----------
    lever_arm : 3 floats
        Of the transducer, m.
    scale, bias : SlowState
    """

    def __init__(
        self,
        lever_arm: Vector = _NONE,
        scale: SlowState = ABSENT,
        bias: SlowState = ABSENT,
    ) -> None:
        self.states = (scale, bias)
        self._lever_arm = lever_arm

    def away(self, state: nav_state.NavState, beacon: ArrayLike) -> Array:
        """From a beacon, Earth-fixed, to the transducer, on n, shape (3,), m."""
        arm = rotate(state[0:4], *self._lever_arm)
        return np.add(_from_earth(state, np.subtract(nav_state.position_ecef(state), beacon)), arm)

    def measure(
        self, solution: Solution, own: Sequence[float] | Array, beacon: ArrayLike, distance: float, variance: float
    ) -> Measurement | None:
        """Beacon Earth-fixed (`earth.geodetic_to_ecef`), m; range, m, its variance, m²; own states in use.

        To second order in the position's error (Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking
        and Navigation, 10.3.2): across the direction to the beacon range grows with its square. Where the place is
        hardly known, a range is worth the less.
        """
        state = solution.state
        scale, bias = map(float, own)
        arm = rotate(state[0:4], *self._lever_arm)
        away = self.away(state, beacon)
        length = float(np.linalg.norm(away))
        if length == 0.0:
            return None  # at the beacon: no direction
        h: Array = np.zeros((3, SIZE))
        h[:, POSITION] = np.eye(3)
        _turned(h, arm)
        across = (np.eye(3) - np.outer(away, away) / length**2) / length @ solution.position_covariance
        z = np.array([(1.0 + scale) * (length + 0.5 * across.trace()) + bias - distance])
        row = ((1.0 + scale) / length) * away @ h
        r = np.array([[variance + 0.5 * (across @ across).trace()]])
        return Measurement(z, row[None], r, POSITION, np.array([[length, 1.0]]))


def _turned(h: Array, vector: Sequence[float] | Array) -> None:
    """Write the columns of attitude: what turns with it, on n, is wrong by phi x vector; and that of the cosine."""
    x, y, z = map(float, vector)
    h[:, ATTITUDE] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    h[0, COSINE], h[1, COSINE] = x, y


def _cross_matrix(vector: Sequence[float]) -> Array:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _rate_to_earth(solution: Solution) -> Vector:
    """Angular rate of the body relative to the Earth, body axes, rad/s."""
    x, y, z = nav_state.earth_rate_body(solution.state)
    return solution.rate[0] - x, solution.rate[1] - y, solution.rate[2] - z


def _from_earth(state: nav_state.NavState, vector: Array) -> Vector:
    """Earth-fixed vector on n."""
    x, y, z, w = state[7:11]
    return rotate((-x, -y, -z, w), *map(float, vector))


def _east_north(state: nav_state.NavState) -> Array:
    """East and north on n, shape (3, 2)."""
    c, s = azimuth(state)
    return np.array([[c, s], [-s, c], [0.0, 0.0]])


def _on_n(state: nav_state.NavState, covariance: ArrayLike) -> Array:
    """Covariance on east, north, up, turned to n."""
    c, s = azimuth(state)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    turned: Array = turn @ np.asarray(covariance, float) @ turn.T
    return turned


def _rows(z: Array, h: Array, r: Array, count: int, direct: slice) -> Measurement:
    return Measurement(z[:count], h[:count], r[:count, :count], direct)
