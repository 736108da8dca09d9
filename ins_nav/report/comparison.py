"""Errors of a result against a reference, at the reference's stamps."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ins_nav.report.series import (
    Array,
    Positions,
    ReportError,
    Stamps,
    Track,
    covered,
    interpolated,
    rotations_at,
)


@dataclass(frozen=True)
class Errors:
    """Result minus reference: stamps (n,), three components (n, 3), and the result's sigmas of them, NaN where it
    gives none."""

    stamps_ns: Stamps
    values: Array
    stddev: Array


@dataclass(frozen=True)
class Comparison:
    """All errors of a result.

    Attributes
    ----------
    position : Errors
        East, north, up, m.
    attitude : Errors or None
        Roll, pitch, heading, rad; None where one of the two has no attitude.
    velocity : Errors or None
        East, north, up, m/s.
    """

    position: Errors
    attitude: Errors | None
    velocity: Errors | None


def compare(result: Track, reference: Track) -> Comparison:
    """Errors of a result wherever reference and result overlap.

    Raises
    ------
    ReportError
        If their positions have no time in common.
    """
    stamps, r = reference.position.stamps_ns, result.position
    common = covered(r.stamps_ns, stamps)
    if not common.any():
        raise ReportError(
            f"{result.name} ({_span(r.stamps_ns)}) has no time in common with {reference.name} ({_span(stamps)})"
        )
    return Comparison(
        _position(r, reference.position, common), _attitude(result, reference), _velocity(result, reference)
    )


def horizontal_offset(ecef: Array, from_ecef: Array, lat: Array | float, lon: Array | float) -> Array:
    """East and north components, (n, 2), m, of the way to Earth-fixed positions, on the axes at (lat, lon), rad."""
    d = ecef - from_ecef
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    outward = cos_lon * d[:, 0] + sin_lon * d[:, 1]
    return np.column_stack([cos_lon * d[:, 1] - sin_lon * d[:, 0], cos_lat * d[:, 2] - sin_lat * outward])


def wrapped(angle: Array) -> Array:
    """Angle in [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def _position(result: Positions, reference: Positions, common: NDArray[np.bool_]) -> Errors:
    at = reference.stamps_ns[common]
    values = np.column_stack([result.ecef, result.height, result.stddev])
    there = interpolated(result.stamps_ns, values, at)
    lat, lon = reference.lat[common], reference.lon[common]
    horizontal = horizontal_offset(there[:, :3], reference.ecef[common], lat, lon)
    # heights are compared directly: far away, the up component would contain the Earth's curvature
    return Errors(at, np.column_stack([horizontal, there[:, 3] - reference.height[common]]), there[:, 4:])


def _attitude(result: Track, reference: Track) -> Errors | None:
    if result.attitude is None or reference.attitude is None:
        return None
    r, truth = result.attitude, reference.attitude
    common = covered(r.stamps_ns, truth.stamps_ns)
    if not common.any():
        return None
    at = truth.stamps_ns[common]
    there = type(r)(at, rotations_at(r, at), np.empty(0))
    return Errors(at, wrapped(there.euler - truth.euler[common]), interpolated(r.stamps_ns, r.stddev, at))


def _velocity(result: Track, reference: Track) -> Errors | None:
    if result.velocity is None or reference.velocity is None:
        return None
    r, truth = result.velocity, reference.velocity
    common = covered(r.stamps_ns, truth.stamps_ns)
    if not common.any():
        return None
    at = truth.stamps_ns[common]
    values = interpolated(r.stamps_ns, r.enu, at) - truth.enu[common]
    return Errors(at, values, np.full(values.shape, np.nan))


def _span(stamps_ns: Stamps) -> str:
    return f"{stamps_ns[0] * 1e-9:.1f} to {stamps_ns[-1] * 1e-9:.1f} s"
