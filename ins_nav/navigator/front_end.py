"""Everything before navigation, once in a process: IMU stream, mounting, stop detection, coarse alignment.

`FrontEnd` turns messages of an IMU into samples on base_link's axes and finds the first attitude. What comes after
alignment is the business of its listeners: the real-time and the delayed navigator hold one `FrontEnd` together.
"""

import enum
import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ins_nav.alignment.coarse_alignment import Alignment, AlignmentError, CoarseAlignment
from ins_nav.alignment.gravity_cone import GravityCone
from ins_nav.alignment.handover import after_alignment
from ins_nav.alignment.initial_position import InitialPosition, Place
from ins_nav.config.configuration import Configuration
from ins_nav.config.state_file import Pose
from ins_nav.estimation.covariance_propagation import imu_errors
from ins_nav.estimation.error_model import Vector
from ins_nav.estimation.state_layout import HEADING, HEIGHT, HORIZONTAL_POSITION
from ins_nav.event_log import ERROR, INFO, WARN, EventLog
from ins_nav.mechanization import attitude, nav_state
from ins_nav.mechanization.attitude import Quaternion, rotate
from ins_nav.mechanization.compiled import compiled
from ins_nav.mechanization.earth import known_surface
from ins_nav.mechanization.imu_condition import ImuCondition
from ins_nav.mechanization.imu_monitor import ImuMonitor
from ins_nav.mechanization.imu_stream import ImuStream
from ins_nav.mechanization.nav_state import MapFrame, NavState
from ins_nav.mechanization.stamped_rows import StampedRows, Stamps
from ins_nav.mechanization.strapdown import SAMPLE_SIZE, Sample, sample_of, without_bias
from ins_nav.stop_detection.detector import Change, StopDetector
from ins_nav.stop_detection.stop_limits import StopLimits

Array = NDArray[np.float64]

_COARSE_GAP = 0.1
"""s: a longer gap loses the attitude of a rocking base: coarse alignment starts again, and the filter widens."""
_UPSIDE_DOWN = math.radians(120.0)
"""rad: no carrier stands with a larger roll; it is the mounting, or the sign of specific force."""


_ROUNDING_NS = 1_000
"""ns: more than the rounding of a sum of intervals."""


class Phase(enum.Enum):
    """Phase of navigation."""

    WAITING = "waiting"
    COARSE = "coarse"
    FINE = "fine"
    NAVIGATING = "navigating"


class Biases(NamedTuple):
    """Sensor biases on base_link's axes: rad/s, m/s², and the covariance of the six, shape (6, 6)."""

    gyro: Vector
    accel: Vector
    covariance: Array


class Aligned(NamedTuple):
    """The first solution after coarse alignment.

    Attributes
    ----------
    stamp_ns : int
    raw : Sample
        The sample at the stamp, on base_link's axes, biases not removed.
    state : NavState
        On axes n that are east-north-up.
    biases : Biases
        Removed during alignment.
    covariance : ndarray, shape (15, 15)
        Of the errors (`ins_nav.estimation.error_model`).
    noise : 2 floats
        White noise of gyros and accelerometers, rad/√s and m/s/√s.
    cone : GravityCone
        The data of alignment.
    heading_given : bool
        Heading comes from a parameter; otherwise alignment found it.
    """

    stamp_ns: int
    raw: Sample
    state: NavState
    biases: Biases
    covariance: Array
    noise: tuple[float, float]
    cone: GravityCone
    heading_given: bool


class Listener(Protocol):
    """A navigator behind the front end."""

    def end(self) -> None:
        """Alignment starts again; there is no solution until `begin`."""

    def begin(self, aligned: Aligned) -> None:
        """Alignment is done."""

    @property
    def due_ns(self) -> int:
        """Samples before this stamp may come in blocks: nothing but their integration depends on them."""

    def advance(self, stamp_ns: int, count: int, change: Change | None) -> None:
        """Process samples after alignment, the newest of `FrontEnd.recent`.

        Parameters
        ----------
        stamp_ns : int
            Of the newest.
        count : int
            Number of them.
        change : Change or None
            A stop that begins or ends, decided with this sample.
        """


class FrontEnd:
    """Stream, mounting, phases, alignment.

    Parameters
    ----------
    configuration : Configuration
    events : EventLog
    last_pose : Pose or None
        Of the last run, from ``state_file``.

    Attributes
    ----------
    listeners : list of Listener
        Called in order.
    phase : Phase
        WAITING, COARSE, or NAVIGATING once alignment is done.
    stamp_ns : int
        Of the last sample; 0 before the first.
    raw : Sample
        The last sample, on base_link's axes, biases not removed.
    biases : Biases
        Removed during alignment.
    restarts : int
        Number of jumps of the stamps.
    aligned_ns : int
        Stamp at which alignment ended; 0 before.
    map : MapFrame or None
        East-north-up at the place of the first alignment since the start or the last restart.
    recent : StampedRows
        The last 12 s and more, a `Sample` a row, on base_link's axes, biases not removed.
    first_ns : int
        Stamp of the first sample since the start or the last restart.
    condition : ImuCondition
        What the monitors of the IMU found.
    """

    def __init__(self, configuration: Configuration, events: EventLog, last_pose: Pose | None = None) -> None:
        imu, initial, alignment = configuration.imu, configuration.initial, configuration.alignment
        self.configuration = configuration
        self.events = events
        self.listeners: list[Listener] = []
        self.instantaneous = imu.instantaneous
        self.vertical = configuration.navigation.vertical_channel
        self.water_surface = known_surface(configuration.navigation.water_surface)
        self.stream = ImuStream(events, imu)
        self.detector = StopDetector(StopLimits.of(configuration.stop, imu))
        mounting = Rotation.from_euler("ZYX", imu.mounting_rpy[::-1])
        x, y, z, w = mounting.as_quat().tolist()
        self._q_mounting = (x, y, z, w) if mounting.magnitude() > 0.0 else None
        self.condition = ImuCondition(mounting.as_matrix())
        self._monitor = ImuMonitor(events)
        self._position = InitialPosition(initial, last_pose, events)
        sigmas = [imu.gyro_bias_stddev] * 3 + [imu.accel_bias_stddev] * 3
        self._given = Biases(imu.gyro_bias, imu.accel_bias, np.diag(np.square(sigmas)))
        self._given_heading = None if math.isnan(initial.heading) else initial.heading
        self.duration = alignment.duration if self._given_heading is None else alignment.level_duration
        self.restarts = 0
        self.recent = StampedRows(SAMPLE_SIZE)
        self._restart()

    def _restart(self) -> None:
        """Before the first sample, and after a jump of the stamps."""
        self.stamp_ns = self.aligned_ns = 0
        self.map: MapFrame | None = None
        self.raw: Sample = (0.0,) * 7
        self.recent.clear()
        self.first_ns = 0
        self.biases = self._given
        self._heading = self._given_heading
        self._heading_stddev = self.configuration.initial.heading_stddev
        self.detector.restart()
        self._monitor.restart()
        self.condition.clear()
        self._position.begin()
        self._start_alignment()

    def _start_alignment(self) -> None:
        self.phase = Phase.COARSE if self.first_ns else Phase.WAITING
        gyro, accel = (math.sqrt(float(self.biases.covariance.diagonal()[i : i + 3].max())) for i in (0, 3))
        self._alignment = CoarseAlignment(self.duration, gyro, accel, self.configuration.alignment.max_speed)
        for listener in self.listeners:
            listener.end()

    @property
    def aligned(self) -> bool:
        """Whether alignment is done."""
        return self.phase is Phase.NAVIGATING

    @property
    def progress(self) -> float:
        """Share of alignment done, 0 to 1."""
        return 1.0 if self.aligned else min(1.0, self._alignment.time / self.duration)

    def align(self, state: NavState | None, biases: Biases | None, covariance: Array | None) -> str:
        """Start alignment again; the result says what happens now.

        A present solution (all three arguments, or none) gives the place, the biases, and, where the heading was
        given at the start, the heading, with its own uncertainty.

        Parameters
        ----------
        state : NavState or None
        biases : Biases or None
        covariance : ndarray, shape (15, 15), or None
        """
        if state is not None and biases is not None and covariance is not None:
            where = nav_state.geodetic(state)
            variances = covariance.diagonal()
            stddev = math.sqrt(float(variances[HORIZONTAL_POSITION].max()))
            up = math.sqrt(float(variances[HEIGHT]))
            self._position.put(Place(where.lat, where.lon, where.height, (stddev, stddev, up)))
            self.biases = biases
            if self._heading is not None:
                self._heading = attitude.heading_from_yaw(attitude.to_euler(where.q_gb)[2])
                self._heading_stddev = math.sqrt(float(variances[HEADING]))
        self._position.renew()
        self._start_alignment()
        return f"alignment started: stand still, or rock without travelling, for {self.duration:g} s"

    def observe_position(self, place: Place, topic: str) -> None:
        """Process a place that an aid measures: during alignment, the first one is used, unless parameters give one.

        Parameters
        ----------
        place : Place
        topic : str
            Of the aid.
        """
        if not self.aligned:
            self._position.observe(place, topic, self.stamp_ns)

    def add_imu(self, stamp_ns: int, wx: float, wy: float, wz: float, fx: float, fy: float, fz: float) -> None:
        """Process one IMU sample on the IMU's axes.

        Parameters
        ----------
        stamp_ns : int
        wx, wy, wz, fx, fy, fz : float
            Angular velocity, rad/s, and specific force, m/s².
        """
        for stamp, item in self.stream.accept(stamp_ns, wx, wy, wz, fx, fy, fz):
            if isinstance(item, float):
                self.restarts += 1
                self._restart()
            else:
                self._advance(stamp, item)

    def add_imu_run(self, stamps: Stamps, values: Array, until_ns: int) -> int:
        """Process the first of a block of IMU samples, as `add_imu` would one after the other.

        Samples go through the compiled functions together as long as nothing else is due: no block of the stop
        detector or of alignment ends, and no listener has more to do than integrate.

        Parameters
        ----------
        stamps : ndarray of int64, shape (n,)
            ns; n is at least 1.
        values : ndarray, shape (n, 6)
            Angular velocity, rad/s, and specific force, m/s², on the IMU's axes.
        until_ns : int
            A sample of this stamp or a later one is processed alone.

        Returns
        -------
        int
            Number of samples processed, at least 1.
        """
        from_imu = self.stream.accept_run(stamps, values, min(until_ns, self._due_ns))
        count = len(from_imu)
        if count == 0:
            self.add_imu(int(stamps[0]), *values[0].tolist())
            return 1
        samples = from_imu if self._q_mounting is None else compiled(_rotated)(self._q_mounting, from_imu)
        before = self._before(samples[0, 0])
        self.stamp_ns = stamp_ns = int(stamps[count - 1])
        self.raw = sample_of(samples[-1])
        self.recent.extend(stamps[:count], samples)
        self.detector.add_run(stamp_ns, from_imu)
        self._monitor.add_run(from_imu)
        if self.aligned:
            for listener in self.listeners:
                listener.advance(stamp_ns, count, None)
        else:
            gyro, accel, _ = self.biases
            unbiased = samples - np.array([0.0, *gyro, *accel])
            self._alignment.add_run(without_bias(before, gyro, accel), unbiased, self.instantaneous)
        return count

    @property
    def _due_ns(self) -> int:
        """Stamp of a sample from which more than sums and integration may depend."""
        due_ns = min(self.detector.due_ns(self.stream.regular), self._monitor.due_ns)
        if self.aligned:
            return min(due_ns, *(listener.due_ns for listener in self.listeners))
        return min(due_ns, self.stamp_ns + int(self._alignment.run_left * 1e9) - _ROUNDING_NS)

    def _before(self, interval: float) -> Sample:
        """The newest sample, as the one before the next, of that interval: the first has none of its own."""
        h, wx, wy, wz, fx, fy, fz = self.raw
        return h or interval, wx, wy, wz, fx, fy, fz

    @property
    def longest_interval(self) -> float:
        """s: attitude on a rocking base does not survive a longer gap."""
        return max(_COARSE_GAP, 2.0 * self.stream.regular)

    def gap_errors(self, before: Sample, raw: Sample) -> tuple[Array, Array]:
        """Errors that a gap may hide, from the changes of rates and forces within its length at other times.

        Parameters
        ----------
        before, raw : Sample
            The last sample before the gap, and the one that ends it.

        Returns
        -------
        turn, speed : ndarray, shape (3,)
            On the body's axes, rad and m/s.
        """
        recent = self.recent
        samples = recent.arrays[0][recent.oldest : recent.size]
        whole = samples[samples[:, 0] <= self.stream.regular, 1:]
        lag = min(max(1, round(raw[0] / float(np.median(samples[:, 0])))), len(whole) // 2)
        changes = np.abs(np.vstack([whole[lag:] - whole[: len(whole) - lag], np.subtract(raw, before)[None, 1:]]))
        errors = 0.5 * raw[0] * changes.max(axis=0)
        return errors[:3], errors[3:]

    def _advance(self, stamp_ns: int, from_imu: Sample) -> None:
        raw = from_imu if self._q_mounting is None else _on_base_link(self._q_mounting, from_imu)
        self.stamp_ns = stamp_ns
        if not self.first_ns:
            self.first_ns, self.raw, self.phase = stamp_ns, raw, Phase.COARSE
            self.recent.append(stamp_ns, raw)
            return
        before = self._before(raw[0])
        self.raw = raw
        self.recent.append(stamp_ns, raw)
        change = self.detector.add(stamp_ns, from_imu)
        if self._monitor.add(stamp_ns, from_imu, self.detector.stopped):
            self._assess()
        if self.aligned:
            for listener in self.listeners:
                listener.advance(stamp_ns, 1, change)
        else:
            self._coarse(stamp_ns, before, raw)

    def _assess(self) -> None:
        """What the monitors of the IMU found in the last second."""
        for hidden in self._monitor.hidden:
            self.condition.add(hidden)
        known = self.configuration.imu.gyro_noise, self.configuration.imu.accel_noise
        gyro, accel = (
            limit if math.isnan(given) else math.inf
            for limit, given in zip(self._monitor.noise_limits, known, strict=True)
        )
        self.condition.noise_limits = gyro, accel

    def _coarse(self, stamp_ns: int, before: Sample, raw: Sample) -> None:
        if raw[0] > self.longest_interval:
            text = f"coarse alignment starts again after a gap of {raw[0]:.3f} s in imu/data_raw"
            self.events.count("alignment restarts", WARN, text, stamp_ns)
            self._position.renew()
            self._start_alignment()
            return
        try:
            gyro, accel, _ = self.biases
            self._alignment.add(without_bias(before, gyro, accel), without_bias(raw, gyro, accel), self.instantaneous)
            if self._alignment.time < self.duration * (1.0 - 1e-9):
                return
            place = self._position.found(stamp_ns)
            if place is None:
                return
            if self._monitor.constant:
                raise AlignmentError(f"{', '.join(self._monitor.constant)} never changes: it is not measured")
            alignment = self._alignment.solve(place.lat, place.height, self._heading, self._heading_stddev)
        except AlignmentError as error:
            self.events.count("alignment restarts", ERROR, f"alignment from imu/data_raw: {error}", stamp_ns)
            self._position.renew()
            self._start_alignment()
            return
        self._begin(stamp_ns, alignment, place)

    def _begin(self, stamp_ns: int, alignment: Alignment, place: Place) -> None:
        east, north, up = alignment.velocity_g
        velocity = (east, north, up if self.vertical else 0.0)
        state = nav_state.initial_state(place.lat, place.lon, place.height, velocity, alignment.q_gb)
        arm = attitude.rotate(alignment.q_gb, *place.lever_arm)
        if any(arm):  # the place is that of an antenna
            state = nav_state.corrected(state, (-arm[0], -arm[1], -arm[2]))
        if self.map is None:  # it stays where it was when alignment is repeated
            where = nav_state.geodetic(state)
            self.map = MapFrame(where.lat, where.lon, where.height)
        self.aligned_ns = stamp_ns
        self.phase = Phase.NAVIGATING
        self._report(alignment)
        aligned = Aligned(
            stamp_ns,
            self.raw,
            state,
            self.biases,
            after_alignment(alignment, state, place.stddev, arm, imu_errors(self.configuration)),
            (alignment.gyro_noise, alignment.accel_noise),
            self._alignment.cone,
            self._heading is not None,
        )
        for listener in self.listeners:
            listener.begin(aligned)

    def _report(self, alignment: Alignment) -> None:
        roll, pitch, yaw = attitude.to_euler(alignment.q_gb)
        heading = math.degrees(attitude.heading_from_yaw(yaw))
        sigma = "given" if self._heading is not None else f"sigma {math.degrees(alignment.heading_stddev):.3f}°"
        level = math.degrees(math.sqrt(max(alignment.covariance[0, 0], alignment.covariance[1, 1])))
        self.events.report(
            INFO,
            f"aligned in {self._alignment.time:.1f} s: heading {heading:.3f}° ({sigma}), roll "
            f"{math.degrees(roll):.3f}°, pitch {math.degrees(pitch):.3f}° (sigma {level:.4f}°); gravity "
            f"{alignment.gravity_ratio:.6f} of normal; navigating",
        )
        if abs(roll) > _UPSIDE_DOWN:
            text = (
                f"imu/data_raw: base_link is upside down at rest (roll {math.degrees(roll):.0f}°): give "
                "imu.mounting_rpy_deg, or publish linear_acceleration with +9.8 m/s² on the axis that points up "
                "(REP-145)"
            )
            self.events.report(WARN, text)

    def adopt(self, state: NavState, aligned_ns: int) -> None:
        """Skip alignment: another navigator's solution is in use since the stamp."""
        where = nav_state.geodetic(state)
        self.map = self.map or MapFrame(where.lat, where.lon, where.height)
        self.aligned_ns, self.phase = aligned_ns, Phase.NAVIGATING


def _on_base_link(q_mounting: Quaternion, sample: Sample) -> Sample:
    """A sample on the axes of the IMU, turned to those of base_link."""
    h, wx, wy, wz, fx, fy, fz = sample
    wx, wy, wz = rotate(q_mounting, wx, wy, wz)
    fx, fy, fz = rotate(q_mounting, fx, fy, fz)
    return h, wx, wy, wz, fx, fy, fz


def _rotated(q_mounting: Quaternion, samples: Array) -> Array:
    """`_on_base_link` of each row."""
    rotated = np.empty_like(samples)
    for i in range(len(samples)):
        h, wx, wy, wz, fx, fy, fz = samples[i]
        sample = _on_base_link(q_mounting, (h, wx, wy, wz, fx, fy, fz))
        for j in range(len(sample)):
            rotated[i, j] = sample[j]
    return rotated
