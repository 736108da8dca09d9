"""Misalignments of the accelerometers: each reads a share of the specific force along the two other axes."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ins_nav.config.declaration import ARCSEC, parameter
from ins_nav.estimation.imu_error import READING, Array, ImuError, estimated


@dataclass(frozen=True)
class AccelMisalignment(ImuError):
    """Six angles, rad: all of the matrix but its diagonal.

    The body's axes are given, not defined by those of the accelerometers, so that there are six and not three.
    """

    block: ClassVar[str] = "accel_misalignment"
    components: ClassVar[tuple[str, ...]] = ("x of y", "x of z", "y of x", "y of z", "z of x", "z of y")
    stddev: float = parameter(
        0.0,
        "uncertainty of the directions of the accelerometers' axes, each angle; 0: they are exact",
        name="accel_misalignment_stddev_arcsec",
        unit="arcsec",
        low=0.0,
        high=36000.0,
        scale=ARCSEC,
    )
    estimated: bool = estimated("accel_misalignment_estimated", "the accelerometers' misalignments")

    def columns(self, reading: Array) -> Array:
        """As of `ImuError.columns`."""
        x, y, z = reading[3:]
        columns = np.zeros((READING, 6))
        columns[3, 0:2], columns[4, 2:4], columns[5, 4:6] = (y, z), (x, z), (x, y)
        return columns
