"""ROS 2 nodes: they translate messages, parameters and services, and call the core; nothing is computed here.

Top layer beside `ins_nav.cli`, and the only folder that imports rclpy. Start with `ins_nav.nodes.ins_node`.
"""

import os

# Before numpy: matrices here are small, and BLAS threads that wait for busy cores cost up to a hundredfold.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
