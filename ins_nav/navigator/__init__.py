"""The navigators: real-time solution at the IMU's rate, and the delayed filter that corrects it.

Imports `ins_nav.aiding` and below; knows no ROS and no files. Start with `ins_nav.navigator.realtime`.
"""
