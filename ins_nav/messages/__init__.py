"""Standard ROS messages from and to the navigators' plain numbers, for rclpy's classes and for recordings alike.

Imports `ins_nav.navigator` and below. Start with `ins_nav.messages.inputs` and `ins_nav.messages.solution`.
"""
