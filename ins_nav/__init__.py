"""Inertial navigation for ROS 2: mechanization, alignment, calibration at stops, aided navigation.

Folders are layers: each imports from those below it only (README, "How it is built"; ``[importlinter]`` in setup.cfg).
Start with `ins_nav.mechanization`, then `ins_nav.navigator`.
"""

__version__ = "0.1.0"
