"""Velocity log: Doppler log, odometer; velocity relative to the ground, or the water, on the sensor's own axes.

It measures ``(1 + scale) v + (0, a_y, a_z) x v``; its first three states are the scale and the two angles, rad, of the
error of its x axis. v is the velocity of the sensor on its nominal axes; where it measures through
water, less the current, whose east and north components, m/s, are two states more. A slow error besides is three states
on its axes, m/s.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ins_nav.aiding.base import (
    Aid,
    AidParameters,
    Observation,
    OwnStates,
    Reading,
    declare_default_stddev,
    declare_lever_arm,
    declare_min_stddev,
    slow_error,
)
from ins_nav.aiding.fields import no_measurement, read_velocity
from ins_nav.aiding.geometry import cross_matrix, east_north, rate_to_earth
from ins_nav.aiding.simulated import (
    MakeMessage,
    Messages,
    Readings,
    Stamps,
    World,
    isotropic,
    rows,
    turned,
    velocity_message,
    within,
)
from ins_nav.config.declaration import DEG, Section, parameter
from ins_nav.config.parameters import Value
from ins_nav.estimation.error_model import Array, Vector, rotation_matrix
from ins_nav.estimation.observation import Measurement, Solution
from ins_nav.estimation.slow_state import SlowState
from ins_nav.estimation.state_layout import ATTITUDE, COSINE, GYRO_BIAS, SIZE, VELOCITY
from ins_nav.mechanization import nav_state

_CURRENT_TIME = 3600.0
"""s, of a current: tides turn in hours, eddies are crossed in as long."""
_NO_BOTTOM = -32.768
"""m/s: of a log in format PD0, on an axis without bottom."""


@dataclass(frozen=True)
class LogParameters(AidParameters):
    """Parameters ``log.*``."""

    default_stddev: float = declare_default_stddev(0.2, "m/s")
    min_stddev: float = declare_min_stddev(0.005, "m/s")
    lever_arm: Vector = declare_lever_arm("log")
    mounting_rpy: Vector = parameter(
        [0.0, 0.0, 0.0],
        "roll, pitch, yaw of the log's axes in base_link",
        name="mounting_rpy_deg",
        unit="deg",
        low=-360.0,
        high=360.0,
        scale=DEG,
    )
    max_speed: float = parameter(
        100.0, "messages with a higher speed on an axis are rejected", unit="m/s", low=0.1, high=1e4
    )
    scale: float = parameter(
        0.0, "known error of its scale factor: 0.01 where it reads 1 % too much", low=-0.5, high=0.5
    )
    scale_stddev: float = parameter(0.01, "uncertainty of that", low=0.0, high=1.0)
    pitch: float = parameter(
        0.0,
        "known error of mounting_rpy_deg about its y axis",
        name="pitch_deg",
        unit="deg",
        low=-45.0,
        high=45.0,
        scale=DEG,
    )
    yaw: float = parameter(
        0.0, "the same about its z axis", name="yaw_deg", unit="deg", low=-45.0, high=45.0, scale=DEG
    )
    misalignment_stddev: float = parameter(
        0.5,
        "uncertainty of these angles, each",
        name="misalignment_stddev_deg",
        unit="deg",
        low=0.0,
        high=45.0,
        scale=DEG,
    )
    slow_stddev: float = parameter(
        0.0, "of an error that changes slowly, each axis; 0: none", unit="m/s", low=0.0, high=10.0
    )
    slow_time: float = parameter(30.0, "its correlation time", unit="s", low=0.01, high=1e5)
    water_track: bool = parameter(False, "it measures velocity through water: the current is estimated")
    current_stddev: float = parameter(0.3, "of that current, east and north each", unit="m/s", low=1e-3, high=10.0)


@dataclass(frozen=True)
class SimulatedLog(Section):
    """Parameters ``log.*`` of a simulation."""

    rate: float = parameter(0.0, "readings a second; 0: none", unit="Hz", low=0.0, high=100.0)
    mounting_rpy: Vector = parameter(
        [0.0, 0.0, 0.0],
        "roll, pitch, yaw of the log's axes on the body's",
        name="mounting_rpy_deg",
        unit="deg",
        scale=DEG,
    )
    lever_arm: Vector = parameter([0.0, 0.0, 0.0], "log from the IMU: forward, left, up", unit="m")
    noise_stddev: float = parameter(0.01, "white noise, each axis", unit="m/s", low=0.0)
    noise_per_speed: float = parameter(0.0, "further white noise, each axis, as a share of speed", low=0.0, high=1.0)
    scale: float = parameter(0.0, "scale error: it reads 1 + scale times the velocity", low=-0.5, high=0.5)
    scale_stddev: float = parameter(0.0, "the same, drawn once a run and added", low=0.0, high=0.5)
    misalignment: tuple[float, float] = parameter(
        [0.0, 0.0],
        "angles a_y, a_z about its left and up axes: it reads (0, a_y, a_z) x v more",
        name="misalignment_deg",
        unit="deg",
        low=-45.0,
        high=45.0,
        scale=DEG,
    )
    misalignment_stddev: float = parameter(
        0.0,
        "the same, drawn once a run and added, each",
        name="misalignment_stddev_deg",
        unit="deg",
        low=0.0,
        high=45.0,
        scale=DEG,
    )
    current: tuple[float, float] = parameter(
        [0.0, 0.0], "current of the water it tracks, east, north; 0 on bottom track", unit="m/s"
    )
    current_stddev: float = parameter(0.0, "the same, drawn once a run and added, each", unit="m/s", low=0.0)
    lost: str = parameter("nan", "output without bottom; silent: none", choices=("nan", "zeros", "silent"))
    lost_start: float = parameter(0.0, "start of a loss of bottom", unit="s", low=0.0)
    lost_duration: float = parameter(0.0, "duration of the loss; 0: none", unit="s", low=0.0)
    lost_period: float = parameter(0.0, "period of repeated losses; 0: one loss", unit="s", low=0.0)
    outlier_share: float = parameter(0.0, "share of readings off by a vector of any direction", low=0.0, high=1.0)
    outlier_span: tuple[float, float] = parameter(
        [0.5, 3.0], "smallest and largest length of that vector", unit="m/s", low=0.0
    )


@dataclass(frozen=True)
class LogReadings:
    """Of a log: ``(1 + scale) v + (0, a_y, a_z) x v`` of the velocity v over ground, or through water, on its axes."""

    stamps_ns: Stamps
    velocity: Array
    """(m, 3), m/s; NaN or 0 without bottom, by `SimulatedLog.lost`."""
    stddev: Array
    """(m,), of the noise, each axis, m/s."""
    scale: float
    """Given and drawn."""
    misalignment: tuple[float, float]
    """a_y and a_z, given and drawn, rad."""
    current: tuple[float, float]
    """Of the water it tracks, east, north, given and drawn, m/s."""
    message_type: str

    def messages(self, make: MakeMessage) -> Messages:
        for stamp, velocity, stddev in rows(self.stamps_ns, self.velocity, self.stddev):
            yield stamp, velocity_message(make, stamp, velocity, isotropic(stddev))


class VelocityLog(Aid[LogParameters]):
    """Velocity on the axes of a log; an axis with NaN is not measured."""

    NAME = "log"
    TOPIC = "log"
    MESSAGE_TYPES = ("geometry_msgs/msg/TwistWithCovarianceStamped",)
    TEXT = "m/s on the log's axes; NaN: not measured"
    PARAMETERS = LogParameters
    SIMULATED = ("log", SimulatedLog)
    CALIBRATED = 3
    CALIBRATION = ("log.scale", "log.scale_stddev", "log.pitch_deg", "log.yaw_deg", "log.misalignment_stddev_deg")

    def __init__(self, parameters: LogParameters) -> None:
        super().__init__(parameters)
        p = parameters
        unit = (
            SlowState(p.scale_stddev, value=p.scale),
            SlowState(p.misalignment_stddev, value=p.pitch),
            SlowState(p.misalignment_stddev, value=p.yaw),
        )
        currents = (slow_error(p.current_stddev, _CURRENT_TIME),) * 2 if p.water_track else ()
        slow = (slow_error(p.slow_stddev, p.slow_time),) * 3 if p.slow_stddev else ()
        self.states = (*unit, *currents, *slow)
        self._current = slice(3, 3 + len(currents))
        self._slow = slice(self._current.stop, len(self.states))
        self._rot_sb: Array = Rotation.from_euler("ZYX", p.mounting_rpy[::-1]).as_matrix().T

    def read(self, message: Any) -> Reading:
        """The content of a message; exact zeros forward and across, and -32.768, are a log without bottom."""
        reading = read_velocity(message)
        velocity = tuple(math.nan if abs(x - _NO_BOTTOM) < 1e-6 else x for x in reading.value)
        known = [abs(x) for x in velocity if math.isfinite(x)]
        if not known or velocity[:2] == (0.0, 0.0) or max(known) > self.parameters.max_speed:
            raise no_measurement(velocity)
        return reading._replace(value=velocity)

    def measure(self, solution: Solution, own: OwnStates, observation: Observation) -> Measurement | None:
        state, values = solution.state, own.values
        axes = np.flatnonzero(np.isfinite(observation.value))
        if not len(axes):
            return None
        scale, a_y, a_z = map(float, values[: self.CALIBRATED])
        arm = self.parameters.lever_arm
        body = np.add(nav_state.velocity_body(state), np.cross(rate_to_earth(solution), arm))
        rot_nb = rotation_matrix(state[0:4])
        to_n = east_north(state)
        through_water = self._current.stop > self._current.start
        current = to_n @ values[self._current] if through_water else np.zeros(3)
        x, y, w = map(float, self._rot_sb @ (body - rot_nb.T @ current))
        reads = np.array([[1.0 + scale, -a_z, a_y], [a_z, 1.0 + scale, 0.0], [-a_y, 0.0, 1.0 + scale]])
        z = reads @ (x, y, w) - observation.value
        reads = reads @ self._rot_sb
        with_slow = self._slow.stop > self._slow.start
        if with_slow:
            z = z + values[self._slow]
        h: Array = np.zeros((3, SIZE))
        h[:, VELOCITY] = reads @ rot_nb.T
        h[:, GYRO_BIAS] = reads @ cross_matrix(arm)
        columns = np.array([[x, w, -y], [y, 0.0, x], [w, -x, 0.0]])
        if through_water:  # the current does not turn with the attitude's error
            h[:, ATTITUDE] = -reads @ rot_nb.T @ cross_matrix(current.tolist())
            h[:, COSINE] = -reads @ rot_nb.T @ current
            columns = np.hstack([columns, -reads @ rot_nb.T @ to_n])
        if with_slow:
            columns = np.hstack([columns, np.eye(3)])
        r = observation.covariance[np.ix_(axes, axes)]
        measurement = Measurement(z[axes], h[axes], r, VELOCITY, columns[axes])
        # zeros on every axis are what a log without bottom reports: no evidence against the solution
        silent = not any(x for x in observation.value if math.isfinite(x))
        return measurement._replace(valid_within=0.0) if silent else measurement

    def calibration(self, own: Sequence[tuple[float, float]]) -> dict[str, Value]:
        (scale, scale_stddev), (pitch, pitch_stddev), (yaw, yaw_stddev) = own[: self.CALIBRATED]
        return LogParameters.overrides(
            self.NAME,
            scale=scale,
            scale_stddev=scale_stddev,
            pitch=pitch,
            yaw=yaw,
            misalignment_stddev=max(pitch_stddev, yaw_stddev),
        )

    @classmethod
    def simulate(cls, world: World) -> dict[str, Readings]:
        p, t = world.section(SimulatedLog, cls.NAME), world.truth
        index = world.instants(p.rate, "log.rate")
        count = len(index)
        scale = p.scale + p.scale_stddev * float(world.stream("log.scale").standard_normal())
        a = np.array(p.misalignment) + p.misalignment_stddev * world.stream("log.misalignment").standard_normal(2)
        current = np.array(p.current) + p.current_stddev * world.stream("log.current").standard_normal(2)
        flow = turned(t.q_nb[index], [*current, 0.0], inverse=True)
        body_to_sensor = Rotation.from_euler("ZYX", p.mounting_rpy[::-1]).inv()
        true = body_to_sensor.apply(world.velocity_body(index, p.lever_arm) - flow)
        speed = np.linalg.norm(true, axis=1)
        stddev = np.hypot(p.noise_stddev, p.noise_per_speed * speed)
        velocity = (1.0 + scale) * true + np.cross([0.0, *a], true)
        velocity += stddev[:, None] * world.stream("log.noise").standard_normal((count, 3))
        wrong, size = world.outliers("log.outlier", p.outlier_share, p.outlier_span, "log", count)
        direction = world.stream("log.outlier_direction").standard_normal((count, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        velocity += np.where(wrong, size, 0.0)[:, None] * direction
        lost = within(t.time[index], p.lost_start, p.lost_duration, p.lost_period)
        if p.lost != "silent":
            velocity[lost] = math.nan if p.lost == "nan" else 0.0
            lost[:] = False
        a_y, a_z = a.tolist()
        east, north = current.tolist()
        kept = ~lost
        stamps_ns = world.stamps_ns[index][kept]
        return {
            cls.TOPIC: LogReadings(
                stamps_ns, velocity[kept], stddev[kept], scale, (a_y, a_z), (east, north), cls.MESSAGE_TYPES[0]
            )
        }
