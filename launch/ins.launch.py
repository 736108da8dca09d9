"""Start ins_system with a parameter file, in a namespace: ros2 launch ins_nav ins.launch.py params_file:=my.yaml."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([FindPackageShare("ins_nav"), "config", "ins.yaml"]),
                description="ROS 2 parameter YAML (/**: ros__parameters:)",
            ),
            DeclareLaunchArgument("namespace", default_value="", description="Namespace of topics and services"),
            Node(
                package="ins_nav",
                executable="ins_system",
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration("params_file")],
                output="screen",
            ),
        ]
    )
