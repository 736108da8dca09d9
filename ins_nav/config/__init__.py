"""Parameters: declared once with unit, range and text, read from ROS 2 YAML, checked; the state file between starts.

Imports nothing of the package but `ins_nav.errors`. Start with `ins_nav.config.parameters`.
"""
