"""From IMU samples to a navigation solution: phases, alignment, mechanization.

The one engine of the live node, `ins_process` and the tests. It knows no ROS: messages come as plain numbers,
solutions leave as a `ins_nav.mechanization.strapdown.NavState`.
"""

import enum
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ins_nav.aiding.aid_queue import observe
from ins_nav.aiding.base import Aid, Observation
from ins_nav.aiding.parameters import configuration
from ins_nav.aiding.registry import by_topic, calibration_names, create_aids
from ins_nav.alignment.coarse_alignment import Alignment, AlignmentError, CoarseAlignment
from ins_nav.alignment.handover import after_alignment
from ins_nav.alignment.initial_position import InitialPosition, Place
from ins_nav.config import state_file
from ins_nav.config.parameters import Value
from ins_nav.config.sections import ImuSection
from ins_nav.estimation.covariance_propagation import CovariancePropagation, imu_errors
from ins_nav.estimation.state_layout import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, HEADING, HORIZONTAL_POSITION, POSITION
from ins_nav.event_log import ERROR, INFO, WARN, EventLog
from ins_nav.mechanization import attitude, nav_state, strapdown
from ins_nav.mechanization.imu_stream import ImuStream
from ins_nav.mechanization.replay_buffer import ReplayBuffer
from ins_nav.navigator.correction import Correction, CorrectionQueue
from ins_nav.stop_detection.detector import Change
from ins_nav.zupt.calibration import StopCalibration
from ins_nav.zupt.stop_records import StopCorrection
from ins_nav.zupt.zupt_equations import Calibration, ZuptError

_COARSE_GAP = 0.1
"""s: a longer gap loses the attitude of a rocking base: coarse alignment begins again, and the filter is told."""


class Phase(enum.Enum):
    """Where the navigator is."""

    WAITING = "waiting"
    COARSE = "coarse"
    FINE = "fine"
    NAVIGATING = "navigating"


class RealtimeNavigator:
    """Aligns, then navigates.

    Parameters
    ----------
    overrides : mapping
        Parameters that differ from their defaults, by full name.

    Attributes
    ----------
    configuration : Configuration
        In use.
    phase : Phase
    stamp_ns : int
        Of the last sample taken.
    state : NavState or None
        The solution at ``stamp_ns``; None until navigating.
    angular_velocity, specific_force : 3 floats
        Of the last sample, on base_link's axes, biases removed; rad/s, m/s².
    gyro_bias, accel_bias : 3 floats
        In use, rad/s and m/s².
    accuracy : CovariancePropagation
        Of the solution.
    changes : int
        How many alignments and calibrations there have been.
    restarts : int
        How often the stamps have jumped.
    aligned_ns : int
        Stamp at which alignment ended; 0 before.
    map : MapFrame or None
        East-north-up at the place of the first alignment since the start or the last restart.
    calibration : dict
        Parameters of aids that the filter has calibrated, to be saved.
    position_aids : dict of topic to Aid
        Those whose messages can give the place to align at.
    events : EventLog
    stream : ImuStream
    stops : StopCalibration

    Raises
    ------
    ParameterError
    """

    def __init__(self, overrides: Mapping[str, object] | None = None) -> None:
        self.events = EventLog()
        known, self.calibration, last = state_file.take_up(configuration(overrides), self.events, calibration_names())
        for warning in known.warnings:
            self.events.report(WARN, warning)
        self.configuration = known
        self._place = InitialPosition(known.initial, last, self.events)
        self.position_aids = by_topic({n: a for n, a in create_aids(known.values).items() if a.GIVES_POSITION})
        imu = known.imu
        self.stream = ImuStream(self.events, imu)
        self._instantaneous = imu.instantaneous
        self._vertical = known.navigation.vertical_channel
        mounting = Rotation.from_euler("ZYX", imu.mounting_rpy[::-1])
        self._q_mounting = tuple(map(float, mounting.as_quat())) if mounting.magnitude() > 0.0 else None
        self.gyro_bias, self.accel_bias = imu.gyro_bias, imu.accel_bias
        sought = math.isnan(known.initial.heading)
        self._duration = known.alignment.duration if sought else known.alignment.level_duration
        self.angular_velocity = (0.0, 0.0, 0.0)
        self.specific_force = (0.0, 0.0, 0.0)
        self.stamp_ns = 0
        self.changes = self.restarts = 0
        self.stops = StopCalibration(known, self.events)
        self.accuracy = CovariancePropagation(known)
        self._feedback = CorrectionQueue(self.events)
        self._history = ReplayBuffer(self._instantaneous, self._vertical)
        self._begin()

    def _begin(self) -> None:
        """Before the first sample, and after a restart."""
        self.phase = Phase.WAITING
        self.state: nav_state.NavState | None = None
        self.map: nav_state.MapFrame | None = None
        self.accuracy.restart()
        self._previous: strapdown.Sample | None = None
        self._raw: strapdown.Sample = (0.0,) * 7
        initial, imu = self.configuration.initial, self.configuration.imu
        self._heading = None if math.isnan(initial.heading) else initial.heading
        self._heading_stddev = initial.heading_stddev
        self.gyro_bias = imu.gyro_bias
        self.accel_bias = self.stops.accel_bias = imu.accel_bias
        self.stops.restart()
        self.aligned_ns = 0
        self._place.begin()
        self._feedback.restart()
        self._align()

    def _align(self) -> None:
        self.stops.forget()
        self._history.clear()
        self._feedback.clear()
        self.accuracy.clear()
        gyro_bias_stddev = math.sqrt(float(self.gyro_bias_covariance.diagonal().max()))
        self._alignment = CoarseAlignment(
            self._duration,
            gyro_bias_stddev,
            self.configuration.imu.accel_bias_stddev,
            self.configuration.alignment.max_speed,
        )

    def _is_long_gap(self, sample: strapdown.Sample) -> bool:
        return sample[0] > max(_COARSE_GAP, 2.0 * self.stream.regular)

    def _align_again(self) -> None:
        self._place.renew()
        self._align()

    def align(self) -> str:
        """Start alignment again, at the place of the present solution when there is one; says what happens now.

        A heading that was given is not sought now either: the present solution's is kept.
        """
        if self.state is not None:
            where = nav_state.geodetic(self.state)
            east, north, up = np.sqrt(self._known().diagonal()[POSITION]).tolist()
            stddev = max(east, north)
            self._place.put(Place(where.lat, where.lon, where.height, (stddev, stddev, up)))
            if self._heading is not None:  # given at the start: where it points now is what is known
                self._heading = attitude.heading_from_yaw(attitude.to_euler(where.q_gb)[2])
                self._heading_stddev = math.sqrt(float(self._known()[HEADING, HEADING]))
        self.state = None
        self.phase = Phase.COARSE if self._previous is not None else Phase.WAITING
        self._align_again()
        return f"alignment started: stand still, or rock without travelling, for {self._duration:g} s"

    def zupt1(self) -> tuple[bool, str]:
        """First call at rest: keeps this position; second, at rest after a turn: drifts and azimuth are corrected.

        Returns
        -------
        bool
            Whether it was done.
        str
            What was found, or why not and what to do.
        """
        return self._calibrate("zupt1")

    def zupt2(self) -> tuple[bool, str]:
        """At rest: drifts are corrected, the azimuth trusted; results as of `zupt1`."""
        return self._calibrate("zupt2")

    def save(self) -> tuple[bool, str]:
        """Write ``state_file``; results as of `zupt1`."""
        path = self.configuration.state_file.path
        if not path:
            return False, "no state_file: start the node with a name for it"
        if self.state is None:
            return False, f"no navigation solution yet: {self.phase.value}; call again when navigating"
        where = nav_state.geodetic(self.state)
        heading = math.degrees(attitude.heading_from_yaw(attitude.to_euler(where.q_gb)[2]))
        stddev = math.sqrt(float(self._known().diagonal()[HORIZONTAL_POSITION].max()))
        place = math.degrees(where.lat), math.degrees(where.lon), where.height
        kept: dict[str, Value] = {
            **ImuSection.overrides("imu", gyro_bias=self.gyro_bias, accel_bias=self.accel_bias),
            **self.calibration,
        }
        try:
            state_file.save(path, kept, state_file.Pose(*place, heading, stddev, self.stamp_ns * 1e-9))
        except state_file.StateFileError as error:
            return False, str(error)
        text = f"{', '.join(kept)} and the pose written to {path}"
        self.events.report(INFO, f"save: {text}")
        return True, text

    def _calibrate(self, name: str) -> tuple[bool, str]:
        if self.state is None:
            text = f"no navigation solution yet: {self.phase.value}, {100.0 * self.progress:.0f} % of alignment done"
            return False, f"{text}; call again when navigating"
        service = self.stops.zupt1 if name == "zupt1" else self.stops.zupt2
        try:
            text, correction = (self.stops.left(), None) if self.stops.passive else service(self._history)
        except ZuptError as error:
            self.events.count(f"{name} refused", INFO, f"{name} refused: {error}", self.stamp_ns)
            return False, str(error)
        if self.stops.passive:
            known = np.diag(np.append(self.gyro_bias_covariance.diagonal(), 0.0))
            text += f", which knows {Calibration(np.array(self.gyro_bias), 0.0, known).sentence(False)}"
        elif correction is not None:
            self._correct(correction)
            self.changes += 1
        self.events.report(INFO, f"{name}: {text}")
        return True, text

    def _correct(self, correction: StopCorrection) -> None:
        """Go on from a state of the past, corrected at a stop."""
        accuracy, stops = self.accuracy, self.stops
        accuracy.rewind(correction.stamp_ns, self._history.at(correction.stamp_ns).state)
        if correction.held is not None:
            accuracy.hold(correction.held)
        if correction.calibrated:
            accuracy.calibrate(correction.state, stops.covariance, stops.level_variance)
        self._rerun(correction)

    def _rerun(self, correction: StopCorrection) -> None:
        self.gyro_bias = correction.gyro_bias
        self.state = self._history.rerun(correction.stamp_ns, correction.state, self._without_bias)
        self.accuracy.catch_up(correction.state, self._history)
        self._previous = self._without_bias(self._raw)

    def follow(self, feedback: Correction) -> None:
        """Take what the filter found; it takes effect at its time, or at once where that has passed.

        One that is older than the last, or comes twice, is left out; so is one whose state is not remembered.
        """
        taken = self._feedback.add(feedback, self.stamp_ns)
        if taken and self.state is not None and feedback.apply_ns < self.stamp_ns:
            self.events.count("feedback late", INFO, "ins/feedback: late, taken at once", self.stamp_ns)
            self._go_on()

    def solution(self) -> tuple[Correction, int] | None:
        """The present solution, for a filter that begins later, and the stamp at which alignment ended."""
        if self.state is None:
            return None
        feedback = Correction(
            self.stamp_ns,
            self.stamp_ns,
            self.state,
            self.gyro_bias,  # type: ignore[arg-type]
            self.accel_bias,  # type: ignore[arg-type]
            self._known(),
            self.phase is Phase.NAVIGATING and self._feedback.followed_ns > self.aligned_ns,
        )
        return feedback, self.aligned_ns

    def _go_on(self) -> None:
        """From the newest feedback that is due."""
        taken = self._feedback.take(self.stamp_ns, self._history)
        if taken is None:
            return
        newest, entry = taken
        self.accel_bias = self.stops.accel_bias = newest.accel_bias
        self.accuracy.rewind(entry.stamp_ns, entry.state)
        self.accuracy.take(newest.covariance)
        self.changes += 1
        self.phase = Phase.NAVIGATING if newest.aligned else Phase.FINE
        self._rerun(StopCorrection(entry.stamp_ns, newest.state, newest.gyro_bias))

    def _known(self) -> NDArray[np.float64]:
        """Covariance of the errors (`covariance_propagation.covariance_of`)."""
        return self.accuracy.covariance

    @property
    def covariance(self) -> NDArray[np.float64] | None:
        """Of the errors (`covariance_propagation.covariance_of`) at present; None without a solution."""
        return None if self.state is None else self._known()

    @property
    def attitude_covariance(self) -> NDArray[np.float64]:
        """On n, level but free in azimuth, rad², shape (3, 3)."""
        return self._known()[ATTITUDE, ATTITUDE]

    @property
    def gyro_bias_covariance(self) -> NDArray[np.float64]:
        """rad²/s², shape (3, 3)."""
        return self._known()[GYRO_BIAS, GYRO_BIAS]

    @property
    def accel_bias_covariance(self) -> NDArray[np.float64]:
        """m²/s⁴, shape (3, 3)."""
        return self._known()[ACCEL_BIAS, ACCEL_BIAS]

    @property
    def sample_noise(self) -> tuple[float, float]:
        """Sigmas of the white noise of one sample, rad/s and m/s²; zeros before the first interval.

        Noise density over the root of the interval between samples.
        """
        interval = self._raw[0] if math.isnan(self.stream.nominal) else self.stream.nominal
        if interval == 0.0:
            return 0.0, 0.0
        gyro, accel = self.accuracy.white_noise
        return gyro / math.sqrt(interval), accel / math.sqrt(interval)

    @property
    def progress(self) -> float:
        """Share of the alignment done, 0 to 1."""
        return 1.0 if self.phase is Phase.NAVIGATING else min(1.0, self._alignment.time / self._duration)

    def add(self, topic: str, message: Any) -> None:
        """Add a message of an aid.

        The first that gives a position is the place to align at, unless parameters name one; where alignment had to
        start again, so is the first after that.

        Parameters
        ----------
        topic : str
        message : message
            Of one of the aid's types (`ins_nav.aiding.base.Aid.MESSAGE_TYPES`).
        """
        aid = self.position_aids.get(topic)
        if aid is not None:
            self._align_at(aid, observe(aid, message, self.stamp_ns, self.events))

    def _align_at(self, aid: Aid[Any], observation: Observation | None) -> None:
        if observation is not None and self.state is None:
            self._place.observe(aid.place(observation), aid.topic, self.stamp_ns)

    def add_imu(self, stamp_ns: int, wx: float, wy: float, wz: float, fx: float, fy: float, fz: float) -> bool:
        """Take one IMU sample on the IMU's axes; True when there is a new solution.

        Parameters
        ----------
        stamp_ns : int
        wx, wy, wz, fx, fy, fz : float
            Angular velocity, rad/s, and specific force, m/s².
        """
        new = False
        for stamp, item in self.stream.accept(stamp_ns, wx, wy, wz, fx, fy, fz):
            if isinstance(item, float):
                self.restarts += 1
                self._begin()
            else:
                new = self._take(stamp, item)
        return new

    def _on_base_link(self, sample: strapdown.Sample) -> strapdown.Sample:
        """The sample on base_link's axes."""
        if self._q_mounting is None:
            return sample
        h, wx, wy, wz, fx, fy, fz = sample
        wx, wy, wz = attitude.rotate(self._q_mounting, wx, wy, wz)  # type: ignore[arg-type]
        fx, fy, fz = attitude.rotate(self._q_mounting, fx, fy, fz)  # type: ignore[arg-type]
        return h, wx, wy, wz, fx, fy, fz

    def _without_bias(self, sample: strapdown.Sample) -> strapdown.Sample:
        """The sample, biases removed."""
        h, wx, wy, wz, fx, fy, fz = sample
        gx, gy, gz = self.gyro_bias
        ax, ay, az = self.accel_bias
        return h, wx - gx, wy - gy, wz - gz, fx - ax, fy - ay, fz - az

    def _take(self, stamp_ns: int, from_imu: strapdown.Sample) -> bool:
        previous = self._previous
        self._raw = raw = self._on_base_link(from_imu)
        self._previous = sample = self._without_bias(raw)
        self.stamp_ns = stamp_ns
        self.angular_velocity = sample[1:4]
        self.specific_force = sample[4:7]
        if previous is None:
            self.phase = Phase.COARSE
            return False
        change = self.stops.detect(stamp_ns, from_imu)
        if previous[0] == 0.0:
            previous = (sample[0], *previous[1:])  # type: ignore[assignment]  # the first had no interval of its own
        if self.state is None:
            self._coarse(previous, sample)
            return self.state is not None
        return self._advance(stamp_ns, raw, previous, sample, change)

    def _advance(
        self,
        stamp_ns: int,
        raw: strapdown.Sample,
        previous: strapdown.Sample,
        sample: strapdown.Sample,
        change: Change | None,
    ) -> bool:
        """Navigate over a sample; True when there is a new solution."""
        assert self.state is not None
        self.state = strapdown.step(self.state, previous, sample, self._instantaneous, self._vertical)
        self._history.add(stamp_ns, raw, self.state)
        self.accuracy.advance(stamp_ns, self.state)
        if self._feedback.is_due(stamp_ns):
            self._go_on()
        following = self._feedback.follows(stamp_ns)
        if following != self.stops.passive:
            self.stops.follow(following, self.covariance, self._history, self.gyro_bias)  # type: ignore[arg-type]
        correction = self.stops.advance(change, self._history, stamp_ns, self.gyro_bias)  # type: ignore[arg-type]
        if correction is not None:
            self._correct(correction)
        return True

    def _coarse(self, previous: strapdown.Sample, sample: strapdown.Sample) -> None:
        if self._is_long_gap(sample):
            self.events.count(
                "alignment restarts",
                WARN,
                f"coarse alignment starts again after a gap of {sample[0]:.3f} s in imu/data_raw",
                self.stamp_ns,
            )
            self._align_again()
            return
        try:
            self._alignment.add(previous, sample, self._instantaneous)
            if self._alignment.time < self._duration * (1.0 - 1e-9):
                return
            place = self._place.found(self.stamp_ns)
            if place is None:
                return
            alignment = self._alignment.solve(place.lat, place.height, self._heading, self._heading_stddev)
            self._navigate(alignment, place)
        except AlignmentError as error:
            self.events.count("alignment restarts", ERROR, f"alignment from imu/data_raw: {error}", self.stamp_ns)
            self._align_again()

    def _navigate(self, alignment: Alignment, place: Place) -> None:
        east, north, up = alignment.velocity_g
        velocity = (east, north, up if self._vertical else 0.0)
        state = nav_state.initial_state(place.lat, place.lon, place.height, velocity, alignment.q_gb)
        arm = attitude.rotate(alignment.q_gb, *place.lever_arm)
        if any(arm):  # the place is that of an antenna
            state = nav_state.corrected(state, (-arm[0], -arm[1], -arm[2]))
        self.state = state
        self._history.add(self.stamp_ns, self._raw, state)
        self.stops.begin(
            alignment,
            self._alignment.cone,
            state,
            self.stamp_ns,
            self.gyro_bias,  # type: ignore[arg-type]
            self.gyro_bias_covariance,
            None if self._heading is None else self._heading_stddev**2,
        )
        covariance = after_alignment(alignment, state, place.stddev, arm, imu_errors(self.configuration))
        self.accuracy.begin(self.stamp_ns, state, covariance, (alignment.gyro_noise, alignment.accel_noise))
        if self.map is None:  # it stays where it was when alignment is repeated
            where = nav_state.geodetic(state)
            self.map = nav_state.MapFrame(where.lat, where.lon, where.height)
        self.changes += 1
        self.aligned_ns = self.stamp_ns
        self.phase = Phase.NAVIGATING
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
