"""WGS-84 Earth: shape, rotation and normal gravity.

Every function works on floats (the live tick), on numpy arrays and inside numba. Latitude enters through
its sine, which the mechanization has at hand at any latitude, poles included.

References
----------
.. [1] P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems",
       2nd edition, Artech House, 2013, chapter 2.
.. [2] NIMA TR8350.2, "Department of Defense World Geodetic System 1984", 3rd edition.
"""

import math
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Number = TypeVar("Number", float, NDArray[np.float64])

RATE = 7.292115e-5
"""Rotation rate, rad/s."""
SEMI_MAJOR_AXIS = 6378137.0
"""Equatorial radius, m."""
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)
EQUATORIAL_GRAVITY = 9.7803253359
"""Normal gravity on the ellipsoid at the equator, m/s²."""
POLAR_GRAVITY = 9.8321849378
"""Normal gravity on the ellipsoid at the poles, m/s²."""
SOMIGLIANA = (1.0 - FLATTENING) * POLAR_GRAVITY / EQUATORIAL_GRAVITY - 1.0
"""Constant k of Somigliana's formula."""
GM = 3.986004418e14
"""Geocentric gravitational constant, m³/s²."""
CENTRIFUGAL_RATIO = RATE**2 * SEMI_MAJOR_AXIS**3 * (1.0 - FLATTENING) / GM
"""m = Ω² a² b / GM of [2]_: centrifugal over gravitational acceleration at the equator."""
WATER_GRADIENT = 4.0 * math.pi * 6.674e-11 * 1027.0
"""What a layer of sea water takes off the gradient of gravity, 4 pi G times its density, 1/s² ([3]_, 3.5)."""
NO_WATER = -1e9
"""m: no vehicle is below a surface at this height."""
NORTH_GRAVITY_PER_METRE = -8.08e-9
"""North component of normal gravity, per metre of height and per sin 2φ, 1/s² ([1]_, 2.140)."""


def principal_radii(sin_lat: Number) -> tuple[Number, Number]:
    """Radii of curvature of the ellipsoid.

    Parameters
    ----------
    sin_lat : float or ndarray
        Sine of geodetic latitude.

    Returns
    -------
    meridian, prime_vertical : float or ndarray
        Radii of the meridian (R_N of the alignment paper) and of the prime vertical (R_E), m ([1]_, 2.105-106).
    """
    x = 1.0 - ECCENTRICITY_SQUARED * sin_lat * sin_lat
    prime_vertical = SEMI_MAJOR_AXIS / x**0.5
    return prime_vertical * (1.0 - ECCENTRICITY_SQUARED) / x, prime_vertical


def normal_gravity(sin_lat: Number, height: Number, water_surface: float = NO_WATER) -> Number:
    """Magnitude of normal gravity along the vertical, m/s².

    Somigliana's formula on the ellipsoid, second-order series in height ([2]_, 4-3; [1]_, 2.134 and 2.139). Below the
    surface of water the layer above attracts upwards instead of downwards (reduction of Poincaré and Prey, [3]_, 3.5):
    gravity grows by 2.22e-6 instead of 3.09e-6 m/s² a metre.

    Parameters
    ----------
    sin_lat : float or ndarray
        Sine of geodetic latitude.
    height : float or ndarray
        Ellipsoidal height, m.
    water_surface : float
        Ellipsoidal height, m, below which there is water; `NO_WATER`: air.
    """
    s2 = sin_lat * sin_lat
    on_ellipsoid: Number = EQUATORIAL_GRAVITY * (1.0 + SOMIGLIANA * s2) / (1.0 - ECCENTRICITY_SQUARED * s2) ** 0.5
    h = height / SEMI_MAJOR_AXIS
    linear = 2.0 * (1.0 + FLATTENING + CENTRIFUGAL_RATIO - 2.0 * FLATTENING * s2)
    in_air = on_ellipsoid * (1.0 - linear * h + 3.0 * h * h)
    return in_air - WATER_GRADIENT * 0.5 * (water_surface - height + abs(water_surface - height))


def known_surface(height: float) -> float:
    """Height of a water surface, m; `NO_WATER` where it is not given (NaN)."""
    return NO_WATER if math.isnan(height) else height


def geodetic_to_ecef(lat: ArrayLike, lon: ArrayLike, height: ArrayLike) -> NDArray[np.float64]:
    """Cartesian Earth-fixed position, m, shape (..., 3), from latitude and longitude, rad, and height, m."""
    lat, lon, height = np.asarray(lat, float), np.asarray(lon, float), np.asarray(height, float)
    _, prime_vertical = principal_radii(np.sin(lat))
    radius = (prime_vertical + height) * np.cos(lat)
    return np.stack(
        [
            radius * np.cos(lon),
            radius * np.sin(lon),
            (prime_vertical * (1.0 - ECCENTRICITY_SQUARED) + height) * np.sin(lat),
        ],
        axis=-1,
    )


def enu_axes(lat: float, lon: float) -> NDArray[np.float64]:
    """Matrix ``rot_eg``, shape (3, 3): its columns are east, north and up at (lat, lon), rad, on Earth-fixed axes."""
    sl, cl, so, co = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    return np.array([[-so, -sl * co, cl * co], [co, -sl * so, cl * so], [0.0, cl, sl]])
