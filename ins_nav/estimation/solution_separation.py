"""Solution separation: filters beside the main one that each leave out one source, and what they bound.

For each source of measurements (an aid, stops) a second filter processes everything but that source. It has the
propagation and the solution of the main filter in common, and an error estimate and covariance of its own. Two uses
([1]_):

* The difference of the two solutions is what the source has done. Its covariance is that of the second filter less that
  of the main one ([2]_), so a difference beyond its limit says that the source contradicts the rest.
* Where the source is at fault, the second filter is right: the error of the main solution is at most the difference
  plus the second filter's own error. The greatest of these sums is the protection level.

References
----------
.. [1] J. Blanch, T. Walter, P. Enge et al., "Baseline Advanced RAIM User Algorithm and Possible Improvements", IEEE
       Transactions on Aerospace and Electronic Systems, 2015, vol. 51, no. 1.
.. [2] R. G. Brown, P. W. McBurney, "Self-Contained GPS Integrity Check Using Maximum Solution Separation", Navigation,
       1988, vol. 35, no. 1.
"""

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2, norm

from ins_nav.estimation.error_filter import ErrorFilter
from ins_nav.estimation.error_model import Array
from ins_nav.estimation.innovation_gate import square
from ins_nav.estimation.observation import Measurement
from ins_nav.estimation.state_layout import COSINE, HEADING, HEIGHT, HORIZONTAL_POSITION, POSITION

RISK = 1e-5
"""Probability, at any time, that an error exceeds its protection level."""
FAULTY = 1e-3
"""Probability, at any time, that a given source is at fault."""
_FALSE_ALARM = 1e-7
"""Of a test of separation. Successive tests are correlated over the time in which a source determines the solution, so
one false alarm is expected in more than 1e7 of these times."""
_COVERED = 9.0
"""Squared sigmas of an axis of the main solution within which a separation is none of consequence."""
_RENEWAL_NS = 60_000_000_000
"""ns: a filter that has lost the accuracy of the main one is replaced by one so old: a fault is found, or over, within
that time."""
_USELESS = 10.0
"""Sigma of position, over that of the main filter, beyond which a filter does not observe faults of its source."""


class ProtectionLevel(NamedTuple):
    """Bounds of the errors of the solution while at most one source is at fault.

    Exceeded with the probability `RISK`, where a source is at fault with the probability `FAULTY`, and its fault has
    begun at most `_RENEWAL_NS` ago, or at any time where other sources determine the position, or without effect.

    Attributes
    ----------
    horizontal, height : float
        m.
    heading : float
        rad, at most pi.
    sources : 3 strings
        The source whose fault would be worst for each; empty where that is chance alone.
    """

    horizontal: float
    height: float
    heading: float
    sources: tuple[str, str, str]


class Contradiction(NamedTuple):
    """A source that contradicts the rest, by more than sigma of the solution covers.

    Attributes
    ----------
    source : str
    separation : float
        Horizontal distance of the solutions with it and without it, m.
    height : float
        Their difference in height, m.
    ratio : float
        Normalized square over its limit, above 1.
    """

    source: str
    separation: float
    height: float
    ratio: float


@dataclass
class _Without:
    """A filter that leaves out a source, and one that will replace it."""

    filter: ErrorFilter
    began_ns: int
    next: ErrorFilter | None = None
    next_ns: int = 0

    @property
    def filters(self) -> list[ErrorFilter]:
        return [self.filter] if self.next is None else [self.filter, self.next]


class SolutionSeparation:
    """The filters without a source each.

    Parameters
    ----------
    main : ErrorFilter
    """

    def __init__(self, main: ErrorFilter) -> None:
        self._main = main
        self._without: dict[str, _Without] = {}

    @property
    def filters(self) -> list[ErrorFilter]:
        """Beside the main one: they propagate and follow as it does."""
        return [each for one in self._without.values() for each in one.filters]

    @property
    def sources(self) -> tuple[str, ...]:
        """Those that are left out by one of the filters each."""
        return tuple(self._without)

    def reset(self) -> None:
        """The main filter has been replaced: sources are left out anew."""
        self._without.clear()

    def begin(self, source: str, stamp_ns: int) -> None:
        """Before the main filter processes a measurement: the source is left out from here on, unless it was before."""
        if source not in self._without:
            self._without[source] = _Without(copy.copy(self._main), stamp_ns)

    def update(self, source: str, measurement: Measurement, h: Array, r: Array, gate: float) -> None:
        """Update the filters that use the source, before the main one feeds back its estimate.

        Parameters
        ----------
        source : str
        measurement : Measurement
        h : ndarray, shape (m, n)
            `ErrorFilter.design`.
        r : ndarray, shape (m, m)
            Covariance of its noise.
        gate : float
            Greatest normalized square that a filter accepts.
        """
        for left_out, one in self._without.items():
            for each in one.filters if left_out != source else ():
                residual = measurement.innovation - h @ each.x
                if square(residual, h @ each.p @ h.T + r) <= gate:
                    each.correct(h, r, residual)

    def renew(self, stamp_ns: int) -> None:
        """Replace filters that no longer observe faults of the source which they leave out."""
        variance = _horizontal_variance(self._main.p)
        for source, one in self._without.items():
            if _horizontal_variance(one.filter.p) < _USELESS**2 * variance or self._contradiction(source) is not None:
                one.next = None
            elif one.next is None:
                if stamp_ns - one.began_ns >= _RENEWAL_NS:
                    one.next, one.next_ns = copy.copy(self._main), stamp_ns
            elif stamp_ns - one.next_ns >= _RENEWAL_NS:
                self._without[source] = _Without(one.next, one.next_ns)

    def contradictions(self) -> list[Contradiction]:
        """Sources that contradict the rest."""
        found = (self._contradiction(source) for source in self._without)
        return [each for each in found if each is not None]

    def _contradiction(self, source: str) -> Contradiction | None:
        other, main = self._without[source].filter, self._main
        separation = other.x[POSITION] - main.x[POSITION]
        covariance = other.p[POSITION, POSITION] - main.p[POSITION, POSITION]
        # a direction in which the source adds nothing has no separation
        values, vectors = np.linalg.eigh(covariance)
        along = vectors.T @ separation
        known = values > 1e-6 * other.p[POSITION, POSITION].trace()
        if not known.any():
            return None
        ratio = float((along[known] ** 2 / values[known]).sum() / chi2.isf(_FALSE_ALARM, int(known.sum())))
        if ratio <= 1.0 or square(separation, main.p[POSITION, POSITION]) <= _COVERED * len(separation):
            return None
        return Contradiction(source, math.hypot(*separation[HORIZONTAL_POSITION]), float(separation[HEIGHT]), ratio)

    def protection_level(self, further: Mapping[str, tuple[ErrorFilter, float]]) -> ProtectionLevel:
        """Bounds of the errors at present.

        Parameters
        ----------
        further : mapping of name to (ErrorFilter, float)
            Filters of other hypotheses, with their probabilities.
        """
        main = self._main
        hypotheses = {source: (one.filter, FAULTY) for source, one in self._without.items()} | dict(further)
        levels, sources = _levels(main, main, 0.5 * RISK), ["", "", ""]
        share = 0.5 * RISK / max(1, len(hypotheses))
        for name, (each, probability) in hypotheses.items():
            if probability > share:
                for i, level in enumerate(_levels(main, each, share / probability)):
                    if level > levels[i]:
                        levels[i], sources[i] = level, name
        a, b, c = sources
        return ProtectionLevel(levels[0], levels[1], min(math.pi, levels[2]), (a, b, c))


def _horizontal_variance(p: Array) -> float:
    return float(p[HORIZONTAL_POSITION, HORIZONTAL_POSITION].trace())


def _levels(main: ErrorFilter, other: ErrorFilter, probability: float) -> list[float]:
    """Bounds of the error of the main solution where the other one is right, m, m, rad.

    Horizontal: the greatest sigma of any direction, and Rayleigh's distribution.
    """
    error = other.x - main.x
    horizontal = other.p[HORIZONTAL_POSITION, HORIZONTAL_POSITION]
    greatest = math.sqrt(float(np.linalg.eigvalsh(horizontal)[-1]))
    factor = float(norm.isf(0.5 * probability))
    turn = _heading(other) - _heading(main)
    return [
        math.hypot(*error[HORIZONTAL_POSITION]) + math.sqrt(-2.0 * math.log(probability)) * greatest,
        abs(float(error[HEIGHT])) + factor * math.sqrt(float(other.p[HEIGHT, HEIGHT])),
        abs(math.remainder(turn, math.tau)) + factor * other.heading_stddev,
    ]


def _heading(each: ErrorFilter) -> float:
    """Estimated error of heading, rad."""
    if each.p[COSINE, COSINE] > 0.0:
        return math.atan2(each.x[HEADING], 1.0 - each.x[COSINE])
    return float(each.x[HEADING])
