"""Inertial navigation for ROS 2: mechanization, alignment, calibration at stops."""

import os

__version__ = "0.1.0"

# Matrices here are small: BLAS threads only make them wait for busy cores, a hundredfold in the worst case
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
