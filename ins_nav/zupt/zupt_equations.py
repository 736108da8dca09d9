"""ZUPT-1 and ZUPT-2: gyro drifts and azimuth from residual rates at stops.

At rest the mechanization subtracts its computed Earth rate. The residual rate ``b`` on the axes of the navigation
frame S is the drift of the gyros on those axes plus the error of the computed Earth rate due to the azimuth error; it
tilts the platform (Schuler oscillation) and causes a drift of yaw. With ``k`` the horizontal part of the
Earth's rate, ``w`` the drifts on the body's axes, ``m1, m2, m3`` the rows of M (body to S) and ``alpha`` the azimuth
of S, clockwise from north, whose computed value is ``alpha_hat`` ([1]_, (3), (5), (10), (11), (14), (15))::

    b1 = k (sin alpha_hat - sin alpha) + m1' w
    b2 = k (cos alpha - cos alpha_hat) + m2' w
    b3 =                                 m3' w

Here S is the computed east-north-up, so ``alpha_hat`` is 0 and ``alpha`` is the error of the heading:
the true heading is the computed one plus alpha. A self-alignment is a stop as well: its measured rate, (1) of
[1]_, less the Earth's rate at its azimuth, is such a ``b`` (`after_alignment`).

S itself turns with the drift about the vertical, by some arc seconds between stops: ``azimuth_gain``.

References
----------
.. [1] E. S. Lobusov, A. V. Fomichev, "ZUPT mode for a strapdown INS of a ground vehicle", Vestnik MGTU, 2014, no. 6.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from ins_nav.config.declaration import DEG_PER_HOUR
from ins_nav.errors import InsNavError

Array = NDArray[np.float64]

_MIN_TURN = math.radians(20.0)
"""A smaller turn multiplies the errors of the drifts by more than 1 / (2 sin 10°), about 3."""
_MAX_CONDITION = 30.0
"""Condition number above which a solution is refused."""
_CONFIDENCE = 0.999
"""A solution less likely than 1 - this is inconsistent."""
MODEL_ERROR = 1e-10
"""rad/s: gravity some 100 m up is off the ellipsoid's normal by 1e-7 rad, as much of the Earth's rate is 1e-11."""
_MIN_SINE = math.sin(math.radians(5.0))
"""Least sine of the tilt that determines the third drift without the drift of yaw."""


_UNKNOWN = 3.0 / math.pi**2
"""1/rad²: information on an unknown azimuth."""
_INFLATION = 4.0
"""Factor by which the variance of a contradicted prior is increased until it is consistent."""


class ZuptError(InsNavError):
    """These stops give no calibration; the text names the reason and the remedy."""


class InconsistentError(ZuptError):
    """Each stop is valid, but no drift and azimuth explain both."""


@dataclass(frozen=True)
class StopMeasurement:
    """Measurement of one stop.

    Attributes
    ----------
    rot_sb : ndarray, shape (3, 3)
        M, body (FLU) to S (east, north, up): mean over the stop, by the mechanization's attitude, with the weights
        that ``rate`` has.
    rate : ndarray, shape (3,)
        b: the residual rate on the axes of S, rad/s.
    covariance : ndarray, shape (3, 3)
        Of ``rate``.
    horizontal_rate : float
        k, rad/s.
    azimuth_gain : ndarray, shape (3,)
        Clockwise turn of S from the stop's start to the present, per unit of each drift, s.
    """

    rot_sb: Array
    rate: Array
    covariance: Array
    horizontal_rate: float
    azimuth_gain: Array


@dataclass(frozen=True)
class Calibration:
    """Drifts on the body's axes, rad/s; azimuth of S at present, rad: the heading's error, to be added to it.

    ``covariance`` has shape (4, 4): drifts, then azimuth.
    """

    drift: Array
    azimuth: float
    covariance: Array

    def sentence(self, with_azimuth: bool) -> str:
        """The calibration in one line."""
        sigma = np.sqrt(np.diag(self.covariance))
        drifts = ", ".join(
            f"{axis} {w / DEG_PER_HOUR:+.4f} ± {s / DEG_PER_HOUR:.4f}"
            for axis, w, s in zip("xyz", self.drift, sigma[:3], strict=True)
        )
        text = f"gyro drifts in °/h: {drifts}"
        if with_azimuth:
            text += f"; heading corrected by {math.degrees(self.azimuth):+.4f}° ± {math.degrees(sigma[3]):.4f}°"
        return text


def after_alignment(
    rate: ArrayLike, azimuth: float, rot_sb: Array, horizontal_rate: float, covariance: Array
) -> StopMeasurement:
    """The self-alignment in position 1 as a stop ([1]_, (1), (2) and (5)).

    Parameters
    ----------
    rate : array_like, shape (3,)
        b1, b2: total horizontal rate on axes with the computed azimuth ``azimuth``; b5: drift of yaw.
    azimuth : float
        rad, clockwise from north.
    rot_sb : ndarray, shape (3, 3)
        Body to those axes.
    horizontal_rate : float
        k, rad/s.
    covariance : ndarray, shape (3, 3)
        Of ``rate``.
    """
    s, c = math.sin(azimuth), math.cos(azimuth)
    b = np.asarray(rate, float) + horizontal_rate * np.array([s, -c, 0.0])
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # to the axes whose azimuth is 0
    return StopMeasurement(turn @ rot_sb, turn @ b, turn @ covariance @ turn.T, horizontal_rate, np.zeros(3))


@dataclass(frozen=True)
class Prior:
    """Prior knowledge at the first of two stops.

    Attributes
    ----------
    drift : ndarray, shape (3,)
        Expected drifts, rad/s.
    azimuth : float
        Expected azimuth of S at the first stop, rad.
    information : ndarray, shape (4, 4)
        Inverse of the covariance of both; may be singular.
    """

    drift: Array
    azimuth: float
    information: Array

    def at(self, azimuth_gain: Array) -> Calibration:
        """The same at a later time; S has turned clockwise by the gain, per unit of each drift, s."""
        to_now = np.eye(4)
        to_now[3, :3] = azimuth_gain
        covariance = np.linalg.inv(self.information + np.diag([0.0, 0.0, 0.0, _UNKNOWN]))
        return Calibration(self.drift, self.azimuth + float(azimuth_gain @ self.drift), to_now @ covariance @ to_now.T)


def rebased(stop: StopMeasurement, bias: ArrayLike, turn: float) -> StopMeasurement:
    """The same stop with another bias removed from the gyros, and on axes of another azimuth.

    Parameters
    ----------
    stop : StopMeasurement
    bias : array_like, shape (3,)
        Removed in addition, rad/s: drifts are relative to it.
    turn : float
        Clockwise turn of the new axes, rad.
    """
    left = replace(stop, rate=stop.rate - stop.rot_sb @ np.asarray(bias, float))
    s, c = math.sin(turn), math.cos(turn)
    axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    earth = np.array([0.0, stop.horizontal_rate, 0.0])
    return replace(
        left,
        rot_sb=axes @ left.rot_sb,
        rate=axes @ (left.rate + earth) - earth,
        covariance=axes @ left.covariance @ axes.T,
    )


def zupt2_update(stop: StopMeasurement, prior: Array, before: ArrayLike = (0.0, 0.0, 0.0)) -> tuple[Calibration, bool]:
    """Drifts from one stop with the azimuth considered known, combined with the prior.

    (14)-(15) of [1]_ as the measurement of a Schmidt filter, which considers the error of the azimuth without
    estimating it. The drift of yaw since the azimuth was last known is corrected together with the gyro drift that
    caused it. Drifts outside the prior's sigmas are accepted, with the sigmas of the prior increased.

    Parameters
    ----------
    stop : StopMeasurement
    prior : ndarray, shape (4, 4)
        Covariance of the drifts, expected to be zero, and of the azimuth of S when it was last known.
    before : array_like, shape (3,)
        Clockwise turn of S from then to the stop's start, per unit of each drift, s.

    Returns
    -------
    Calibration
        At present.
    bool
        Whether the prior was contradicted.

    Raises
    ------
    ZuptError
        The unit rocked so much that its mean attitude is undefined.
    """
    _check_attitude(stop)
    before = np.asarray(before, float)
    k = stop.horizontal_rate
    h = np.zeros((3, 4))
    h[:, :3] = stop.rot_sb
    h[0, :3] -= k * before
    h[0, 3] = -k
    limit = float(stats.chi2.ppf(_CONFIDENCE, 3))
    noise = stop.covariance + np.eye(3) * MODEL_ERROR**2
    p, contradicted = prior + np.diag([1e-30] * 3 + [0.0]), False  # variances that can be widened
    while float(stop.rate @ np.linalg.solve(h @ p @ h.T + noise, stop.rate)) > limit:
        widen = np.diag([math.sqrt(_INFLATION)] * 3 + [1.0])
        p, contradicted = widen @ p @ widen, True
    innovation = h @ p @ h.T + noise
    gain = np.linalg.solve(innovation, h @ p).T
    gain[3] = 0.0
    left = np.eye(4) - gain @ h
    drift = gain[:3] @ stop.rate
    turned = before + stop.azimuth_gain
    to_now = np.eye(4)
    to_now[3, :3] = turned
    covariance = to_now @ (left @ p @ left.T + gain @ noise @ gain.T) @ to_now.T
    return Calibration(drift, float(turned @ drift), covariance), contradicted


def zupt2(stop: StopMeasurement, heading_stddev: float = 0.0) -> Calibration:
    """Drifts from one stop, the azimuth trusted ([1]_, (14)-(15)).

    Parameters
    ----------
    stop : StopMeasurement
    heading_stddev : float
        rad. Enters the covariance only: an azimuth wrong by so much looks like a drift of ``k`` times that.

    Returns
    -------
    Calibration
        With azimuth 0. After a self-alignment in the same position the azimuth has absorbed the east drift, which
        is then invisible here: a limit of the method, shown by the covariance.

    Raises
    ------
    ZuptError
        The unit rocked so much that its mean attitude is undefined.
    """
    _check_attitude(stop)
    inverse = np.linalg.inv(stop.rot_sb)
    covariance = np.zeros((4, 4))
    noise = stop.covariance.copy()
    noise[0, 0] += (stop.horizontal_rate * heading_stddev) ** 2
    covariance[:3, :3] = inverse @ noise @ inverse.T
    covariance[3, 3] = heading_stddev**2
    # the errors of drifts and azimuth are fully correlated
    covariance[:3, 3] = covariance[3, :3] = inverse[:, 0] * stop.horizontal_rate * heading_stddev**2
    return Calibration(inverse @ stop.rate, 0.0, covariance)


def zupt1(first: StopMeasurement, second: StopMeasurement, prior: Prior | None = None) -> Calibration:
    """Drifts and azimuth from two positions, by maximum likelihood.

    All six rates of the two stops, weighted by their covariance, and sin² + cos² = 1 as a matter of course, where
    the linear systems (7)-(8) and (12)-(13) of [1]_ leave one rate and that condition unused; the linear solution
    is where the iteration starts.

    Parameters
    ----------
    first, second : StopMeasurement
    prior : Prior, optional
        Known besides; left out where the stops contradict it.

    Raises
    ------
    ZuptError
        No turn in yaw between the positions.
    InconsistentError
        Rates that no drift and azimuth explain.
    """
    start = _linear(first, second)
    x, information, mismatch = _most_likely(start, first, second, None)
    limit = float(stats.chi2.ppf(_CONFIDENCE, 2))
    if mismatch > limit:
        raise InconsistentError(
            f"inconsistent: no drift and azimuth explain both stops (chi-square {mismatch:.1f}, limit {limit:.1f}): "
            "the unit moved during a stop, or its drift changed between them; this is position 1 now: turn, stop for "
            "longer, call again"
        )
    if prior is not None:
        together = _most_likely(x, first, second, prior)
        if together[2] - mismatch < float(stats.chi2.ppf(_CONFIDENCE, 4)):
            x, information, _ = together
    return Calibration(x[:3], float(x[3]), np.asarray(np.linalg.inv(information), float))


def _most_likely(
    x: Array, first: StopMeasurement, second: StopMeasurement, prior: Prior | None
) -> tuple[Array, Array, float]:
    """Drifts and azimuth by Gauss-Newton from a start, their information, and the remaining squared distance."""
    whole = np.zeros((6, 6))
    whole[:3, :3], whole[3:, 3:] = first.covariance, second.covariance
    weight = np.linalg.inv(whole + np.eye(6) * MODEL_ERROR**2)
    at_first = np.eye(4)
    at_first[3, :3] = -first.azimuth_gain
    for i in range(9):
        residual, jacobian = _residual(x, first, second)
        information = jacobian.T @ weight @ jacobian
        pull = jacobian.T @ weight @ residual
        mismatch = float(residual @ weight @ residual)
        if prior is not None:
            off = np.array([*prior.drift, prior.azimuth]) - at_first @ x
            information = information + at_first.T @ prior.information @ at_first
            pull = pull + at_first.T @ prior.information @ off
            mismatch += float(off @ prior.information @ off)
        if i < 8:
            x = x + np.linalg.solve(information, pull)
    return x, information, mismatch


def zupt1_linear(first: StopMeasurement, second: StopMeasurement) -> Calibration:
    """Drifts and azimuth from two positions by the linear system ([1]_, (7)-(8), (12)-(13)).

    Raises
    ------
    ZuptError
        No turn in yaw between the positions, or sin² + cos² of the azimuth is not 1 within its sigma.
    """
    x = _linear(first, second)
    system, _ = _linear_system(first, second)
    # errors of the right side: second minus first on the horizontal axes, and the drift of yaw
    noise = np.zeros((3, 3))
    noise[:2, :2] = first.covariance[:2, :2] + second.covariance[:2, :2]
    noise[2, 2] = first.covariance[2, 2]
    cross = np.zeros((3, 3))  # right side with the first stop's rates
    cross[:2, :2] = -first.covariance[:2, :2]
    cross[2, 2] = first.covariance[2, 2]
    inverse = np.linalg.inv(system)
    drift_covariance = inverse @ noise @ inverse.T
    with_rate = inverse @ cross
    k = first.horizontal_rate
    sine, cosine, norm = _sine_cosine(x[:3], first)
    # sin = (m1'w - b1) / k, and so on
    rows = first.rot_sb[:2]
    pair = (
        rows @ drift_covariance @ rows.T
        - rows @ with_rate[:, :2]
        - with_rate[:, :2].T @ rows.T
        + first.covariance[:2, :2]
    ) / k**2
    radial = np.array([sine, -cosine])  # the second of the pair enters the cosine with the other sign
    norm_stddev = 2.0 * math.sqrt(max(float(radial @ pair @ radial), 0.0))
    limit = float(stats.norm.ppf(0.5 * (1.0 + _CONFIDENCE)))
    if abs(norm - 1.0) > limit * norm_stddev + 2.0 * MODEL_ERROR / k:
        raise ZuptError(
            f"inconsistent: sin² + cos² of the azimuth is {norm:.4f}, not 1 within {limit * norm_stddev:.4f}: "
            "the unit moved during a stop, or its drift changed between them; repeat with longer stops"
        )
    covariance = np.zeros((4, 4))
    covariance[:3, :3] = drift_covariance
    tangent = np.array([cosine, sine])
    covariance[3, 3] = float(tangent @ pair @ tangent)
    covariance[:3, 3] = covariance[3, :3] = (drift_covariance @ rows.T - with_rate[:, :2]) @ tangent / k
    return Calibration(x[:3], float(x[3]), covariance)


def zupt1_nonlinear(first: StopMeasurement, second: StopMeasurement) -> Calibration:
    """Drifts and azimuth without the drift of yaw ([1]_, (9)): for a base whose yaw varies.

    Two drifts are expressed through the third, sin² + cos² = 1 gives it; of the two roots the one nearer to no
    drift is the solution, which is right as long as the drifts are small beside the Earth's rate. One of the positions
    must be far from the horizon, or the third drift does not show.

    Raises
    ------
    ZuptError
        The positions do not show all drifts, or there is no real root.
    """
    _check_turn(first, second)
    left, right = _linear_system(first, second)
    u, s, vt = np.linalg.svd(left[:2])
    base = vt[:2].T @ ((u.T @ right[:2]) / s)  # one solution; the others differ by multiples of the null direction
    free = vt[2]
    k = first.horizontal_rate
    rows = first.rot_sb[:2]
    offset = np.array([rows[0] @ base - first.rate[0], k + first.rate[1] - rows[1] @ base]) / k
    slope = np.array([rows[0] @ free, -(rows[1] @ free)]) / k
    a, half_b, c = float(slope @ slope), float(slope @ offset), float(offset @ offset) - 1.0
    if a * k**2 < _MIN_SINE**2:
        raise ZuptError(
            "without the drift of yaw a position far from the horizon is needed: tilt the unit by 20° or more in "
            "one of the positions"
        )
    discriminant = half_b**2 - a * c
    if abs(discriminant) * k**2 < _MIN_SINE**2:  # both roots are one: the third drift acts as the azimuth does
        raise ZuptError(
            "these positions do not separate drift and azimuth without the drift of yaw: turn or tilt the unit "
            "by another angle"
        )
    if discriminant < 0.0:
        raise ZuptError(
            "inconsistent: no drift makes sin² + cos² of the azimuth equal to 1; the unit moved during a stop"
        )
    roots = [(-half_b + sign * math.sqrt(discriminant)) / a for sign in (1.0, -1.0)]
    solutions = [base + t * free for t in roots]
    drift = min(solutions, key=lambda w: float(np.linalg.norm(w)))
    sine, cosine, _ = _sine_cosine(drift, first)
    azimuth = math.atan2(sine, cosine) + float(first.azimuth_gain @ drift)
    blind = np.diag([0.0, 0.0, 1e6 * k**2])  # the drift of yaw has no weight
    without = [replace(stop, covariance=stop.covariance + blind) for stop in (first, second)]
    _, jacobian = _residual(np.array([*drift, azimuth]), *without)
    whole = np.zeros((6, 6))
    whole[:3, :3], whole[3:, 3:] = without[0].covariance, without[1].covariance
    information = jacobian.T @ np.linalg.inv(whole + np.eye(6) * 1e-30) @ jacobian
    return Calibration(drift, azimuth, np.asarray(np.linalg.inv(information), float))


def _residual(x: Array, first: StopMeasurement, second: StopMeasurement) -> tuple[Array, Array]:
    """Measured less predicted rates of both stops, shape (6,), and the Jacobian of the prediction, shape (6, 4)."""
    residual, jacobian = np.empty(6), np.zeros((6, 4))
    for i, stop in enumerate((first, second)):
        k = stop.horizontal_rate
        azimuth = float(x[3] - stop.azimuth_gain @ x[:3])
        s, c = math.sin(azimuth), math.cos(azimuth)
        rows = slice(3 * i, 3 * i + 3)
        residual[rows] = stop.rate - stop.rot_sb @ x[:3] - k * np.array([-s, c - 1.0, 0.0])
        by_azimuth = k * np.array([-c, -s, 0.0])
        jacobian[rows, :3] = stop.rot_sb - np.outer(by_azimuth, stop.azimuth_gain)
        jacobian[rows, 3] = by_azimuth
    return residual, jacobian


def _linear_system(first: StopMeasurement, second: StopMeasurement) -> tuple[Array, Array]:
    """(12)-(13): left side, shape (3, 3), and right side, shape (3,)."""
    left = np.vstack([(second.rot_sb - first.rot_sb)[:2], first.rot_sb[2]])
    # S turns between the stops: its azimuth enters the east rate of the second
    turned = first.azimuth_gain - second.azimuth_gain
    left[0] -= second.horizontal_rate * turned
    return left, np.array([*(second.rate - first.rate)[:2], first.rate[2]])


def _linear(first: StopMeasurement, second: StopMeasurement) -> Array:
    """Drifts and present azimuth, shape (4,), by the linear system."""
    _check_turn(first, second)
    left, right = _linear_system(first, second)
    if np.linalg.cond(left) > _MAX_CONDITION:
        raise ZuptError(_turn_missing(first, second))
    drift: Array = np.asarray(np.linalg.solve(left, right), float)
    sine, cosine, _ = _sine_cosine(drift, first)
    return np.array([*drift, math.atan2(sine, cosine) + first.azimuth_gain @ drift])


def _sine_cosine(drift: Array, stop: StopMeasurement) -> tuple[float, float, float]:
    """Sine and cosine of the azimuth at a stop, and their squares' sum: (6) of [1]_."""
    k = stop.horizontal_rate
    sine = float(stop.rot_sb[0] @ drift - stop.rate[0]) / k
    cosine = 1.0 + float(stop.rate[1] - stop.rot_sb[1] @ drift) / k
    return sine, cosine, sine**2 + cosine**2


def _check_attitude(stop: StopMeasurement) -> None:
    if np.linalg.svd(stop.rot_sb, compute_uv=False)[-1] < 0.5:
        raise ZuptError("rocking too much: over the stop the unit had no mean attitude")


def _check_turn(first: StopMeasurement, second: StopMeasurement) -> None:
    _check_attitude(first)
    _check_attitude(second)
    if _yaw_between(first, second) < _MIN_TURN:
        raise ZuptError(_turn_missing(first, second))


def _yaw_between(first: StopMeasurement, second: StopMeasurement) -> float:
    """Angle of the turn about the vertical between two positions, rad, 0 to pi."""
    between = second.rot_sb @ first.rot_sb.T
    return abs(math.atan2(between[1, 0] - between[0, 1], between[0, 0] + between[1, 1]))


def _turn_missing(first: StopMeasurement, second: StopMeasurement) -> str:
    return (
        f"no turn between the positions: yaw differs by {math.degrees(_yaw_between(first, second)):.1f}°, at least "
        f"{math.degrees(_MIN_TURN):.0f}° are needed; turn the vehicle by 90° to 180° and call again"
    )
