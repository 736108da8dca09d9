"""Pressure under water: depth by the weight of a column of water of the same density and gravity throughout."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ins_nav.aiding.base import (
    Aid,
    AidParameters,
    Observation,
    Reading,
    declare_default_stddev,
    declare_lever_arm,
    declare_min_stddev,
)
from ins_nav.aiding.depth import (
    Depth,
    DepthAid,
    DepthParameters,
    GaugeReadings,
    SimulatedGauge,
    simulated_depth,
    simulated_gauge,
)
from ins_nav.aiding.fields import no_measurement
from ins_nav.aiding.simulated import MakeMessage, Readings, World, header
from ins_nav.config.declaration import parameter
from ins_nav.config.parameters import Value
from ins_nav.estimation.error_model import Vector
from ins_nav.estimation.observation import Solution
from ins_nav.mechanization import nav_state
from ins_nav.mechanization.earth import normal_gravity
from ins_nav.stamps import stamp_of


@dataclass(frozen=True)
class PressureParameters(AidParameters):
    """Parameters ``pressure.*``; the surface's height is that of `DepthParameters`."""

    default_stddev: float = declare_default_stddev(1000.0, "Pa")
    min_stddev: float = declare_min_stddev(10.0, "Pa")
    lever_arm: Vector = declare_lever_arm("pressure gauge")
    surface_pressure: float = parameter(101325.0, "pressure of the air at the surface", unit="Pa", low=0.0, high=2e5)
    density: float = parameter(
        1025.0, "of the water, mean from the surface to the gauge", unit="kg/m^3", low=500.0, high=2000.0
    )


@dataclass(frozen=True)
class SimulatedPressure(SimulatedGauge):
    """Parameters ``pressure.*`` of a simulation, Pa."""

    noise_stddev: float = parameter(500.0, "white noise", low=0.0)
    density: float = parameter(1025.0, "of the water", unit="kg/m³", low=1.0)
    surface: float = parameter(101_325.0, "at the surface", unit="Pa", low=0.0)


def pressure_message(make: MakeMessage, stamp_ns: int, pressure: float, variance: float = 0.0) -> Any:
    """sensor_msgs/FluidPressure, Pa and Pa²; 0: unknown."""
    return make(
        "sensor_msgs/msg/FluidPressure",
        header=header(make, stamp_ns, "pressure_link"),
        fluid_pressure=pressure,
        variance=variance,
    )


class Pressure(DepthAid[PressureParameters]):
    """Absolute pressure."""

    NAME = "pressure"
    TOPIC = "pressure"
    MESSAGE_TYPES = ("sensor_msgs/msg/FluidPressure",)
    TEXT = "Pa, absolute; `pressure.density`, `pressure.surface_pressure`, `depth.surface_height`"
    PARAMETERS = PressureParameters
    SIMULATED = ("pressure", SimulatedPressure)

    @classmethod
    def create(cls, values: Mapping[str, Value]) -> list[Aid[Any]]:
        surface = DepthParameters.from_values(Depth.NAME, values)
        parameters = PressureParameters.from_values(cls.NAME, values)
        return [cls(parameters, surface.surface_height, surface.surface_stddev)]

    def read(self, message: Any) -> Reading:
        pressure = float(message.fluid_pressure)
        if not (math.isfinite(pressure) and pressure > 0.0):
            raise no_measurement((pressure,))
        return Reading((pressure,), (float(message.variance),), stamp_of(message))

    def depth(self, solution: Solution, observation: Observation) -> tuple[float, float]:
        where = nav_state.geodetic(solution.state)
        weight = self.parameters.density * normal_gravity(math.sin(where.lat), where.height)
        pressure, variance = observation.value[0], float(observation.covariance[0, 0])
        return (pressure - self.parameters.surface_pressure) / weight, variance / weight**2

    @classmethod
    def simulate(cls, world: World) -> dict[str, Readings]:
        gauge, surface = world.section(SimulatedPressure, cls.NAME), simulated_depth(world).surface_height
        # the weight of the water grows by 2e-7 of itself a metre: constant
        weight = gauge.density * float(normal_gravity(math.sin(world.origin[0]), surface))
        stamps_ns, value, bias = simulated_gauge(world, cls.NAME, gauge, weight, gauge.surface)
        readings = GaugeReadings(stamps_ns, value, gauge.noise_stddev, bias, cls.MESSAGE_TYPES[0], pressure_message)
        return {cls.TOPIC: readings}
