"""rosbag2 recordings (mcap, sqlite3): reading, writing, recovery of damaged files, without ROS.

Imports nothing of the package but `ins_nav.errors` and `ins_nav.config`. Start with `ins_nav.recordings.bags`.
"""
