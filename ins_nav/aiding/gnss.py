"""GNSS position: latitude, longitude and height of an antenna.

Its error may change slowly (own states) besides being white: reflections, the atmosphere.
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
from ins_nav.aiding.fields import read_fix
from ins_nav.aiding.geometry import enu_covariance_on_n, first_rows, from_earth, set_turned
from ins_nav.alignment.initial_position import Place
from ins_nav.config.declaration import parameter
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


class Gnss(Aid[GnssParameters]):
    """Position of an antenna; own states: the slow error on n, m, three or none."""

    NAME = "gnss"
    TOPIC = "gnss/fix"
    MESSAGE_TYPES = ("sensor_msgs/msg/NavSatFix",)
    TEXT = "position; covariance type 0: `gnss.default_stddev`; status below 0: no fix"
    PARAMETERS = GnssParameters
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
