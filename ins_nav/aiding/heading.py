"""Heading from outside: dual antenna, compass, SLAM.

It measures the yaw of its x axis, east-north-up, counter-clockwise from east; the yaw of the mounting, a state, turns
that axis from base_link's x axis. A slow error (deviation of a compass) is a further state.

An unknown heading has its sine and cosine as states (`ins_nav.estimation.error_model`): then the measurement is the
horizontal direction of the x axis, computed less measured, which is linear in them for any error. Once heading is known
it is the angle, so that a reading wrong by half a turn is outside the gate.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ins_nav.aiding.base import Aid, AidParameters, Observation, OwnStates, Reading, Unusable, slow_error
from ins_nav.aiding.fields import no_measurement
from ins_nav.aiding.geometry import set_turned
from ins_nav.aiding.simulated import UNKNOWN, MakeMessage, Messages, Readings, Stamps, World, header, rows, turned
from ins_nav.config.declaration import DEG, Section, parameter
from ins_nav.config.parameters import Value
from ins_nav.estimation.error_model import Array, azimuth
from ins_nav.estimation.observation import Measurement, Solution
from ins_nav.estimation.slow_state import SlowState
from ins_nav.estimation.state_layout import ATTITUDE, COSINE, HEADING, SIZE
from ins_nav.mechanization.attitude import rotate
from ins_nav.stamps import stamp_of

_KNOWN = math.radians(10.0) ** 2
"""Mean square of the heading error, rad², below which it is an angle: its sine is right to 0.5 %."""
_STEEP = math.cos(math.radians(80.0))
"""Horizontal part of the x axis below which it has no heading."""


@dataclass(frozen=True)
class HeadingParameters(AidParameters):
    """Parameters ``heading.*``."""

    default_stddev: float = parameter(0.035, "of a message without covariance", unit="rad", low=1e-6)
    min_stddev: float = parameter(0.002, "smaller sigmas of messages are raised to this", unit="rad", low=1e-6)
    mounting_yaw: float = parameter(
        0.0,
        "yaw of its x axis in base_link",
        name="mounting_yaw_deg",
        unit="deg",
        low=-360.0,
        high=360.0,
        scale=DEG,
    )
    mounting_yaw_stddev: float = parameter(
        0.0,
        "uncertainty of that: a constant error of the heading",
        name="mounting_yaw_stddev_deg",
        unit="deg",
        low=0.0,
        high=45.0,
        scale=DEG,
    )
    slow_stddev: float = parameter(
        0.0,
        "of an error that changes slowly; 0: none",
        name="slow_stddev_deg",
        unit="deg",
        low=0.0,
        high=45.0,
        scale=DEG,
    )
    slow_time: float = parameter(60.0, "its correlation time", unit="s", low=1.0, high=1e5)


@dataclass(frozen=True)
class SimulatedHeading(Section):
    """Parameters ``heading.*`` of a simulation."""

    rate: float = parameter(0.0, "readings a second; 0: none", unit="Hz", low=0.0, high=100.0)
    noise_stddev: float = parameter(
        2.0, "white noise", name="noise_stddev_deg", unit="deg", low=0.0, high=180.0, scale=DEG
    )
    mounting_yaw: float = parameter(
        0.0, "yaw of its x axis on the body's", name="mounting_yaw_deg", unit="deg", scale=DEG
    )


@dataclass(frozen=True)
class HeadingReadings:
    """Of a heading sensor, m of them."""

    stamps_ns: Stamps
    yaw: Array
    """(m,), rad."""
    stddev: float
    """Of the noise, rad."""
    message_type: str

    def messages(self, make: MakeMessage) -> Messages:
        for stamp, yaw in rows(self.stamps_ns, self.yaw):
            yield stamp, heading_message(make, stamp, yaw, self.stddev**2)


def heading_message(make: MakeMessage, stamp_ns: int, yaw: float, variance: float = 0.0) -> Any:
    """sensor_msgs/Imu of a yaw, rad, and its variance, rad²; 0: unknown. Rate and force are not measured (REP-145)."""
    orientation = make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(0.5 * yaw), w=math.cos(0.5 * yaw))
    nothing = np.array([-1.0] + [0.0] * 8)
    return make(
        "sensor_msgs/msg/Imu",
        header=header(make, stamp_ns, "heading_link"),
        orientation=orientation,
        orientation_covariance=np.diag([UNKNOWN, UNKNOWN, variance]).ravel(),
        angular_velocity_covariance=nothing,
        linear_acceleration_covariance=nothing,
    )


class Heading(Aid[HeadingParameters]):
    """Yaw of a sensor's x axis, rad; states: the yaw of its mounting, and the slow error if there is one, rad."""

    NAME = "heading"
    TOPIC = "heading"
    MESSAGE_TYPES = ("sensor_msgs/msg/Imu",)
    TEXT = "yaw of `orientation`, east-north-up, and its variance in `orientation_covariance[8]`, rad²"
    PARAMETERS = HeadingParameters
    SIMULATED = ("heading", SimulatedHeading)
    CALIBRATED = 1
    CALIBRATION = ("heading.mounting_yaw_deg", "heading.mounting_yaw_stddev_deg")

    def __init__(self, parameters: HeadingParameters) -> None:
        super().__init__(parameters)
        mounting = SlowState(parameters.mounting_yaw_stddev, value=parameters.mounting_yaw)
        slow = (slow_error(parameters.slow_stddev, parameters.slow_time),) if parameters.slow_stddev else ()
        self.states = (mounting, *slow)

    def read(self, message: Any) -> Reading:
        if message.orientation_covariance[0] == -1.0:
            raise Unusable("no orientation (orientation_covariance[0] is -1): rejected")
        q = message.orientation
        x, y, z, w = float(q.x), float(q.y), float(q.z), float(q.w)
        north, east = 2.0 * (x * y + w * z), w * w + x * x - y * y - z * z
        if not 0.99 < x * x + y * y + z * z + w * w < 1.01 or math.hypot(north, east) < _STEEP:  # NaN too
            raise no_measurement((x, y, z, w))
        return Reading((math.atan2(north, east),), (float(message.orientation_covariance[8]),), stamp_of(message))

    def measure(self, solution: Solution, own: OwnStates, observation: Observation) -> Measurement | None:
        state, offset = solution.state, float(own.values.sum())
        axis = np.array(rotate(state[0:4], math.cos(offset), math.sin(offset), 0.0))
        left = np.array(rotate(state[0:4], -math.sin(offset), math.cos(offset), 0.0))
        length = math.hypot(axis[0], axis[1])
        if length < _STEEP:
            return None
        computed = axis[:2] / length
        across = np.array([-computed[1], computed[0]])
        h: Array = np.zeros((3, SIZE))
        set_turned(h, axis)
        to_direction = np.outer(across, across) / length
        h[:2, ATTITUDE] = to_direction @ h[:2, ATTITUDE]
        h[:2, COSINE] = computed
        columns = np.outer(to_direction @ left[:2], np.ones(len(self.states)))
        c, s = azimuth(state)
        yaw, variance = observation.value[0], float(observation.covariance[0, 0])
        east, north = math.cos(yaw), math.sin(yaw)
        measured = np.array([c * east + s * north, c * north - s * east])
        if solution.turn < _KNOWN:
            angle = math.atan2(float(-across @ measured), float(computed @ measured))
            direct = slice(HEADING, HEADING + 1)
            return Measurement(
                np.array([angle]), across[None] @ h[:2], np.array([[variance]]), direct, across[None] @ columns
            )
        # a direction whose angle is normal: its mean is shorter, and its length varies with the square
        along, aside = measured, np.array([-measured[1], measured[0]])
        r = variance * np.outer(aside, aside) + 0.5 * variance**2 * np.outer(along, along)
        z = computed - math.exp(0.5 * variance) * measured
        return Measurement(z, h[:2], r, slice(HEADING, HEADING + 1), columns)

    def calibration(self, own: Sequence[tuple[float, float]]) -> dict[str, Value]:
        yaw, stddev = own[0]
        return HeadingParameters.overrides(self.NAME, mounting_yaw=yaw, mounting_yaw_stddev=stddev)

    @classmethod
    def simulate(cls, world: World) -> dict[str, Readings]:
        p = world.section(SimulatedHeading, cls.NAME)
        index = world.instants(p.rate, "heading.rate")
        axis = turned(world.truth.q_nb[index], [math.cos(p.mounting_yaw), math.sin(p.mounting_yaw), 0.0])
        noise = p.noise_stddev * world.stream("heading.noise").standard_normal(len(index))
        yaw = np.arctan2(axis[:, 1], axis[:, 0]) + noise
        return {cls.TOPIC: HeadingReadings(world.stamps_ns[index], yaw, p.noise_stddev, cls.MESSAGE_TYPES[0])}
