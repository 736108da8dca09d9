"""`ins_system`: the nodes in one process, on one executor: the one-line start.

`ins_node`, `stop_detector_node` and `alignment_node`, each with its names, topics, services and parameters, share one
IMU stream, one stop detector, one alignment and one filter. What these report is logged under `ins_node`.
"""

import sys

from ins_nav.errors import for_people
from ins_nav.nodes import parameters, runtime
from ins_nav.nodes.alignment_node import AlignmentNode
from ins_nav.nodes.ins_node import InsNode
from ins_nav.nodes.stop_detector_node import StopDetectorNode


@for_people("ins_system")
def main(args: list[str] | None = None) -> None:
    """Run the nodes until SIGINT or SIGTERM."""
    if runtime.wants_no_node(runtime.init(args), "ins_system", __doc__):
        return
    alignment, detector = AlignmentNode(shared=True), StopDetectorNode(shared=True)
    ins = InsNode({**parameters.overrides(alignment), **parameters.overrides(detector)})
    alignment.attach(ins.system)
    ins.after_sample = detector.attach(ins.system)
    runtime.spin(ins, detector, alignment)


if __name__ == "__main__":
    sys.exit(main())
