"""ROS 2 at the edge: nodes translate messages and call the core."""

import sys

try:
    import rclpy  # noqa: F401
except ModuleNotFoundError:
    sys.exit("ins_nav: rclpy is missing; source /opt/ros/jazzy/setup.bash, or pip install 'ins_nav[jazzy]'")
