"""Depth below the water's surface; the height of the surface is a state of the filter unless it is known exactly."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

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
from ins_nav.aiding.fields import no_measurement
from ins_nav.aiding.geometry import set_turned
from ins_nav.aiding.simulated import UNKNOWN, MakeMessage, Messages, Readings, Stamps, World, header, rows, within
from ins_nav.config.declaration import Section, parameter
from ins_nav.estimation.error_model import Array, Vector
from ins_nav.estimation.observation import Measurement, Solution
from ins_nav.estimation.slow_state import SlowState
from ins_nav.estimation.state_layout import HEIGHT, SIZE
from ins_nav.mechanization.attitude import rotate
from ins_nav.stamps import stamp_of

_UNKNOWN = 1e3
"""m: sigma of the surface's height where it is not given."""


@dataclass(frozen=True)
class DepthParameters(AidParameters):
    """Parameters ``depth.*``."""

    default_stddev: float = declare_default_stddev(0.1, "m")
    min_stddev: float = declare_min_stddev(0.005, "m")
    lever_arm: Vector = declare_lever_arm("depth gauge")
    surface_height: float = parameter(
        math.nan,
        "ellipsoidal height of the water's surface; not given: estimated from height and depth together",
        unit="m",
        low=-500.0,
        high=9000.0,
    )
    surface_stddev: float = parameter(0.0, "uncertainty of that height where it is given", unit="m", low=0.0, high=1e3)


@dataclass(frozen=True)
class SimulatedGauge(Section):
    """Parameters of a simulated gauge, in its unit."""

    rate: float = parameter(0.0, "readings a second; 0: none", unit="Hz", low=0.0, high=100.0)
    lever_arm: Vector = parameter([0.0, 0.0, 0.0], "gauge from the IMU: forward, left, up", unit="m")
    noise_stddev: float = parameter(0.05, "white noise", low=0.0)
    bias: float = parameter(0.0, "constant error of its readings")
    bias_stddev: float = parameter(0.0, "the same, drawn once a run and added", low=0.0)
    fault_start: float = parameter(0.0, "start of a fault", unit="s", low=0.0)
    fault_duration: float = parameter(0.0, "duration of the fault; 0: none", unit="s", low=0.0)
    fault_offset: float = parameter(0.0, "additional error during the fault")


@dataclass(frozen=True)
class SimulatedDepth(SimulatedGauge):
    """Parameters ``depth.*`` of a simulation, m."""

    surface_height: float = parameter(0.0, "ellipsoidal height of the water's mean surface", unit="m")


@dataclass(frozen=True)
class GaugeReadings:
    """Of a gauge, m of them: depth below the mean surface, m, down positive, or absolute pressure, Pa."""

    stamps_ns: Stamps
    value: Array
    """(m,)."""
    stddev: float
    """Of the noise."""
    bias: float
    """Given and drawn."""
    message_type: str
    message: Callable[[MakeMessage, int, float, float], Any]
    """From stamp, value and variance."""

    def messages(self, make: MakeMessage) -> Messages:
        for stamp, value in rows(self.stamps_ns, self.value):
            yield stamp, self.message(make, stamp, value, self.stddev**2)


def simulated_depth(world: World) -> SimulatedDepth:
    """Parameters of the simulated gauge, and the water's surface."""
    return world.section(SimulatedDepth, Depth.NAME)


def simulated_gauge(
    world: World, name: str, gauge: SimulatedGauge, per_metre: float, at_surface: float
) -> tuple[Stamps, Array, float]:
    """Stamps, values and bias of a gauge, from its units a metre of depth and its reading at the surface."""
    index = world.instants(gauge.rate, f"{name}.rate")
    bias = gauge.bias + gauge.bias_stddev * float(world.stream(f"{name}.bias").standard_normal())
    depth = simulated_depth(world).surface_height - world.height(index, gauge.lever_arm)
    noise = gauge.noise_stddev * world.stream(f"{name}.noise").standard_normal(len(index))
    value = at_surface + per_metre * depth + bias + noise
    value[within(world.truth.time[index], gauge.fault_start, gauge.fault_duration)] += gauge.fault_offset
    return world.stamps_ns[index], value, bias


def depth_message(make: MakeMessage, stamp_ns: int, depth: float, variance: float = 0.0) -> Any:
    """geometry_msgs/PoseWithCovarianceStamped of a depth, m, down positive, and its variance, m²; 0: unknown."""
    msg = make("geometry_msgs/msg/PoseWithCovarianceStamped", header=header(make, stamp_ns, "water_surface"))
    msg.pose.pose.position.z = -depth
    msg.pose.pose.orientation.w = 1.0
    msg.pose.covariance = np.diag([UNKNOWN, UNKNOWN, variance, UNKNOWN, UNKNOWN, UNKNOWN]).ravel()
    return msg


P = TypeVar("P", bound=AidParameters)


class DepthAid(Aid[P]):
    """A gauge of depth; its state is the height of the water's surface, m, unless that is known exactly.

    Parameters
    ----------
    parameters : AidParameters
    surface_height : float
        Ellipsoidal, m; NaN: the first measurement gives it.
    surface_stddev : float
        m.
    """

    def __init__(self, parameters: P, surface_height: float, surface_stddev: float) -> None:
        super().__init__(parameters)
        self._surface = surface_height
        stddev = _UNKNOWN if math.isnan(surface_height) else surface_stddev
        self.states = (SlowState(stddev),) if stddev > 0.0 else ()

    def depth(self, solution: Solution, observation: Observation) -> tuple[float, float]:
        """Depth, m, down positive, and its variance, m²."""
        return observation.value[0], float(observation.covariance[0, 0])

    def measure(self, solution: Solution, own: OwnStates, observation: Observation) -> Measurement:
        depth, variance = self.depth(solution, observation)
        arm = rotate(solution.state[0:4], *self.parameters.lever_arm)
        height = solution.state[11] + arm[2]
        if math.isnan(self._surface):
            self._surface = height + depth
        surface = self._surface + float(own.values.sum())
        h: Array = np.zeros((3, SIZE))
        h[HEIGHT, HEIGHT] = 1.0
        set_turned(h, arm)
        z, r = np.array([height - surface + depth]), np.array([[variance]])
        if self.states:  # a long contradiction: the surface has moved
            return Measurement(z, h[2:], r, None, np.array([[-1.0]]))
        return Measurement(z, h[2:], r, slice(HEIGHT, HEIGHT + 1))


class Depth(DepthAid[DepthParameters]):
    """Depth as computed by the gauge."""

    NAME = "depth"
    TOPIC = "depth"
    MESSAGE_TYPES = ("geometry_msgs/msg/PoseWithCovarianceStamped",)
    TEXT = "`position.z = -depth`, m, its variance in `covariance[14]`"
    PARAMETERS = DepthParameters
    SIMULATED = ("depth", SimulatedDepth)

    def __init__(self, parameters: DepthParameters) -> None:
        super().__init__(parameters, parameters.surface_height, parameters.surface_stddev)

    def read(self, message: Any) -> Reading:
        depth = -float(message.pose.pose.position.z)
        if not math.isfinite(depth):
            raise no_measurement((depth,))
        return Reading((depth,), (float(message.pose.covariance[14]),), stamp_of(message))

    @classmethod
    def simulate(cls, world: World) -> dict[str, Readings]:
        gauge = simulated_depth(world)
        stamps_ns, value, bias = simulated_gauge(world, cls.NAME, gauge, 1.0, 0.0)
        readings = GaugeReadings(stamps_ns, value, gauge.noise_stddev, bias, cls.MESSAGE_TYPES[0], depth_message)
        return {cls.TOPIC: readings}
