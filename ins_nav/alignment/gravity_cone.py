"""Specific force in inertial space, where gravity describes a cone: on the body's axes of the first sample.

The gyros maintain the body's first attitude b0 through all its motion, so that b0 is fixed in inertial space. There
the specific force of a base at rest on the Earth is gravity's reaction and describes a cone once a day. Its direction
is the vertical, its motion is east ("cone alignment" of the alignment paper, reference [10] there). Rocking averages
out, gravity does not.
"""

import copy
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ins_nav.config.sections import Vector
from ins_nav.mechanization.attitude import Quaternion, from_rotation_vector, multiply, normalized, rotate
from ins_nav.mechanization.compiled import compiled
from ins_nav.mechanization.earth import RATE
from ins_nav.mechanization.strapdown import Sample, increments

Array = NDArray[np.float64]

BLOCKS = 120
"""Blocks in an alignment: enough to separate the noise processes, few enough for dense algebra in 0.1 s."""
MAX_SAMPLES = 100_000
"""Samples stored for the estimation of noise and units: four minutes at 400 Hz, 30 MB."""
_NOISE_TIME = 60.0
"""s: least time of samples for the noise; 5 s at 20 Hz determine it to 10 % only."""
_STRAIGHT_TIME = 600.0
"""s: later the curvature of gravity's path matters; here it amounts to 0.1 m/s of apparent velocity."""


@dataclass(frozen=True)
class Blocks:
    """Means over blocks of time.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Middles of the blocks, s from the start.
    force : ndarray, shape (n, 3)
        Specific force on b0, m/s².
    q_b0b : ndarray, shape (n, 4)
        Body to b0 at the ends of the blocks.
    length, total : float
        Of a block; of the data, with a block not yet complete, s.
    """

    time: Array
    force: Array
    q_b0b: Array
    length: float
    total: float

    def apparent_speed(self) -> float:
        """Largest velocity, m/s, of the specific force that the path of gravity does not explain."""
        basis = np.column_stack([np.ones_like(self.time), self.time])
        if self.total > _STRAIGHT_TIME:
            basis = np.column_stack([basis, 1.0 - np.cos(RATE * self.time)])
        fitted = basis @ np.linalg.lstsq(basis, self.force, rcond=None)[0]
        velocity = np.cumsum(self.force - fitted, axis=0) * self.length
        return float(np.abs(velocity - velocity.mean(axis=0)).max())


def carry(
    q_b0b: Quaternion, velocity: Vector, previous: Sample, sample: Sample, instantaneous: bool
) -> tuple[Quaternion, Vector]:
    """Attitude and the integral of specific force on b0, m/s, after one more sample.

    Parameters
    ----------
    q_b0b : Quaternion
        Body to b0 at the previous sample.
    velocity : 3 floats
        The integral up to the previous sample, m/s.
    previous, sample, instantaneous
        As in `ins_nav.mechanization.strapdown.step`.
    """
    rx, ry, rz, ux, uy, uz = increments(previous, sample, instantaneous)
    ux, uy, uz = rotate(q_b0b, ux, uy, uz)
    vx, vy, vz = velocity
    return normalized(multiply(q_b0b, from_rotation_vector(rx, ry, rz))), (vx + ux, vy + uy, vz + uz)


def _carry_block(
    q_b0b: Quaternion,
    velocity: Vector,
    time: float,
    block_start: float,
    least_length: float,
    keep_until: float,
    previous: Sample,
    samples: Array,
    instantaneous: bool,
) -> tuple[Quaternion, Vector, float, int, int]:
    """`carry` up to the end of a block; the numbers of samples used, and of those to store."""
    kept = count = 0
    while count < len(samples) and time - block_start < least_length:
        h, wx, wy, wz, fx, fy, fz = samples[count]
        sample = h, wx, wy, wz, fx, fy, fz
        count += 1
        if time < keep_until:
            kept = count
        q_b0b, velocity = carry(q_b0b, velocity, previous, sample, instantaneous)
        time += h
        previous = sample
    return q_b0b, velocity, time, count, kept


class GravityCone:
    """Propagates attitude on b0 and averages specific force there.

    Parameters
    ----------
    duration : float
        Intended length of the data, s; sets the length of the blocks, which doubles where the data is longer.

    Attributes
    ----------
    time : float
        Length of the data, s.
    q_b0b : Quaternion
        Body to b0 at the last sample.
    rest : 3 floats
        Integral of specific force on b0 since the last complete block, m/s.
    rest_time : float
        Time since then, s.
    """

    def __init__(self, duration: float) -> None:
        self.duration = duration
        self.time = 0.0
        self.q_b0b: Quaternion = (0.0, 0.0, 0.0, 1.0)
        self.rest: Vector = (0.0, 0.0, 0.0)
        self._block_length = duration / BLOCKS
        self._block_start = 0.0
        self._blocks: list[tuple[float, ...]] = []
        self._keep_until = max(duration, _NOISE_TIME)
        self._samples: list[Sample] = []
        self._first: tuple[Sample, bool] | None = None

    def __len__(self) -> int:
        return len(self._blocks)

    def copy(self) -> "GravityCone":
        """Another with the same data."""
        other = copy.copy(self)
        other._blocks, other._samples = self._blocks.copy(), self._samples.copy()
        return other

    @property
    def rest_time(self) -> float:
        return self.time - self._block_start

    @property
    def block_left(self) -> float:
        """Time until the present block is complete, s."""
        return self._least_length - (self.time - self._block_start)

    @property
    def complete(self) -> bool:
        """Whether all samples of the intended length, and no others, are stored."""
        return self.time <= 1.01 * self.duration and len(self._samples) < MAX_SAMPLES

    def add(self, previous: Sample, sample: Sample, instantaneous: bool) -> bool:
        """Add one sample, as `ins_nav.mechanization.strapdown.step` does; True when a block was completed."""
        if self.time < self._keep_until and len(self._samples) < MAX_SAMPLES:
            self._keep(previous, [sample], instantaneous)
        self.q_b0b, self.rest = compiled(carry)(self.q_b0b, self.rest, previous, sample, instantaneous)
        self.time += sample[0]
        return self._end_block()

    def add_block(self, previous: Sample, samples: Array, instantaneous: bool) -> tuple[int, bool]:
        """Add samples, as `add` would one after the other, up to the end of a block; compiled.

        Parameters
        ----------
        previous : Sample
            Before the first.
        samples : ndarray, shape (n, 7)
            A `Sample` a row.
        instantaneous : bool
            As in `ins_nav.mechanization.strapdown.step`.

        Returns
        -------
        int
            Number of samples added.
        bool
            Whether a block was completed.
        """
        samples = np.ascontiguousarray(samples, dtype=float)
        self.q_b0b, self.rest, self.time, count, kept = compiled(_carry_block)(
            self.q_b0b,
            self.rest,
            self.time,
            self._block_start,
            self._least_length,
            self._keep_until,
            previous,
            samples,
            instantaneous,
        )
        kept = min(kept, MAX_SAMPLES - len(self._samples))
        self._keep(previous, list(map(tuple, samples[:kept].tolist())), instantaneous)
        return count, self._end_block()

    def _keep(self, previous: Sample, samples: list[Sample], instantaneous: bool) -> None:
        if not self._samples:
            self._first = previous, instantaneous
        self._samples += samples

    @property
    def _least_length(self) -> float:
        """Of a complete block, s."""
        return self._block_length * (1.0 - 1e-6)

    def _end_block(self) -> bool:
        """End the block if it is complete; whether it is."""
        length, v = self.time - self._block_start, self.rest
        if length < self._least_length:
            return False
        self._blocks.append(
            (self._block_start + 0.5 * length, length, v[0] / length, v[1] / length, v[2] / length, *self.q_b0b)
        )
        self._block_start = self.time
        self.rest = (0.0, 0.0, 0.0)
        if len(self._blocks) == 2 * BLOCKS:
            self._join_blocks()
        return True

    def _join_blocks(self) -> None:
        """Halve the number of blocks, which bounds memory and time of an alignment that waits for a position."""
        pairs = np.array(self._blocks).reshape(BLOCKS, 2, 9)
        length = pairs[:, :, 1].sum(axis=1)
        joined = (pairs * pairs[:, :, 1:2]).sum(axis=1) / length[:, None]
        joined[:, 1] = length
        joined[:, 5:] = pairs[:, 1, 5:]
        self._blocks = [tuple(block) for block in joined.tolist()]
        self._block_length *= 2.0

    def blocks(self, until: float = math.inf) -> Blocks:
        """The complete blocks so far, at least one; none that ends later than ``until``, s from the start."""
        blocks = np.array([block for block in self._blocks if block[0] + 0.5 * block[1] <= until])
        return Blocks(blocks[:, 0], blocks[:, 2:5], blocks[:, 5:], float(blocks[:, 1].mean()), self.time)

    def noise_limits(self, gravity: float, until: float = math.inf) -> Array:
        """Upper limits of the sensors' white noise: variance of a block mean, and of the walk in a second.

        From the samples up to ``until``, s from the start.

        Second differences of means over 1, 2, 4, ... samples contain white noise and hardly any motion; motion and
        quantization only add to it, so the least of them is the closest.
        """
        samples = np.array(self._samples)
        samples = samples[np.cumsum(samples[:, 0]) <= until]
        interval = float(np.median(samples[:, 0]))
        density, penalty = [], []
        size = 1
        while size == 1 or (size * interval <= 0.25 * self._block_length and len(samples) >= 24 * size):
            n = len(samples) // size
            means = samples[: n * size, 1:].reshape(n, size, 6).mean(axis=1)
            density.append((np.diff(means, 2, axis=0) ** 2).mean(axis=0) / 6.0 * size * interval)
            penalty.append(
                1.0 + 4.0 / math.sqrt(n)
            )  # two sigmas of such a mean square: the least is not chosen by chance
            size *= 2
        least = np.argmin(np.array(density) * np.array(penalty)[:, None], axis=0)
        gyro, accel = np.array(density)[least, np.arange(6)].reshape(2, 3).mean(axis=1)
        return np.array([accel / gravity**2 / self._block_length, gyro])

    def mean_size(self) -> float:
        """Mean magnitude of specific force in the stored samples, m/s²."""
        return float(np.mean([math.hypot(*sample[4:7]) for sample in self._samples]))

    def in_degrees(self) -> Blocks:
        """The blocks with the gyros' output read as degrees per second."""
        assert self._first is not None
        trial = GravityCone(self.duration)
        first, instantaneous = self._first
        previous = _in_degrees(first)
        for sample in map(_in_degrees, self._samples):
            trial.add(previous, sample, instantaneous)
            previous = sample
        return trial.blocks()


def _in_degrees(sample: Sample) -> Sample:
    """The sample with its rates read as degrees per second."""
    h, wx, wy, wz, fx, fy, fz = sample
    return h, math.radians(wx), math.radians(wy), math.radians(wz), fx, fy, fz


def cone_path(lat: float, time: Array) -> Array:
    """The vertical after ``time`` on the axes, fixed in inertial space, that were east, north, up at time 0."""
    s, c, angle = math.sin(lat), math.cos(lat), RATE * time
    return np.column_stack([c * np.sin(angle), c * s * (1.0 - np.cos(angle)), 1.0 - c * c * (1.0 - np.cos(angle))])
