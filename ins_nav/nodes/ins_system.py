"""`ins_system`: the nodes in one process, on one executor: the one-line start.

`ins_node`, `stop_detector_node` and `alignment_node`, with their own names, topics, services and parameters.
"""

import sys

from ins_nav.errors import for_people
from ins_nav.nodes import runtime
from ins_nav.nodes.alignment_node import AlignmentNode
from ins_nav.nodes.ins_node import InsNode
from ins_nav.nodes.stop_detector_node import StopDetectorNode


@for_people("ins_system")
def main(args: list[str] | None = None) -> None:
    """Run the nodes until SIGINT or SIGTERM."""
    if runtime.wants_no_node(runtime.init(args), "ins_system", __doc__):
        return
    runtime.spin(InsNode(), StopDetectorNode(), AlignmentNode())


if __name__ == "__main__":
    sys.exit(main())
