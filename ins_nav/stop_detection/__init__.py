"""Stop detection from the IMU alone, and the schedule of the calibration services at stops.

Imports `ins_nav.alignment` and below. Start with `ins_nav.stop_detection.detector`.
"""
