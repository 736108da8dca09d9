"""Scale factors of the gyros: each reads ``1 + s`` times the rate about its axis."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ins_nav.config.declaration import parameter
from ins_nav.estimation.imu_error import READING, Array, ImuError, estimated


@dataclass(frozen=True)
class GyroScale(ImuError):
    """Three states without unit."""

    block: ClassVar[str] = "gyro_scale"
    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    stddev: float = parameter(
        0.0,
        "uncertainty of the gyros' scale factors; 0: they are exact",
        name="gyro_scale_stddev_ppm",
        unit="ppm",
        low=0.0,
        high=1e5,
        scale=1e-6,
    )
    estimated: bool = estimated("gyro_scale_estimated", "the gyros' scale factors")

    def columns(self, reading: Array) -> Array:
        """As of `ImuError.columns`."""
        columns = np.zeros((READING, 3))
        columns[:3] = np.diag(reading[:3])
        return columns
