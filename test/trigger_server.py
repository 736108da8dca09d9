"""Stands in for ins_node: trigger_server.py [SERVICE=SENTENCE]...; a sentence that begins with "no" is a refusal.

Prints every call. Needs no more of ROS than the services.
"""

from typing import Any

from rclpy.node import Node
from std_srvs.srv import Trigger

from ins_nav.nodes.runtime import init, spin


def main() -> None:
    words = init()
    node = Node("trigger_server")
    for word in words:
        service, _, sentence = word.partition("=")
        node.create_service(Trigger, service, _answer(service, sentence))
    print("ready", flush=True)
    spin(node)


def _answer(service: str, sentence: str) -> Any:
    def answer(_request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        print(f"called {service}", flush=True)
        response.success = not sentence.startswith("no")
        response.message = sentence
        return response

    return answer


if __name__ == "__main__":
    main()
