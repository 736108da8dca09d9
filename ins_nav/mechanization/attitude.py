"""Attitude: the few operations on quaternions that the tick needs, on scalars.

A quaternion is a tuple ``(x, y, z, w)``, scalar last, as in ROS and scipy. ``q_nb`` takes a vector from frame
b to frame n. Outside the tick `scipy.spatial.transform.Rotation` does the rest.

Heading is clockwise from north, ROS yaw counter-clockwise from east: ``yaw = pi/2 - heading`` (REP-103).
Roll and pitch are about the body's x (forward) and y (left) axes in the order yaw, pitch, roll.
"""

import math

Quaternion = tuple[float, float, float, float]


def from_rotation_vector(x: float, y: float, z: float) -> Quaternion:
    """Quaternion of a turn by the rotation vector (x, y, z), rad."""
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-6:  # series: below a milliradian its error is under 1e-20
        s = 0.5 - angle2 * (1.0 / 48.0 - angle2 / 3840.0)
        w = 1.0 - angle2 * (0.125 - angle2 / 384.0)
    else:
        angle = math.sqrt(angle2)
        s = math.sin(0.5 * angle) / angle
        w = math.cos(0.5 * angle)
    return s * x, s * y, s * z, w


def multiply(p: Quaternion, q: Quaternion) -> Quaternion:
    """Hamilton product p q: the turn q, then the turn p."""
    px, py, pz, pw = p
    qx, qy, qz, qw = q
    return (
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
        pw * qw - px * qx - py * qy - pz * qz,
    )


def normalized(q: Quaternion) -> Quaternion:
    """The quaternion scaled to unit length."""
    x, y, z, w = q
    s = 1.0 / math.sqrt(x * x + y * y + z * z + w * w)
    return s * x, s * y, s * z, s * w


def conjugate(q: Quaternion) -> Quaternion:
    """The opposite turn."""
    return -q[0], -q[1], -q[2], q[3]


def rotate(q: Quaternion, vx: float, vy: float, vz: float) -> tuple[float, float, float]:
    """Vector (vx, vy, vz) turned by q."""
    x, y, z, w = q
    tx = 2.0 * (y * vz - z * vy)
    ty = 2.0 * (z * vx - x * vz)
    tz = 2.0 * (x * vy - y * vx)
    return vx + w * tx + y * tz - z * ty, vy + w * ty + z * tx - x * tz, vz + w * tz + x * ty - y * tx


def from_euler(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Quaternion of roll about x after pitch about y after yaw about z (REP-103), rad."""
    sr, cr = math.sin(0.5 * roll), math.cos(0.5 * roll)
    sp, cp = math.sin(0.5 * pitch), math.cos(0.5 * pitch)
    sy, cy = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def to_euler(q: Quaternion) -> tuple[float, float, float]:
    """Roll, pitch and yaw, rad, of a unit quaternion; roll and yaw in [-pi, pi].

    By half sum and half difference of roll and yaw, whose sines and cosines are the four terms below times
    cos(pitch) -+ sin(pitch) of half the angle: exact at a pitch of 90 degrees too, where one of the two is free.
    """
    x, y, z, w = q
    pitch = 2.0 * math.atan2(math.hypot(w + y, x - z), math.hypot(w - y, x + z)) - 0.5 * math.pi
    half_sum = math.atan2(x + z, w - y)
    half_difference = math.atan2(x - z, w + y)
    roll = math.remainder(half_sum + half_difference, 2.0 * math.pi)
    yaw = math.remainder(half_sum - half_difference, 2.0 * math.pi)
    return roll, pitch, yaw


def heading_from_yaw(yaw: float) -> float:
    """Heading, rad in [0, 2 pi], clockwise from north, from ROS yaw (the same formula takes it back)."""
    return (0.5 * math.pi - yaw) % (2.0 * math.pi)
