"""GNSS position: latitude, longitude and height of an antenna.

Besides white noise its error may have a slow part, which is estimated: reflections, the atmosphere.
"""

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
    slow_error,
)
from ins_nav.aiding.depth import simulated_depth
from ins_nav.aiding.fields import read_fix
from ins_nav.aiding.geometry import enu_covariance_on_n, first_rows, from_earth, set_turned
from ins_nav.aiding.simulated import Fixes, Readings, Stamps, Truth, World, instants, moved, stream
from ins_nav.alignment.initial_position import Place
from ins_nav.config.declaration import Section, parameter
from ins_nav.estimation.error_model import Array, Vector
from ins_nav.estimation.observation import Measurement, Solution
from ins_nav.estimation.state_layout import POSITION, SIZE
from ins_nav.mechanization import nav_state
from ins_nav.mechanization.attitude import rotate
from ins_nav.mechanization.earth import geodetic_to_ecef


@dataclass(frozen=True)
class GnssParameters(AidParameters):
    """Parameters ``gnss.*``."""

    default_stddev: float = declare_default_stddev(3.0, "m")
    min_stddev: float = declare_min_stddev(0.01, "m")
    lever_arm: Vector = declare_lever_arm("antenna")
    slow_stddev: float = parameter(
        0.0, "of an error that changes slowly, each axis; 0: none", unit="m", low=0.0, high=1e3
    )
    slow_time: float = parameter(60.0, "its correlation time", unit="s", low=1.0, high=1e5)


@dataclass(frozen=True)
class SimulatedGnss(Section):
    """Parameters ``gnss.*`` of a simulation."""

    rate: float = parameter(1.0, "fixes a second; 0: none", unit="Hz", low=0.0, high=100.0)
    horizontal_stddev: float = parameter(1.0, "noise of a fix, east and north each", unit="m", low=0.0)
    vertical_stddev: float = parameter(1.5, "noise of a fix, up", unit="m", low=0.0)
    lever_arm: Vector = parameter([0.0, 0.0, 0.0], "antenna from the IMU: forward, left, up", unit="m")
    lost_depth: float = parameter(1e5, "no fixes while the antenna is deeper than this below the surface", unit="m")


@dataclass(frozen=True)
class GnssReceiver:
    """Position fixes with white noise."""

    rate: float = 1.0
    """Fixes a second, 0 for none."""
    horizontal_stddev: float = 1.0
    """East and north, each, m."""
    vertical_stddev: float = 1.5
    """m."""
    lever_arm: Vector = (0.0, 0.0, 0.0)
    """Antenna from the IMU, on body axes, m."""
    lowest: float = -math.inf
    """No fix while the antenna is below this ellipsoidal height: under water, m."""

    def fixes(self, truth: Truth, stamps_ns: Stamps, seed: int) -> Fixes:
        """Fixes at the instants nearest to the receiver's.

        Parameters
        ----------
        truth : Truth
            n + 1 instants, evenly spaced.
        stamps_ns : ndarray, shape (n + 1,)
            Their stamps.
        seed : int
            Not negative.

        Raises
        ------
        InsNavError
            If the receiver is faster than the trajectory.
        """
        index = instants(truth.time, self.rate, "gnss.rate")
        stddev = (self.horizontal_stddev, self.horizontal_stddev, self.vertical_stddev)
        noise = stddev * stream(seed, "gnss.noise").standard_normal((len(index), 3))
        x, y, z, w = truth.q_nb[index].T
        # lever arm turned to east-north-up
        arm = np.array(self.lever_arm)
        vector = np.stack([x, y, z], axis=-1)
        twice = 2.0 * np.cross(vector, arm)
        offset = noise + arm + w[:, None] * twice + np.cross(vector, twice)
        lat, lon, height = moved(truth.lat[index], truth.lon[index], truth.height[index], offset)
        visible = truth.height[index] + (offset - noise)[:, 2] >= self.lowest
        return Fixes(stamps_ns[index][visible], lat[visible], lon[visible], height[visible], stddev)


def simulated_receiver(world: World) -> GnssReceiver:
    """The receiver of a simulation."""
    p = world.section(SimulatedGnss, Gnss.NAME)
    lowest = simulated_depth(world).surface_height - p.lost_depth
    return GnssReceiver(p.rate, p.horizontal_stddev, p.vertical_stddev, p.lever_arm, lowest)


class Gnss(Aid[GnssParameters]):
    """Position of an antenna; states: the slow error on n, m, three or none."""

    NAME = "gnss"
    TOPIC = "gnss/fix"
    MESSAGE_TYPES = ("sensor_msgs/msg/NavSatFix",)
    TEXT = "position; covariance type 0: `gnss.default_stddev`; status below 0: no fix"
    PARAMETERS = GnssParameters
    SIMULATED = ("gnss", SimulatedGnss)
    GIVES_POSITION = True
    MAY_BE_SILENT = True

    def __init__(self, parameters: GnssParameters) -> None:
        super().__init__(parameters)
        if parameters.slow_stddev:
            self.states = (slow_error(parameters.slow_stddev, parameters.slow_time),) * 3

    def read(self, message: Any) -> Reading:
        return read_fix(message)

    def place(self, observation: Observation) -> Place:
        lat, lon, height = observation.value
        east, north, up = np.sqrt(observation.covariance.diagonal()).tolist()
        horizontal = max(east, north)
        return Place(lat, lon, height, (horizontal, horizontal, up), self.parameters.lever_arm)

    def measure(self, solution: Solution, own: OwnStates, observation: Observation) -> Measurement:
        state = solution.state
        lat, lon, height = observation.value
        arm = rotate(state[0:4], *self.parameters.lever_arm)
        horizontal = math.isnan(height)
        if horizontal:
            height = state[11] + arm[2]
        away = np.array(nav_state.position_ecef(state)) - geodetic_to_ecef(lat, lon, height)
        z = np.add(from_earth(state, away), arm)
        z[2] = state[11] + arm[2] - height  # the chord leaves the surface by d² / 2R
        h: Array = np.zeros((3, SIZE))
        h[:, POSITION] = np.eye(3)
        set_turned(h, arm)
        r = enu_covariance_on_n(state, observation.covariance)
        measurement = Measurement(z, h, r, POSITION)
        if self.states:
            measurement = measurement._replace(innovation=z + own.values, own=np.eye(3))
        return first_rows(measurement, 2 if horizontal else 3)

    @classmethod
    def simulate(cls, world: World) -> dict[str, Readings]:
        return {cls.TOPIC: simulated_receiver(world).fixes(world.truth, world.stamps_ns, world.seed)}
