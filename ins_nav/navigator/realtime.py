"""Real-time navigation: every sample integrated at once, corrections from the delayed filter re-integrated.

The solution is of the present sample. A correction replaces a state of the past; the samples since are integrated
again (`ins_nav.mechanization.replay_buffer`), so that its delay does not matter. The covariance is the filter's,
propagated from the last correction to the present.
"""

import math

from ins_nav.config.configuration import Configuration
from ins_nav.estimation.covariance_propagation import CovariancePropagation, imu_errors
from ins_nav.estimation.error_model import Array, Vector
from ins_nav.estimation.state_layout import ACCEL_BIAS, ATTITUDE, BIASES, GYRO_BIAS
from ins_nav.event_log import INFO, EventLog
from ins_nav.mechanization.nav_state import MapFrame, NavState
from ins_nav.mechanization.replay_buffer import Entries, ReplayBuffer
from ins_nav.mechanization.strapdown import Compensation, compensated
from ins_nav.navigator.correction import Correction, CorrectionQueue
from ins_nav.navigator.front_end import Aligned, Biases, FrontEnd, Phase
from ins_nav.stop_detection.detector import Change


class RealtimeNavigator:
    """The solution at the newest sample.

    Parameters
    ----------
    front_end : FrontEnd
    fine_first : bool
        Coarse alignment is followed by fine alignment, in the filter of this process.

    Attributes
    ----------
    navigating : bool
        Whether there is a solution.
    compensation : Compensation
        Of the samples: biases and further errors of the IMU in use.
    accuracy : CovariancePropagation
        Covariance of the solution.
    buffer : ReplayBuffer
        The last seconds of samples and states.
    changes : int
        Number of alignments and corrections.
    """

    def __init__(self, front_end: FrontEnd, fine_first: bool = False) -> None:
        self.front_end = front_end
        self._fine_first = fine_first
        self.accuracy = CovariancePropagation(front_end.configuration, front_end.condition)
        self._imu_errors = imu_errors(front_end.configuration)
        self.buffer = ReplayBuffer(
            front_end.recent, front_end.instantaneous, front_end.vertical, front_end.water_surface
        )
        self._remote = CorrectionQueue(front_end.events, "ins/feedback")
        self._local = CorrectionQueue(front_end.events, "own filter")
        self.changes = 0
        self._restarts = -1
        self.end()
        front_end.listeners.append(self)

    # --- what the front end calls

    def end(self) -> None:
        """Alignment starts again."""
        front_end = self.front_end
        self.navigating = self._fine = False
        self._count = 0
        self._corrected: list[tuple[NavState, NavState]] = []
        if front_end.restarts != self._restarts:
            self._restarts = front_end.restarts
            self._remote.restart()
            self._local.restart()
            self.accuracy.restart()
        else:
            self._remote.clear()
            self._local.clear()
            self.accuracy.clear()
        gyro_bias, accel_bias, _ = front_end.biases
        self._compensate(gyro_bias, accel_bias, ())

    def begin(self, aligned: Aligned) -> None:
        """Start from the first solution."""
        gyro_bias, accel_bias, _ = aligned.biases
        self._compensate(gyro_bias, accel_bias, self._imu_error_values)
        self.buffer.begin(aligned.state)
        self.accuracy.begin(aligned.stamp_ns, aligned.state, aligned.covariance, aligned.noise)
        self.navigating = True
        self._count = 1
        self._fine = self._fine_first
        self.changes += 1

    @property
    def due_ns(self) -> int:
        """See `front_end.Listener`: the covariance is propagated, or a correction takes effect."""
        return min(self.accuracy.due_ns, self._remote.due_ns, self._local.due_ns)

    def advance(self, stamp_ns: int, count: int, change: Change | None) -> None:
        """Integrate samples; see `front_end.Listener`."""
        if not self.navigating:
            return
        self._count = count
        self.buffer.integrate(count, self.compensation)
        if stamp_ns < self.due_ns:
            return
        if stamp_ns >= self.accuracy.due_ns:
            self.accuracy.advance(stamp_ns, self.buffer.newest)
        if self.accuracy.hidden != self.front_end.condition.count:
            self.accuracy.renew(self.buffer)
        if stamp_ns >= self._remote.due_ns:
            self._apply(self._remote)
        if stamp_ns >= self._local.due_ns:
            if self._remote.leads(stamp_ns):
                self._local.clear()
            else:
                self._apply(self._local)

    def _compensate(self, gyro_bias: Vector, accel_bias: Vector, imu_errors: tuple[float, ...]) -> None:
        """Use these biases and further errors of the IMU, where those are of this configuration."""
        errors = self._imu_errors
        self._imu_error_values = imu_errors if len(imu_errors) == errors.size else (0.0,) * errors.size
        self.compensation = Compensation(gyro_bias, accel_bias, errors.correction(self._imu_error_values))

    # --- corrections

    def correct(self, correction: Correction, remote: bool) -> None:
        """Queue a correction; it takes effect at its time, or at once where that has passed.

        Parameters
        ----------
        correction : Correction
        remote : bool
            From the filter of another process. As long as such corrections arrive, they alone take effect.
        """
        stamp_ns, queue = self.front_end.stamp_ns, self._remote if remote else self._local
        if not queue.add(correction, stamp_ns) or not self.navigating or correction.apply_ns >= stamp_ns:
            return
        text = "a correction arrives after its time, applied at once: is the machine busy? (aiding.feedback_time)"
        self.front_end.events.count("correction late", INFO, text, stamp_ns)
        if remote or not self._remote.leads(stamp_ns):
            self._apply(queue)

    def _apply(self, queue: CorrectionQueue) -> None:
        popped = queue.pop(self.front_end.stamp_ns, self.buffer)
        if popped is None:
            return
        correction, entry = popped
        self._compensate(correction.gyro_bias, correction.accel_bias, correction.imu_errors)
        self.accuracy.rewind(entry.stamp_ns, entry.state)
        self.accuracy.replace(correction.covariance)
        self._fine = not correction.aligned
        self.changes += 1
        self.buffer.reintegrate(entry.stamp_ns, correction.state, self.compensation)
        self.accuracy.catch_up(correction.state, self.buffer)
        self._corrected.append((entry.state, correction.state))

    def drain_corrections(self) -> list[tuple[NavState, NavState]]:
        """States that corrections replaced since the last call, before and after."""
        corrected, self._corrected = self._corrected, []
        return corrected

    @property
    def remote_leads(self) -> bool:
        """Whether corrections of another process took effect within the last 5 s."""
        return self._remote.leads(self.front_end.stamp_ns)

    @property
    def remote_until_ns(self) -> int:
        """Stamp from which corrections of another process no longer lead, unless another takes effect."""
        return self._remote.leads_until_ns

    # --- the solution

    @property
    def state(self) -> NavState | None:
        """At the newest sample; None without a solution."""
        return self.buffer.newest if self.navigating else None

    @property
    def entries(self) -> Entries:
        """Samples of the last call of `advance` with their solutions; the one of `begin` after that."""
        return self.buffer.last(self._count)

    @property
    def gyro_bias(self) -> Vector:
        """In use, rad/s."""
        return self.compensation.gyro_bias

    @property
    def accel_bias(self) -> Vector:
        """In use, m/s²."""
        return self.compensation.accel_bias

    @property
    def angular_velocity(self) -> Vector:
        """Of the newest sample on base_link's axes, errors in use removed, rad/s."""
        return compensated(self.front_end.raw, *self.compensation)[1:4]

    @property
    def specific_force(self) -> Vector:
        """Of the newest sample on base_link's axes, errors in use removed, m/s²."""
        return compensated(self.front_end.raw, *self.compensation)[4:7]

    @property
    def stamp_ns(self) -> int:
        """Of the newest sample."""
        return self.front_end.stamp_ns

    @property
    def aligned_ns(self) -> int:
        """Stamp at which alignment ended; 0 before."""
        return self.front_end.aligned_ns

    @property
    def restarts(self) -> int:
        """Number of jumps of the stamps."""
        return self.front_end.restarts

    @property
    def configuration(self) -> Configuration:
        """Of the front end."""
        return self.front_end.configuration

    @property
    def map(self) -> MapFrame | None:
        """East-north-up at the place of the first alignment."""
        return self.front_end.map

    @property
    def events(self) -> EventLog:
        """Of the front end."""
        return self.front_end.events

    @property
    def phase(self) -> Phase:
        """Present phase."""
        return Phase.FINE if self._fine and self.navigating else self.front_end.phase

    @property
    def covariance(self) -> Array | None:
        """Of the errors (`ins_nav.estimation.error_model`) at present, shape (15, 15); None without a solution."""
        return self.accuracy.covariance if self.navigating else None

    @property
    def attitude_covariance(self) -> Array:
        """On n, level but free in azimuth, rad², shape (3, 3)."""
        return self.accuracy.covariance[ATTITUDE, ATTITUDE]

    @property
    def gyro_bias_covariance(self) -> Array:
        """rad²/s², shape (3, 3)."""
        return self.accuracy.covariance[GYRO_BIAS, GYRO_BIAS]

    @property
    def accel_bias_covariance(self) -> Array:
        """m²/s⁴, shape (3, 3)."""
        return self.accuracy.covariance[ACCEL_BIAS, ACCEL_BIAS]

    @property
    def biases(self) -> Biases:
        """In use, with their covariance."""
        return Biases(self.gyro_bias, self.accel_bias, self.accuracy.covariance[BIASES, BIASES])

    @property
    def sample_noise(self) -> tuple[float, float]:
        """Sigmas of the white noise of one sample, rad/s and m/s²; zeros before the first interval.

        Noise density over the root of the interval between samples.
        """
        nominal = self.front_end.stream.nominal
        interval = self.front_end.raw[0] if math.isnan(nominal) else nominal
        if interval == 0.0:
            return 0.0, 0.0
        gyro, accel = self.accuracy.white_noise
        return gyro / math.sqrt(interval), accel / math.sqrt(interval)

    def solution(self) -> Correction | None:
        """The present solution, for a filter that begins later."""
        if not self.navigating:
            return None
        stamp_ns, covariance = self.front_end.stamp_ns, self.accuracy.covariance
        aligned = not self._fine and self._remote.corrected_ns > self.aligned_ns
        biases, errors = (self.gyro_bias, self.accel_bias), self._imu_error_values
        return Correction(stamp_ns, stamp_ns, self.buffer.newest, *biases, covariance, aligned, errors)
