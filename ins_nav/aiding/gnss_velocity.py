"""GNSS velocity: that of an antenna on east, north, up."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ins_nav.aiding.base import (
    Aid,
    AidParameters,
    Observation,
    OwnStates,
    Reading,
    declare_default_stddev,
    declare_lever_arm,
    declare_min_stddev,
)
from ins_nav.aiding.fields import no_measurement, read_velocity
from ins_nav.aiding.geometry import cross_matrix, enu_covariance_on_n, first_rows, rate_to_earth, set_turned
from ins_nav.aiding.gnss import simulated_receiver
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
)
from ins_nav.config.declaration import Section, parameter
from ins_nav.estimation.error_model import Array, Vector, azimuth, rotation_matrix
from ins_nav.estimation.observation import Measurement, Solution
from ins_nav.estimation.state_layout import GYRO_BIAS, SIZE, VELOCITY


@dataclass(frozen=True)
class GnssVelocityParameters(AidParameters):
    """Parameters ``gnss_velocity.*``."""

    default_stddev: float = declare_default_stddev(0.2, "m/s")
    min_stddev: float = declare_min_stddev(0.01, "m/s")
    lever_arm: Vector = declare_lever_arm("antenna")


@dataclass(frozen=True)
class SimulatedGnssVelocity(Section):
    """Parameters ``gnss.*`` of a simulation that are of velocities."""

    velocity_rate: float = parameter(0.0, "velocities a second; 0: none", unit="Hz", low=0.0, high=100.0)
    velocity_stddev: float = parameter(0.05, "noise of a velocity, each axis", unit="m/s", low=0.0)


@dataclass(frozen=True)
class VelocityReadings:
    """Velocity of the antenna, m of them."""

    stamps_ns: Stamps
    velocity: Array
    """(m, 3), east, north, up, m/s."""
    stddev: float
    """Each axis, m/s."""
    message_type: str

    def messages(self, make: MakeMessage) -> Messages:
        covariance = isotropic(self.stddev)
        for stamp, velocity in rows(self.stamps_ns, self.velocity):
            yield stamp, velocity_message(make, stamp, velocity, covariance, "gnss_link")


class GnssVelocity(Aid[GnssVelocityParameters]):
    """Velocity of an antenna; no states."""

    NAME = "gnss_velocity"
    TOPIC = "gnss/velocity"
    MESSAGE_TYPES = ("geometry_msgs/msg/TwistWithCovarianceStamped",)
    TEXT = "east, north, up, m/s; up may be NaN"
    PARAMETERS = GnssVelocityParameters
    SIMULATED = ("gnss", SimulatedGnssVelocity)
    MAY_BE_SILENT = True

    def read(self, message: Any) -> Reading:
        reading = read_velocity(message)
        if not all(map(math.isfinite, reading.value[:2])):
            raise no_measurement(reading.value)
        return reading

    def measure(self, solution: Solution, own: OwnStates, observation: Observation) -> Measurement:
        state, arm = solution.state, self.parameters.lever_arm
        rot_nb = rotation_matrix(state[0:4])
        swing = rot_nb @ np.cross(rate_to_earth(solution), arm)
        c, s = azimuth(state)
        east, north, up = observation.value
        horizontal = math.isnan(up)
        if horizontal:
            up = 0.0
        z = np.add(state[4:7], swing) - [c * east + s * north, c * north - s * east, up]
        h: Array = np.zeros((3, SIZE))
        h[:, VELOCITY] = np.eye(3)
        travel = swing + np.multiply(state[4:7], 1.0 if solution.travels else (0.0, 0.0, 1.0))
        set_turned(h, travel)
        h[:, GYRO_BIAS] = rot_nb @ cross_matrix(arm)
        r = enu_covariance_on_n(state, observation.covariance)
        if not solution.travels:
            r[:2, :2] += solution.turn * (state[4] ** 2 + state[5] ** 2) * np.eye(2)
        return first_rows(Measurement(z, h, r, VELOCITY), 2 if horizontal else 3)

    @classmethod
    def simulate(cls, world: World) -> dict[str, Readings]:
        p, receiver = world.section(SimulatedGnssVelocity, "gnss"), simulated_receiver(world)
        index = world.instants(p.velocity_rate, "gnss.velocity_rate")
        noise = p.velocity_stddev * world.stream("gnss.velocity").standard_normal((len(index), 3))
        velocity = turned(world.truth.q_nb[index], world.velocity_body(index, receiver.lever_arm)) + noise
        visible = world.height(index, receiver.lever_arm) >= receiver.lowest
        stamps_ns = world.stamps_ns[index][visible]
        return {cls.TOPIC: VelocityReadings(stamps_ns, velocity[visible], p.velocity_stddev, cls.MESSAGE_TYPES[0])}
