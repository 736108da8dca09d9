"""`ins_process`: the live system's core over a recording, without ROS, as fast as the machine allows."""

import argparse
import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from ins_nav.aiding.registry import create_aids
from ins_nav.config.parameters import Value, parse_assignment, read_file
from ins_nav.errors import InsNavError, Interrupted, for_people
from ins_nav.messages import diagnostics, inputs
from ins_nav.messages.solution import SolutionMessages, fill_bias
from ins_nav.navigator.delayed import DelayedNavigator
from ins_nav.navigator.realtime import RealtimeNavigator
from ins_nav.recordings.bags import (
    BagError,
    BagReader,
    BagWriter,
    DamagedBagError,
    RawMessage,
    absolute,
    header,
    message,
    suggestion,
)
from ins_nav.stop_detection.service_schedule import ServiceSchedule

_IMU, _DIAGNOSTICS = "sensor_msgs/msg/Imu", "diagnostic_msgs/msg/DiagnosticArray"
_BOOL = "std_msgs/msg/Bool"
_SECOND = 1_000_000_000
_IMU_TOPIC = "/imu/data_raw"
Inputs = dict[str, tuple[str, ...]]
"""Topics that are read, with their types."""
NODES = ("ins_node", "stop_detector_node", "alignment_node")
"""Nodes whose work is done here by default, as in `ins_system`; that of the first always is."""


class Recorder:
    """Writes into a bag what the live node publishes, at the same stamps and rates."""

    def __init__(self, writer: BagWriter, navigator: RealtimeNavigator, aided: DelayedNavigator | None) -> None:
        self._writer = writer
        self._navigator = navigator
        self._aided = aided
        self._base_link = navigator.configuration.frames.base_link
        self._out = SolutionMessages(navigator)
        self._topics = {"odometry": self._out.odometry, "imu/data": self._out.imu, "fix": self._out.fix}
        self._next_diagnostics_ns = 0
        self.written = 0
        """Solutions written."""
        for topic, content in self._topics.items():
            writer.add_topic(topic, content.msgtype)
        writer.add_topic("imu/bias", _IMU, latched=True)
        writer.add_topic("stopped", _BOOL, latched=True)
        writer.add_topic("diagnostics", _DIAGNOSTICS)

    def stopped(self, value: bool, stamp_ns: int) -> None:
        """A stop has begun or ended."""
        self._writer.write("stopped", _BOOL, message(_BOOL, data=value), stamp_ns)

    def solution(self) -> None:
        """The navigator has a new solution."""
        out, stamp_ns = self._out, self._navigator.stamp_ns
        if not out.due():
            return
        if out.first:
            bias = message(_IMU)
            fill_bias(bias, self._navigator, self._base_link)
            self._writer.write("imu/bias", _IMU, bias, stamp_ns)
        out.fill()
        for topic, content in self._topics.items():
            self._writer.write_raw(topic, content.msgtype, content.serialized(), stamp_ns)
        self.written += 1

    def tick(self, stamp_ns: int, last: bool = False) -> None:
        """Write diagnostics once a second of recorded time, and at its end."""
        if stamp_ns < self._next_diagnostics_ns and not last:
            return
        self._next_diagnostics_ns = stamp_ns + _SECOND
        said = {"navigation": diagnostics.diagnostics(self._navigator)}
        if self._aided is not None:
            said["alignment"] = diagnostics.alignment_diagnostics(self._aided)
        status = [
            message(
                "diagnostic_msgs/msg/DiagnosticStatus",
                level=level,
                name=f"ins_process: {subject}",
                message=text,
                hardware_id="imu",
                values=[message("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()],
            )
            for subject, (level, text, values) in said.items()
        ]
        array = message(_DIAGNOSTICS, header=header(stamp_ns, ""), status=status)
        self._writer.write("diagnostics", _DIAGNOSTICS, array, stamp_ns)


class Calls:
    """What `stop_detector_node` does: publishes ``stopped``, calls ZUPT services. Its detector is the navigator's."""

    def __init__(self, navigator: RealtimeNavigator, recorder: Recorder, aided: DelayedNavigator | None = None) -> None:
        self._navigator = navigator
        self._recorder = recorder
        self._aided = aided
        self._policy = ServiceSchedule(navigator.configuration.stop_detector)
        self._stopped: bool | None = None
        self._restarts = 0

    def after_sample(self) -> None:
        """The navigator has taken a sample."""
        navigator, policy = self._navigator, self._policy
        detector = navigator.stops.detector
        if navigator.restarts != self._restarts:
            self._restarts = navigator.restarts
            policy.restart()
        if self._stopped is None:
            if not navigator.stamp_ns:  # no valid sample yet
                return
            self._stopped = False
            self._recorder.stopped(False, navigator.stamp_ns)
        if detector.stopped != self._stopped:
            self._stopped = detector.stopped
            self._recorder.stopped(self._stopped, navigator.stamp_ns)
            if self._stopped:
                policy.arrive()
        while detector.stopped and detector.rest_ns >= policy.due_ns:
            name, stop = policy.take(), policy.stop
            success, _ = navigator.zupt1() if name == "zupt1" else navigator.zupt2()
            policy.answered(name, stop, success)
            if success and self._aided is not None:
                self._aided.call_zupt(navigator.stamp_ns)


def input_types(values: Mapping[str, Value]) -> Inputs:
    """Topics that are read with these values of the parameters."""
    aids = {absolute(aid.topic): aid.MESSAGE_TYPES for aid in create_aids(values).values()}
    return {_IMU_TOPIC: (_IMU,)} | aids


def input_topics(reader: BagReader, remap: dict[str, str], wanted: Inputs) -> dict[str, str]:
    """Topics of the recording that are inputs, each with the name it stands for.

    Raises
    ------
    BagError
        There is no IMU topic, one has a wrong type, or a remapped one is not in the recording.
    """
    for topic in remap:
        reader.topic(topic)
    names = {}
    for topic, info in reader.topics.items():
        target = remap.get(topic, topic)
        if target in wanted:
            if info.msgtype not in wanted[target]:
                types = " or ".join(wanted[target])
                raise BagError(f"{reader.path}: {topic} is {info.msgtype}; {target} must be {types}")
            names[topic] = target
    if _IMU_TOPIC not in names.values():
        imus = [topic for topic, info in reader.topics.items() if info.msgtype == _IMU and topic not in remap]
        hint = f": add --remap {imus[0]}:=/imu/data_raw" if imus else f"; it has {', '.join(reader.topics)}"
        raise BagError(f"{reader.path}: no topic /imu/data_raw{hint}")
    return names


def feed(navigator: RealtimeNavigator, topic: str, content: object) -> bool:
    """Give a message to a navigator; True when there is a new solution."""
    if topic == _IMU_TOPIC:
        return inputs.feed_imu(navigator, content)
    navigator.add(topic.removeprefix("/"), content)
    return False


def parse_remaps(texts: Iterable[str]) -> dict[str, str]:
    """``OLD:=NEW`` texts as a dict of absolute names.

    Raises
    ------
    InsNavError
    """
    remap = {}
    for text in texts:
        old, separator, new = text.partition(":=")
        if not (old and separator and new):
            raise InsNavError(f"--remap {text!r} is not OLD:=NEW")
        remap[absolute(old)] = absolute(new)
    return remap


def _with_progress(
    reader: BagReader, raw_messages: Iterable[RawMessage], navigator: RealtimeNavigator, aided: DelayedNavigator | None
) -> Iterator[RawMessage]:
    """The messages, with a bar over the recording's time; the navigators' reports are printed above it."""
    from tqdm import tqdm

    duration = (reader.end_ns - reader.start_ns) / _SECOND
    layout = "{l_bar}{bar}| {n:.0f}/{total:.0f} s [{elapsed}<{remaining}{postfix}]"
    with tqdm(total=duration, disable=None, bar_format=layout) as bar:
        for raw in raw_messages:
            yield raw
            done = (raw.stamp_ns - reader.start_ns) / _SECOND
            if done - bar.n >= 1.0:
                bar.set_postfix_str(_phase(navigator, aided), refresh=False)
                bar.update(done - bar.n)
            told = navigator.events.drain()
            if aided is not None:  # much of it is the same
                told += [report for report in aided.events.drain() if report not in told]
            for report in told:
                bar.write(f"[{report.level}] {report.text}", file=sys.stderr)
        bar.update(duration - bar.n)


def _phase(navigator: RealtimeNavigator, aided: DelayedNavigator | None) -> str:
    if aided is None or aided.filter is None:
        return navigator.phase.value
    text = f"{aided.phase.value}, heading ± {math.degrees(aided.filter.heading_stddev):.2f}°"
    return f"{text}, {aided.time_left:.0f} s left" if aided.time_left else text


@for_people("ins_process")
def main(argv: Sequence[str] | None = None) -> int | None:
    """The command line."""
    args = _parser().parse_args(argv)
    for node in args.nodes:
        if node not in NODES:
            raise InsNavError(f"--nodes: no node {node!r}{suggestion(node, NODES)}")
    overrides: dict[str, object] = {}
    for file in args.params_file:
        overrides |= read_file(file, *args.nodes, "ins_node", "/ins_process", namespace=args.namespace)
    overrides |= dict(map(parse_assignment, args.param))
    navigator = RealtimeNavigator(overrides)
    if args.save and not navigator.configuration.state_file.path:
        raise InsNavError("--save: where to? Add --param state_file:=FILE")
    aided = DelayedNavigator(overrides) if "alignment_node" in args.nodes else None
    if args.output.resolve() in (args.bag.resolve(), args.bag.resolve().parent):
        raise InsNavError(f"{args.output}: is where the recording itself is; choose another name")
    damage = None
    with BagReader(args.bag) as reader:
        wanted = input_types(navigator.configuration.values)
        names = input_topics(reader, parse_remaps(args.remap), wanted)
        with BagWriter(args.output, args.overwrite) as writer:
            recorder = Recorder(writer, navigator, aided)
            calls = Calls(navigator, recorder, aided) if "stop_detector_node" in args.nodes else None
            try:
                for raw in _with_progress(reader, reader.messages(names), navigator, aided):
                    topic, content = names[raw.topic], reader.deserialize(raw)
                    if aided is not None:
                        feed(aided, topic, content)
                        for feedback in aided.drain():
                            navigator.follow(feedback)
                    if feed(navigator, topic, content):
                        recorder.solution()
                    if calls is not None:
                        calls.after_sample()
                    recorder.tick(raw.stamp_ns)
            except DamagedBagError as error:
                damage = error
            except Interrupted:
                print(f"ins_process: interrupted; {args.output} ends there", file=sys.stderr)
                raise
            recorder.tick(reader.end_ns, last=True)
    if args.save:
        if aided is not None and aided.found_calibration:
            navigator.calibration = aided.found_calibration
        saved, text = navigator.save()
        if not saved:
            raise InsNavError(f"--save: {text}")
    stream = navigator.stream
    counts = "".join(f", {kind}: {count}" for kind, count in navigator.events.counts.items())
    print(
        f"{args.output}: {recorder.written} solutions; {stream.received} IMU samples read, {stream.accepted} "
        f"integrated{counts}"
    )
    if damage is not None:
        raise damage
    if navigator.state is None:
        raise InsNavError(f"{args.bag}: ended while {navigator.phase.value}: {_why(navigator)}")
    return 0


def _why(navigator: RealtimeNavigator) -> str:
    if navigator.progress < 1.0:
        return f"alignment had {100.0 * navigator.progress:.0f} % of its data; see the reports above"
    return "no position: the bag has no valid gnss/fix; add --param initial.latitude_deg:=... and the others"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ins_process",
        allow_abbrev=False,
        description="Navigate over a recording; the result is a bag with the topics of ins_node.",
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help="rosbag2 folder, .mcap or .db3 file")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT", help="folder of the bag to write")
    parser.add_argument(
        "--params-file", action="append", default=[], metavar="YAML", help="ROS 2 parameter file; may be repeated"
    )
    parser.add_argument(
        "--namespace",
        metavar="NS",
        help="namespace of the nodes whose sections of the parameter files apply (default: the one in the file)",
    )
    parser.add_argument(
        "--param", action="append", default=[], metavar="NAME:=VALUE", help="set a parameter; may be repeated"
    )
    parser.add_argument(
        "-m",
        "--remap",
        nargs="+",
        action="extend",
        default=[],
        metavar="OLD:=NEW",
        help="read topic OLD as NEW (/imu/data_raw, ...)",
    )
    parser.add_argument(
        "--nodes",
        nargs="+",
        default=NODES,
        metavar="NODE",
        help=f"nodes whose work is done, of {', '.join(NODES)} (default: all; ins_node always is)",
    )
    parser.add_argument("--save", action="store_true", help="write state_file at the end, as ins_node/save does")
    parser.add_argument("--overwrite", action="store_true", help="replace a bag that is there")
    return parser
