"""Misalignments of the gyros: each reads a share of the rates about the two other axes."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ins_nav.config.declaration import ARCSEC, parameter
from ins_nav.estimation.imu_error import READING, Array, ImuError, estimated


@dataclass(frozen=True)
class GyroMisalignment(ImuError):
    """Six angles, rad: all of the matrix but its diagonal.

    The body's axes are given, not defined by those of the gyros, so that there are six and not three.
    """

    block: ClassVar[str] = "gyro_misalignment"
    components: ClassVar[tuple[str, ...]] = ("x of y", "x of z", "y of x", "y of z", "z of x", "z of y")
    stddev: float = parameter(
        0.0,
        "uncertainty of the directions of the gyros' axes, each angle; 0: they are exact",
        name="gyro_misalignment_stddev_arcsec",
        unit="arcsec",
        low=0.0,
        high=36000.0,
        scale=ARCSEC,
    )
    estimated: bool = estimated("gyro_misalignment_estimated", "the gyros' misalignments")

    def columns(self, reading: Array) -> Array:
        """As of `ImuError.columns`."""
        x, y, z = reading[:3]
        columns = np.zeros((READING, 6))
        columns[0, 0:2], columns[1, 2:4], columns[2, 4:6] = (y, z), (x, z), (x, y)
        return columns
