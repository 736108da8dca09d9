"""bag_player: plays a rosbag2 recording into live nodes.

Options are those of ``ros2 bag play``. Messages are published as the bytes that were recorded, never decoded,
never skipped. Names are as recorded but relative, so that a namespace moves them; only the names ROS uses
globally (/tf, /clock, ...) stay absolute. Publishers are reliable and 1000 deep; topics recorded as latched are
latched again; parameters ``qos_overrides./TOPIC.publisher.*`` change that.
"""

import argparse
import contextlib
import math
import os
import select
import sys
import termios
import threading
import time
import tty
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any, NoReturn

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.task import Future
from rclpy.validate_topic_name import validate_topic_name
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import Trigger
from tqdm import tqdm

from ins_nav.errors import InsNavError, for_people
from ins_nav.nodes.runtime import init, message_class, on_signal, serve
from ins_nav.recordings.bags import BagReader, DamagedBagError, suggestion

_GLOBAL_TOPICS = ("/tf", "/tf_static", "/clock", "/rosout", "/parameter_events", "/diagnostics")
_DEPTH = 1000  # 2.5 s at 400 Hz: no burst is lost on a reader that is slow for a moment
_STABLE = 3.5  # s without a further match: an announcement that was lost is repeated after 3 s
_REPORT_WAIT = 2.0  # s without a subscriber before a message: longer than discovery usually lasts
_LATE = 0.5  # s behind the schedule at which a warning is due
_ACKNOWLEDGE = 5.0  # s for reliable readers to acknowledge the last messages
_LINGER = 0.2  # s between the last message and the end: best-effort readers cannot acknowledge
_LONGEST_SLEEP = 0.05  # s, how soon a signal, a service or the clock's end is noticed


class Schedule:
    """Bag time: follows the wall clock at a rate, stops while paused. Thread safe.

    Parameters
    ----------
    start_ns, end_ns : int
        Bag stamps between which time runs.
    rate : float
        Bag seconds a wall second.
    wall : callable
        A monotonic clock, s.
    """

    def __init__(self, start_ns: int, end_ns: int, rate: float, wall: Callable[[], float] = time.monotonic) -> None:
        self._start_ns = start_ns
        self._end_ns = end_ns
        self._rate = rate
        self._wall = wall
        self._began = wall()
        self._paused_at: float | None = self._began
        self._lock = threading.Lock()

    @property
    def paused(self) -> bool:
        return self._paused_at is not None

    def pause(self) -> None:
        """Stop bag time, if it runs."""
        with self._lock:
            if self._paused_at is None:
                self._paused_at = self._wall()

    def resume(self) -> None:
        """Continue bag time."""
        with self._lock:
            if self._paused_at is not None:
                self._began += self._wall() - self._paused_at
                self._paused_at = None

    def restart(self) -> None:
        """Return to the start; a pause continues."""
        with self._lock:
            self._began = self._wall()
            self._paused_at = self._began if self._paused_at is not None else None

    def wait(self, stamp_ns: int) -> float:
        """Wall seconds until a stamp is due, negative when it is overdue; infinite while paused."""
        if self._paused_at is not None:
            return math.inf
        return self._began + (stamp_ns - self._start_ns) * 1e-9 / self._rate - self._wall()

    def now_ns(self) -> int:
        """The bag time, ns."""
        with self._lock:
            wall = self._wall() if self._paused_at is None else self._paused_at
            return min(self._start_ns + int((wall - self._began) * self._rate * 1e9), self._end_ns)


class Player(Node):
    """Publishes the messages of a bag when they are due.

    Attributes
    ----------
    published : Counter of topic as recorded
    skipped : dict of topic to the reason why it is not played
    """

    def __init__(self, bag: BagReader, options: argparse.Namespace) -> None:
        super().__init__("bag_player")
        topics = [bag.topic(name) for name in options.topics or bag.topics]
        remaps = dict(_remap(bag, rule) for rule in options.remap)
        self._bag = bag
        self._start_ns = bag.start_ns + round(options.start_offset * 1e9)
        self._loop = options.loop
        self._stopping = False
        self._reported_late = False
        self._outputs: dict[str, Any] = {}
        self.published: Counter[str] = Counter()
        self.skipped: dict[str, str] = {}
        for topic in topics:
            try:
                self._outputs[topic] = self._output(topic, remaps.get(topic, topic))
            except (InsNavError, NameValidationException) as error:
                self.skipped[topic] = str(error).replace("\n", " ")
        if not self._outputs:
            raise InsNavError(f"{bag.path}: nothing to play: {'; '.join(self.skipped.values())}")
        self.schedule = Schedule(self._start_ns, bag.end_ns, options.rate)
        for name in ("pause", "resume", "toggle_paused"):
            self.create_service(Trigger, f"~/{name}", self._answer(name))
        if options.clock is not None:
            self._clock_publisher = self.create_publisher(ClockMessage, "/clock", 10)
            # steady: with use_sim_time the default timer would wait for the very clock it publishes
            self.create_timer(1.0 / options.clock, self._publish_clock, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def stop(self) -> None:
        """End `play` and the waits."""
        self._stopping = True

    def toggle_paused(self) -> None:
        """Pause, or resume."""
        if self.schedule.paused:
            self.schedule.resume()
        else:
            self.schedule.pause()

    def wait_for_subscribers(self, seconds: float | None) -> None:
        """Wait until a played topic has a subscriber and no other joins, at most so many seconds (None: no limit)."""
        end = math.inf if seconds is None else time.monotonic() + seconds
        subscribers, since, reported = 0, time.monotonic(), False
        while not self._stopping and time.monotonic() < end:
            matches = sum(output.get_subscription_count() for output in self._outputs.values())
            now = time.monotonic()
            if matches != subscribers:
                subscribers, since = matches, now
            elif subscribers and now - since >= _STABLE:
                return
            elif not subscribers and not reported and now - since > _REPORT_WAIT:
                names = ", ".join(output.topic_name for output in self._outputs.values())
                _print(f"waiting for a subscriber to {names} (--wait-for-subscribers 0: play at once)")
                reported = True
            time.sleep(_LONGEST_SLEEP)

    def play(self, idle: Callable[[float], None], progress: Callable[[int], None]) -> None:
        """Publish every message when it is due; idle(seconds) waits, progress(ns) receives the bag time.

        Raises
        ------
        DamagedBagError
            When all that can be read of a damaged bag is published.
        """
        while True:
            self.schedule.restart()
            self._play_once(idle, progress)
            if self._stopping or not self._loop:
                return

    def finish(self) -> None:
        """Wait for the arrival of the last messages."""
        end = time.monotonic() + _ACKNOWLEDGE
        for topic, output in self._outputs.items():
            while not self._stopping and not output.wait_for_all_acked(Duration(seconds=_LONGEST_SLEEP)):
                if time.monotonic() > end:
                    _print(f"a subscriber to {topic} has not acknowledged all messages within {_ACKNOWLEDGE:g} s")
                    return
        time.sleep(_LINGER)

    def _play_once(self, idle: Callable[[float], None], progress: Callable[[int], None]) -> None:
        publish = {topic: output.publish for topic, output in self._outputs.items()}
        wait = self.schedule.wait
        for raw in self._bag.messages(publish, self._start_ns):
            while not self._stopping and (delay := wait(raw.stamp_ns)) > 0.0:
                idle(min(delay, _LONGEST_SLEEP))
            if self._stopping:
                return
            if delay < -_LATE and not self._reported_late:
                self._reported_late = True
                _print(f"cannot keep the pace: {-delay:.1f} s behind; no message is skipped")
            publish[raw.topic](raw.data)
            self.published[raw.topic] += 1
            progress(raw.stamp_ns)

    def _output(self, topic: str, name: str) -> Any:
        if name == topic and topic not in _GLOBAL_TOPICS:
            name = topic.removeprefix("/")
        info = self._bag.topics[topic]
        latched = DurabilityPolicy.TRANSIENT_LOCAL if info.latched else DurabilityPolicy.VOLATILE
        qos = QoSProfile(depth=_DEPTH, durability=latched)
        overrides = QoSOverridingOptions.with_default_policies()
        return self.create_publisher(message_class(info.msgtype), name, qos, qos_overriding_options=overrides)

    def _answer(self, name: str) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        act = self.toggle_paused if name == "toggle_paused" else getattr(self.schedule, name)

        def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            act()
            response.success = True
            response.message = "paused" if self.schedule.paused else "playing"
            return response

        return answer

    def _publish_clock(self) -> None:
        seconds, nanoseconds = divmod(self.schedule.now_ns(), 1_000_000_000)
        message = ClockMessage()
        message.clock.sec = seconds
        message.clock.nanosec = nanoseconds
        self._clock_publisher.publish(message)


def _print(text: str) -> None:
    """Print a line above the progress bar."""
    tqdm.write(text, file=sys.stdout)
    sys.stdout.flush()


def _remap(bag: BagReader, rule: str) -> tuple[str, str]:
    """Recorded and new name, out of OLD:=NEW."""
    old, separator, new = rule.partition(":=")
    if not separator or not old or not new:
        raise InsNavError(f"--remap {rule!r}: expected OLD:=NEW")
    try:
        validate_topic_name(new)
    except NameValidationException as error:
        raise InsNavError(f"--remap {rule!r}: {new!r} is not a topic name") from error
    return bag.topic(old), new


@contextlib.contextmanager
def _keyboard(toggle: Callable[[], None]) -> Iterator[Callable[[float], None]]:
    """A way to wait some seconds in which SPACE calls toggle; plain sleep where stdin is no terminal."""
    if not sys.stdin.isatty():
        yield time.sleep
        return

    keyboard = sys.stdin.fileno()

    def idle(seconds: float) -> None:
        if select.select([keyboard], [], [], seconds)[0] and os.read(keyboard, 1) == b" ":
            toggle()

    before = termios.tcgetattr(keyboard)
    tty.setcbreak(keyboard)
    try:
        yield idle
    finally:
        termios.tcsetattr(keyboard, termios.TCSADRAIN, before)


class _Parser(argparse.ArgumentParser):
    """Reports errors in one line."""

    def error(self, message: str) -> NoReturn:
        raise InsNavError(f"{message}; see --help")


def _positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not above 0")
    return value


def _not_negative(text: str) -> float:
    value = float(text)
    if not 0.0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is below 0")
    return value


def _options(args: list[str]) -> argparse.Namespace:
    parser = _Parser(
        prog="bag_player", allow_abbrev=False, description="Play a rosbag2 recording. SPACE pauses and resumes."
    )
    parser.add_argument("bag", help="rosbag2 folder, or a .mcap or .db3 file")
    parser.add_argument("-r", "--rate", type=_positive, default=1.0, help="bag seconds a second (default 1)")
    parser.add_argument(
        "--start-offset", type=_not_negative, default=0.0, metavar="S", help="start S seconds after the beginning"
    )
    parser.add_argument("-l", "--loop", action="store_true", help="restart at the end")
    parser.add_argument("-p", "--start-paused", action="store_true", help="wait for SPACE or the service ~/resume")
    parser.add_argument("--topics", nargs="+", action="extend", metavar="TOPIC", help="play these only")
    parser.add_argument(
        "-m", "--remap", nargs="+", action="extend", default=[], metavar="OLD:=NEW", help="publish under other names"
    )
    parser.add_argument(
        "--clock", nargs="?", type=_positive, const=40.0, metavar="HZ", help="publish bag time on /clock (default 40)"
    )
    parser.add_argument(
        "--wait-for-subscribers",
        type=_not_negative,
        metavar="S",
        help="begin S seconds from now at the latest, 0: at once (default: wait until a topic has a subscriber)",
    )
    parser.add_argument("--no-progress", action="store_true", help="no progress bar")
    options, unknown = parser.parse_known_args(args)
    if unknown:
        known = [name for action in parser._actions for name in action.option_strings]
        parser.error(f"unknown argument {unknown[0]!r}{suggestion(unknown[0], known)}")
    return options


def _run(player: Player, bag: BagReader, options: argparse.Namespace) -> None:
    """Wait, play, finish and sum up."""
    if player.skipped:
        _print("not played: " + "; ".join(f"{topic} ({reason})" for topic, reason in player.skipped.items()))
    player.wait_for_subscribers(options.wait_for_subscribers)
    began = time.monotonic()
    damage: DamagedBagError | None = None
    with (
        _keyboard(player.toggle_paused) as idle,
        tqdm(
            total=(bag.end_ns - bag.start_ns) * 1e-9,
            bar_format="{percentage:3.0f}%|{bar}| {n:.1f} of {total:.1f} s [{elapsed}<{remaining}]",
            disable=True if options.no_progress else None,  # None: where stderr is no terminal
        ) as bar,
    ):

        def progress(stamp_ns: int) -> None:
            bar.update((stamp_ns - bag.start_ns) * 1e-9 - bar.n)

        if not options.start_paused:
            player.schedule.resume()
        try:
            player.play(idle, progress)
        except DamagedBagError as error:
            damage = error
        player.finish()
    counts = ", ".join(f"{topic} {count}" for topic, count in sorted(player.published.items()))
    _print(f"published {player.published.total()} messages in {time.monotonic() - began:.1f} s: {counts or 'none'}")
    if damage:
        raise damage


@for_people("bag_player")
def main(args: list[str] | None = None) -> None:
    """Play a bag."""
    with contextlib.ExitStack() as stack:
        stack.callback(rclpy.try_shutdown)
        options = _options(init(args))
        bag = stack.enter_context(BagReader(options.bag))
        length = (bag.end_ns - bag.start_ns) * 1e-9
        if options.start_offset > length:
            raise InsNavError(f"--start-offset {options.start_offset:g}: the bag is {length:.1f} s long")
        player = Player(bag, options)
        on_signal(player.stop)
        end = Future()
        services = threading.Thread(target=serve, args=((player,), end))
        services.start()
        try:
            _run(player, bag, options)
        finally:
            end.set_result(None)
            services.join()


if __name__ == "__main__":
    sys.exit(main())
