"""Subscriptions to aids, of the message type that is published on each topic."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from ins_nav.aiding.base import Aid
from ins_nav.errors import InsNavError
from ins_nav.nodes import runtime

_DEPTH = 100


@dataclass
class _Topic:
    """A topic of an aid: installed types, the one in use, the subscription, the name with namespace and remaps."""

    name: str
    types: tuple[str, ...]
    used: str
    subscription: Any = None
    resolved: str = ""


class AidSubscriptions:
    """One subscription a topic, of the first type of the aid until a publisher of another supported type appears.

    Parameters
    ----------
    node : Node
    aids : iterable of Aid
    receive : callable
        Called with the topic, as the aid names it, and the message.

    Raises
    ------
    InsNavError
        No type of an aid is installed.
    """

    def __init__(self, node: Node, aids: Iterable[Aid[Any]], receive: Callable[[str, Any], None]) -> None:
        self._node = node
        self._receive = receive
        self._reported: set[str] = set()
        self._topics = []
        for aid in aids:
            installed = tuple(msgtype for msgtype in aid.MESSAGE_TYPES if _is_installed(msgtype))
            topic = _Topic(aid.topic, installed or aid.MESSAGE_TYPES, (installed or aid.MESSAGE_TYPES)[0])
            topic.subscription = self._subscribe(topic)
            topic.resolved = topic.subscription.topic_name
            self._topics.append(topic)

    def follow_publishers(self) -> None:
        """Subscribe with the types that are published now; log, once each, what cannot be received.

        To be called regularly. A DDS participant has one type a topic, and the executor uses a subscription until it
        has returned from a callback: the next call replaces one that this call ends.
        """
        for topic in self._topics:
            if topic.subscription is None:
                topic.subscription = self._subscribe(topic)
                self._node.get_logger().info(f"{topic.name}: {topic.used} is published there, subscribed")
                continue
            published = {info.topic_type for info in self._node.get_publishers_info_by_topic(topic.resolved)}
            found, problem = choose_type(topic.name, topic.types, topic.used, published)
            if problem and problem not in self._reported:
                self._reported.add(problem)
                self._node.get_logger().warning(problem)
            if found != topic.used:
                self._node.destroy_subscription(topic.subscription)
                topic.subscription, topic.used = None, found

    def _subscribe(self, topic: _Topic) -> Any:
        def on_message(message: Any) -> None:
            self._receive(topic.name, message)

        return self._node.create_subscription(
            runtime.message_class(topic.used),
            topic.name,
            on_message,
            QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )


def _is_installed(msgtype: str) -> bool:
    try:
        runtime.message_class(msgtype)
    except InsNavError:
        return False
    return True


def choose_type(topic: str, supported: Sequence[str], used: str, published: set[str]) -> tuple[str, str]:
    """The message type to subscribe with, and a line about publishers of other types; empty where there are none.

    Parameters
    ----------
    topic : str
    supported : sequence of str
        Types that the aid reads and that are installed, preferred first.
    used : str
        Type of the present subscription, kept while it has a publisher.
    published : set of str
        Types of the publishers on the topic.
    """
    available = [msgtype for msgtype in supported if msgtype in published]
    chosen = used if used in available or not available else available[0]
    others = ", ".join(sorted(published - {chosen}))
    if not others:
        return chosen, ""
    if available:
        return chosen, f"{topic}: {others} is published there besides {chosen}: only the latter is received"
    return chosen, f"{topic}: {others} is published there; supported here: {', '.join(supported)}"
