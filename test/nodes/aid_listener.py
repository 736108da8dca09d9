"""A node that subscribes to one aid: aid_listener.py TOPIC TYPE...; prints what it receives."""

from types import SimpleNamespace
from typing import Any

from rclpy.node import Node

from ins_nav.nodes.aid_subscriptions import AidSubscriptions
from ins_nav.nodes.runtime import init, spin


def main() -> None:
    topic, *types = init()
    node = Node("aid_listener")
    received: set[str] = set()

    def receive(name: str, message: Any) -> None:
        kind = type(message).__name__
        if kind not in received:
            received.add(kind)
            print(f"received {kind} on {name}", flush=True)

    aids: list[Any] = [SimpleNamespace(topic=topic, MESSAGE_TYPES=tuple(types))]
    subscriptions = AidSubscriptions(node, aids, receive)
    node.create_timer(0.2, subscriptions.follow_publishers)
    print(f"subscribed to {topic}", flush=True)
    spin(node)


if __name__ == "__main__":
    main()
