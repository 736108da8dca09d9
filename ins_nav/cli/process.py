"""`ins_process`: the live system's core over a recording, without ROS, as fast as the machine allows."""

import argparse
import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ins_nav.aiding.registry import create_aids
from ins_nav.config.parameters import Value, parse_assignment, read_file
from ins_nav.errors import InsNavError, Interrupted, for_people
from ins_nav.mechanization.replay_buffer import Entries
from ins_nav.messages import diagnostics
from ins_nav.messages.cdr import ImuSample, read_imu
from ins_nav.messages.integrity import integrity
from ins_nav.messages.solution import SolutionMessages, fill_bias
from ins_nav.navigator.correction import NEVER_NS
from ins_nav.navigator.system import NavigationSystem, ScheduledCalls
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
from ins_nav.stamps import set_stamp

_IMU, _DIAGNOSTICS = "sensor_msgs/msg/Imu", "diagnostic_msgs/msg/DiagnosticArray"
_STATUS = "diagnostic_msgs/msg/DiagnosticStatus"
_BOOL = "std_msgs/msg/Bool"
_SECOND = 1_000_000_000
_IMU_TOPIC = "/imu/data_raw"
_MOST = 10_000
"""Messages of a batch: diagnostics end one after a second, unless the bag's stamps do not go on."""
Inputs = dict[str, tuple[str, ...]]
"""Topics that are read, with their types."""
NODES = ("ins_node", "stop_detector_node", "alignment_node")
"""Nodes whose work is done here by default, as in `ins_system`; that of the first always is."""


def _status(subject: str, level: int, text: str, values: dict[str, str]) -> Any:
    return message(
        _STATUS,
        level=level,
        name=f"ins_process: {subject}",
        message=text,
        hardware_id="imu",
        values=[message("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()],
    )


class Recorder:
    """Writes into a bag what the live node publishes, at the same stamps and rates."""

    def __init__(self, writer: BagWriter, system: NavigationSystem, aided: bool) -> None:
        self._writer = writer
        self._system = system
        self._navigator = navigator = system.realtime
        self._aided = aided
        self._base_link = navigator.configuration.frames.base_link
        self._out = SolutionMessages(navigator)
        self._topics = {"odometry": self._out.odometry, "imu/data": self._out.imu, "fix": self._out.fix}
        self.next_diagnostics_ns = 0
        self.written = 0
        """Solutions written."""
        for topic, content in self._topics.items():
            writer.add_topic(topic, content.msgtype)
        writer.add_topic("imu/bias", _IMU, latched=True)
        writer.add_topic("stopped", _BOOL, latched=True)
        writer.add_topic("diagnostics", _DIAGNOSTICS)
        if aided:
            writer.add_topic("integrity", _STATUS)

    def stopped(self, value: bool) -> None:
        """Record whether the vehicle is stopped."""
        self._writer.write("stopped", _BOOL, message(_BOOL, data=value), self._navigator.stamp_ns)

    def solutions(self) -> None:
        """Record the navigator's new solutions."""
        entries = self._navigator.entries
        for row, stamp_ns in enumerate(entries.stamps.tolist()):
            if self._out.due(stamp_ns):
                self._solution(entries, row, stamp_ns)

    def _solution(self, entries: Entries, row: int, stamp_ns: int) -> None:
        out = self._out
        if out.first:
            bias = message(_IMU)
            fill_bias(bias, self._navigator, self._base_link)
            set_stamp(bias, stamp_ns)
            self._writer.write("imu/bias", _IMU, bias, stamp_ns)
        out.fill(entries, row)
        for topic, content in self._topics.items():
            self._writer.write_raw(topic, content.msgtype, content.serialized(), stamp_ns)
        self.written += 1

    def tick(self, stamp_ns: int, last: bool = False) -> None:
        """Write diagnostics once a second of recorded time, and at its end."""
        if stamp_ns < self.next_diagnostics_ns and not last:
            return
        self.next_diagnostics_ns = stamp_ns + _SECOND
        statuses = {"navigation": diagnostics.diagnostics(self._navigator, self._system.services.solved)}
        if self._aided:
            statuses["alignment"] = diagnostics.alignment_diagnostics(self._system.delayed)
        status = [_status(subject, *values) for subject, values in statuses.items()]
        array = message(_DIAGNOSTICS, header=header(stamp_ns, ""), status=status)
        if self._aided:
            found = _status("alignment", *integrity(self._system.delayed))
            self._writer.write("integrity", _STATUS, found, stamp_ns)
        self._writer.write("diagnostics", _DIAGNOSTICS, array, stamp_ns)


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


Batch = list[RawMessage]
"""Messages of the IMU that follow each other, or one other message."""


def _batches(raw_messages: Iterable[RawMessage], names: dict[str, str], recorder: Recorder) -> Iterator[Batch]:
    """The messages in batches; one ends where diagnostics are due."""
    batch: Batch = []
    try:
        for raw in raw_messages:
            if names[raw.topic] != _IMU_TOPIC:
                if batch:
                    yield batch
                    batch = []
                yield [raw]
                continue
            batch.append(raw)
            if raw.stamp_ns >= recorder.next_diagnostics_ns or len(batch) == _MOST:
                yield batch
                batch = []
    except DamagedBagError:
        if batch:
            yield batch
        raise
    if batch:
        yield batch


def _read_imu(raw: RawMessage, reader: BagReader) -> ImuSample:
    try:
        return read_imu(raw.data)
    except ValueError as error:
        raise reader.invalid(raw, error) from error


def _add_imu(
    samples: list[ImuSample], system: NavigationSystem, recorder: Recorder, calls: ScheduledCalls | None
) -> None:
    """Process samples that follow each other, and record their solutions."""
    stamps = np.array([sample[0] for sample in samples], dtype=np.int64)
    values = np.array([sample[1:] for sample in samples])
    first = 0
    while first < len(stamps):
        until_ns = NEVER_NS if calls is None else calls.due_ns
        count, new = system.add_imu_run(stamps[first:], values[first:], until_ns)
        first += count
        if new:
            recorder.solutions()
        if calls is not None and system.front_end.stamp_ns:
            calls.after_sample()


def _with_progress(reader: BagReader, batches: Iterable[Batch], system: NavigationSystem) -> Iterator[Batch]:
    """The batches, with a bar over the recording's time; the system's reports are printed above it."""
    from tqdm import tqdm

    duration = (reader.end_ns - reader.start_ns) / _SECOND
    layout = "{l_bar}{bar}| {n:.0f}/{total:.0f} s [{elapsed}<{remaining}{postfix}]"
    with tqdm(total=duration, disable=None, bar_format=layout) as bar:
        for batch in batches:
            yield batch
            done = (batch[-1].stamp_ns - reader.start_ns) / _SECOND
            if done - bar.n >= 1.0:
                bar.set_postfix_str(_phase(system), refresh=False)
                bar.update(done - bar.n)
            for report in system.events.drain():
                bar.write(f"[{report.level}] {report.text}", file=sys.stderr)
        bar.update(duration - bar.n)


def _phase(system: NavigationSystem) -> str:
    delayed = system.delayed
    if delayed.filter is None:
        return system.phase.value
    text = f"{delayed.phase.value}, heading ± {math.degrees(delayed.filter.heading_stddev):.2f}°"
    return f"{text}, {delayed.time_left:.0f} s left" if delayed.time_left else text


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
    aided = "alignment_node" in args.nodes
    system = NavigationSystem(overrides, aided)
    if args.save and not system.configuration.state_file.path:
        raise InsNavError("--save: where to? Add --param state_file:=FILE")
    if args.output.resolve() in (args.bag.resolve(), args.bag.resolve().parent):
        raise InsNavError(f"{args.output}: is where the recording itself is; choose another name")
    damage = None
    with BagReader(args.bag) as reader:
        wanted = input_types(system.configuration.values)
        names = input_topics(reader, parse_remaps(args.remap), wanted)
        with BagWriter(args.output, args.overwrite) as writer:
            recorder = Recorder(writer, system, aided)
            calls = ScheduledCalls(system, recorder.stopped) if "stop_detector_node" in args.nodes else None
            try:
                batches = _batches(reader.messages(names), names, recorder)
                for batch in _with_progress(reader, batches, system):
                    topic = names[batch[0].topic]
                    if topic == _IMU_TOPIC:
                        _add_imu([_read_imu(raw, reader) for raw in batch], system, recorder, calls)
                    else:
                        system.add(topic.removeprefix("/"), reader.deserialize(batch[0]))
                        if calls is not None and system.front_end.stamp_ns:
                            calls.after_sample()
                    recorder.tick(batch[-1].stamp_ns)
            except DamagedBagError as error:
                damage = error
            except Interrupted:
                print(f"ins_process: interrupted; {args.output} ends there", file=sys.stderr)
                raise
            recorder.tick(reader.end_ns, last=True)
    if args.save:
        saved, text = system.save()
        if not saved:
            raise InsNavError(f"--save: {text}")
    stream = system.front_end.stream
    counts = "".join(f", {kind}: {count}" for kind, count in system.events.counts.items())
    print(
        f"{args.output}: {recorder.written} solutions; {stream.received} IMU samples read, {stream.accepted} "
        f"integrated{counts}"
    )
    if damage is not None:
        raise damage
    if system.realtime.state is None:
        raise InsNavError(f"{args.bag}: ended while {system.phase.value}: {_why(system)}")
    return 0


def _why(system: NavigationSystem) -> str:
    if system.front_end.progress < 1.0:
        return f"alignment had {100.0 * system.front_end.progress:.0f} % of its data; see the reports above"
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
