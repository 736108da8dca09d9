"""A navigation system in one process: one front end, the filter, the real-time solution, the services.

The engine of `ins_node`, `ins_system` and `ins_process`. It knows no ROS: messages are read by the names of their
fields, solutions leave as `ins_nav.mechanization.nav_state.NavState`.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

from ins_nav.aiding.aid_queue import observe
from ins_nav.aiding.base import Aid
from ins_nav.aiding.parameters import configuration
from ins_nav.aiding.registry import by_topic, calibration_names, create_aids
from ins_nav.config import state_file
from ins_nav.config.parameters import Value
from ins_nav.config.sections import ImuSection
from ins_nav.estimation.error_model import Array
from ins_nav.estimation.state_layout import HORIZONTAL_POSITION, HORIZONTAL_VELOCITY
from ins_nav.event_log import INFO, WARN, EventLog
from ins_nav.mechanization import attitude, nav_state
from ins_nav.mechanization.stamped_rows import Stamps
from ins_nav.navigator.correction import NEVER_NS, Correction
from ins_nav.navigator.delayed import DelayedNavigator
from ins_nav.navigator.front_end import Aligned, FrontEnd, Phase
from ins_nav.navigator.realtime import RealtimeNavigator
from ins_nav.stop_detection.detector import Change
from ins_nav.stop_detection.service_schedule import ServiceSchedule
from ins_nav.zupt.calibration import Answer, Moment, ZuptServices
from ins_nav.zupt.measurements import StopCalibration
from ins_nav.zupt.zupt_equations import ZuptError


class NavigationSystem:
    """Front end, filter, real-time solution and services.

    Parameters
    ----------
    overrides : mapping
        Parameters that differ from their defaults, by full name.
    aided : bool
        The filter of this process uses the aids. Otherwise it measures stops only, and corrections of another
        process (`correct`) take precedence.

    Attributes
    ----------
    events : EventLog
    front_end : FrontEnd
    delayed : DelayedNavigator
    realtime : RealtimeNavigator
    services : ZuptServices
    calibration : dict
        Parameters of aids that a filter has calibrated, to be saved.
    position_aids : dict of topic to Aid
        Those whose messages can give the place to align at.

    Raises
    ------
    ParameterError
    """

    def __init__(self, overrides: Mapping[str, object] | None = None, aided: bool = True) -> None:
        self.events = EventLog()
        known, kept, last = state_file.read_state(configuration(overrides), self.events, calibration_names())
        for warning in known.warnings:
            self.events.report(WARN, warning)
        self.configuration = known
        self._kept = kept
        aids = create_aids(known.values)
        self.position_aids: dict[str, Aid[Any]] = by_topic({n: a for n, a in aids.items() if a.GIVES_POSITION})
        self.front_end = FrontEnd(known, self.events, last)
        self.delayed = DelayedNavigator(self.front_end, aids if aided else {})
        self.realtime = RealtimeNavigator(self.front_end, fine_first=aided)
        self.services = ZuptServices(known.imu, known.zupt, self.front_end.detector)
        self._remote_leads = False
        self.front_end.listeners.append(self)

    # --- what the front end calls

    def end(self) -> None:
        """Alignment starts again."""
        self.services.end()
        self._remote_leads = False

    def begin(self, aligned: Aligned) -> None:
        """Alignment is done."""
        self.services.begin(aligned.stamp_ns, self._moment(), aligned.cone, aligned.heading_given, aligned.noise)

    @property
    def due_ns(self) -> int:
        """See `front_end.Listener`: samples of a stop settle, or corrections of another process time out."""
        return min(self.services.due_ns, self.realtime.remote_until_ns if self._remote_leads else NEVER_NS)

    def advance(self, stamp_ns: int, count: int, change: Change | None) -> None:
        """After both navigators: hand over corrections, record stops, follow who leads."""
        realtime = self.realtime
        for correction in self.delayed.drain():
            realtime.correct(correction, remote=False)
        if not realtime.navigating:
            return
        self.services.advance(change, realtime.buffer, stamp_ns, self._moment)
        for before, after in realtime.drain_corrections():
            self.services.corrected(before, after)
        if realtime.remote_leads != self._remote_leads:
            self._follow(realtime.remote_leads)

    def _follow(self, remote_leads: bool) -> None:
        self._remote_leads = remote_leads
        if remote_leads:
            self.delayed.suspend()
            return
        solution = self.realtime.solution()
        if solution is not None:
            self.delayed.resume(solution._replace(aligned=True))

    def _moment(self) -> Moment:
        realtime = self.realtime
        assert realtime.state is not None
        biases = realtime.gyro_bias, realtime.accel_bias
        return Moment(realtime.state, *biases, realtime.accuracy.covariance, realtime.compensation.matrix)

    # --- input

    def add_imu(self, stamp_ns: int, wx: float, wy: float, wz: float, fx: float, fy: float, fz: float) -> bool:
        """Process one IMU sample on the IMU's axes; True when there is a new solution.

        Parameters
        ----------
        stamp_ns : int
        wx, wy, wz, fx, fy, fz : float
            Angular velocity, rad/s, and specific force, m/s².
        """
        before = self.front_end.stamp_ns
        self.front_end.add_imu(stamp_ns, wx, wy, wz, fx, fy, fz)
        return self.realtime.navigating and self.front_end.stamp_ns != before

    def add_imu_run(self, stamps: Stamps, values: Array, until_ns: int) -> tuple[int, bool]:
        """Process the first of a block of IMU samples, as `add_imu` would one after the other.

        Parameters
        ----------
        stamps, values, until_ns
            As in `ins_nav.navigator.front_end.FrontEnd.add_imu_run`.

        Returns
        -------
        int
            Number of samples processed.
        bool
            Whether there are new solutions: `RealtimeNavigator.entries`.
        """
        before = self.front_end.stamp_ns
        count = self.front_end.add_imu_run(stamps, values, until_ns)
        return count, self.realtime.navigating and self.front_end.stamp_ns != before

    def add(self, topic: str, message: Any) -> None:
        """Process a message of an aid: for the filter, and for the place to align at.

        Parameters
        ----------
        topic : str
        message : message
            Of one of the aid's types (`ins_nav.aiding.base.Aid.MESSAGE_TYPES`).
        """
        _add(self.front_end, self.delayed, self.position_aids.get(topic), topic, message)

    def correct(self, correction: Correction) -> None:
        """Process a correction from the filter of another process."""
        self.realtime.correct(correction, remote=True)

    # --- services

    def align(self) -> str:
        """Start alignment again, at the place of the present solution when there is one; says what happens now."""
        realtime = self.realtime
        return self.front_end.align(realtime.state, realtime.biases, realtime.covariance)

    def zupt1(self) -> tuple[bool, str]:
        """First call at rest: record this position; second, at rest after a turn: drifts and azimuth.

        Returns
        -------
        bool
            Whether it was done.
        str
            The result, or why not and what to do.
        """
        return self._zupt("zupt1", self.services.zupt1)

    def zupt2(self) -> tuple[bool, str]:
        """At rest: drifts, the azimuth trusted; results as of `zupt1`."""
        return self._zupt("zupt2", self.services.zupt2)

    def _zupt(self, name: str, solve: Callable[[float, float], Answer]) -> tuple[bool, str]:
        state, covariance = self.realtime.state, self.realtime.covariance
        if state is None or covariance is None:
            progress = f"{self.phase.value}, {100.0 * self.front_end.progress:.0f} % of alignment done"
            return False, f"no navigation solution yet: {progress}; call again when navigating"
        speed = math.hypot(*state[4:6])
        stddev = math.sqrt(float(covariance.diagonal()[HORIZONTAL_VELOCITY].sum()))
        try:
            answer = solve(speed, stddev)
        except ZuptError as error:
            text = f"{name} refused: {error}"
            self.events.count(f"{name} refused", INFO, text, self.front_end.stamp_ns)
            return False, str(error)
        if name == "zupt2":
            self.delayed.call_zupt(self.front_end.stamp_ns)
        elif answer.found is not None and answer.expected is not None:
            used_ns = max(answer.stamp_ns, self.delayed.settled_ns)
            stamps, _, states = self.realtime.buffer.between(used_ns, self.front_end.stamp_ns)  # still at rest
            state = nav_state.NavState._make(states[0].tolist())
            self.delayed.calibrate(StopCalibration(int(stamps[0]), state, answer.found, answer.expected))
        self.events.report(INFO, f"{name}: {answer.text}")
        return True, answer.text

    def save(self) -> tuple[bool, str]:
        """Write ``state_file``; results as of `zupt1`."""
        path, realtime = self.configuration.state_file.path, self.realtime
        if not path:
            return False, "no state_file: start the node with a name for it"
        state, covariance = realtime.state, realtime.covariance
        if state is None or covariance is None:
            return False, f"no navigation solution yet: {self.phase.value}; call again when navigating"
        where = nav_state.geodetic(state)
        heading = math.degrees(attitude.heading_from_yaw(attitude.to_euler(where.q_gb)[2]))
        stddev = math.sqrt(float(covariance.diagonal()[HORIZONTAL_POSITION].max()))
        place = math.degrees(where.lat), math.degrees(where.lon), where.height
        kept: dict[str, Value] = {
            **ImuSection.overrides("imu", gyro_bias=realtime.gyro_bias, accel_bias=realtime.accel_bias),
            **self.calibration,
        }
        pose = state_file.Pose(*place, heading, stddev, self.front_end.stamp_ns * 1e-9)
        try:
            state_file.save(path, kept, pose)
        except state_file.StateFileError as error:
            return False, str(error)
        text = f"{', '.join(kept)} and the pose written to {path}"
        self.events.report(INFO, f"save: {text}")
        return True, text

    @property
    def calibration(self) -> dict[str, Value]:
        """Parameters of aids, as calibrated by the filter that leads, or as loaded from ``state_file``."""
        return self.delayed.calibration or self._kept

    @calibration.setter
    def calibration(self, found: dict[str, Value]) -> None:
        self._kept = found

    @property
    def phase(self) -> Phase:
        """Present phase."""
        return self.realtime.phase

    @property
    def protection_levels(self) -> tuple[float, float, float] | None:
        """Of horizontal position and height, m, and heading, rad, of the filter's solution; None without one."""
        if self.delayed.filter is None:
            return None
        level = self.delayed.bank.protection_level()
        return level.horizontal, level.height, level.heading

    def solution(self) -> tuple[Correction, int] | None:
        """The present solution for a filter that starts later, and the stamp at which alignment ended."""
        solution = self.realtime.solution()
        return None if solution is None else (solution, self.front_end.aligned_ns)


class FilterSystem:
    """Front end and filter without a real-time solution: what `alignment_node` runs for an `ins_node` elsewhere.

    Parameters
    ----------
    overrides : mapping
        Parameters that differ from their defaults, by full name.

    Attributes
    ----------
    events : EventLog
    front_end : FrontEnd
    delayed : DelayedNavigator

    Raises
    ------
    ParameterError
    """

    def __init__(self, overrides: Mapping[str, object] | None = None) -> None:
        self.events = EventLog()
        known, _, last = state_file.read_state(configuration(overrides), self.events, calibration_names())
        for warning in known.warnings:
            self.events.report(WARN, warning)
        self.configuration = known
        aids = create_aids(known.values)
        self.front_end = FrontEnd(known, self.events, last)
        self.delayed = DelayedNavigator(self.front_end, aids)
        self._position_aids = by_topic({n: a for n, a in aids.items() if a.GIVES_POSITION})

    def add_imu(self, stamp_ns: int, wx: float, wy: float, wz: float, fx: float, fy: float, fz: float) -> None:
        """Process one IMU sample; see `NavigationSystem.add_imu`."""
        self.front_end.add_imu(stamp_ns, wx, wy, wz, fx, fy, fz)

    def add(self, topic: str, message: Any) -> None:
        """Process a message of an aid; see `NavigationSystem.add`."""
        _add(self.front_end, self.delayed, self._position_aids.get(topic), topic, message)

    def align(self) -> str:
        """Start alignment again; see `NavigationSystem.align`."""
        return self.front_end.align(*self.delayed.solution)


def _add(front_end: FrontEnd, delayed: DelayedNavigator, position: Aid[Any] | None, topic: str, message: Any) -> None:
    """Give a message to the filter, and as a place to align at, where it is of an aid that gives position."""
    observation = delayed.add(topic, message)
    if position is None:
        return
    if observation is None:
        observation = observe(position, message, front_end.stamp_ns, front_end.events)
    if observation is not None:
        front_end.observe_position(position.place(observation), topic)


class ScheduledCalls:
    """What `stop_detector_node` does, with the detector of the system: reports stops, calls the ZUPT services.

    Parameters
    ----------
    system : NavigationSystem
    on_stopped : callable
        Gets whether the vehicle is stopped, on every change.
    on_answer : callable
        Gets the name of a service, its success and its message.
    announced : bool or None
        What ``on_stopped`` need not get first.
    """

    def __init__(
        self,
        system: NavigationSystem,
        on_stopped: Callable[[bool], None],
        on_answer: Callable[[str, bool, str], None] = lambda name, success, text: None,
        announced: bool | None = None,
    ) -> None:
        self._system = system
        self._on_stopped = on_stopped
        self._on_answer = on_answer
        self.schedule = ServiceSchedule(system.configuration.stop_detector)
        self._stopped = announced
        self._restarts = 0

    @property
    def due_ns(self) -> int:
        """Stamp of the sample after which a service is due; `after_sample` may follow several earlier ones."""
        detector = self._system.front_end.detector
        return min(detector.since_ns + self.schedule.due_ns, NEVER_NS) if detector.stopped else NEVER_NS

    def after_sample(self) -> None:
        """The system has processed a sample."""
        system, schedule = self._system, self.schedule
        detector = system.front_end.detector
        if system.front_end.restarts != self._restarts:
            self._restarts = system.front_end.restarts
            schedule.restart()
        if detector.stopped != self._stopped:
            self._on_stopped(detector.stopped)
            if detector.stopped:
                schedule.arrive()
            self._stopped = detector.stopped
        while detector.stopped and detector.rest_ns >= schedule.due_ns:
            name, stop = schedule.take(), schedule.stop
            success, text = system.zupt1() if name == "zupt1" else system.zupt2()
            schedule.answered(name, stop, success)
            self._on_answer(name, success, text)
