"""Coarse alignment: level and heading from the direction of gravity in inertial space, with their covariance.

Imports `ins_nav.estimation`, `ins_nav.mechanization` and below. Start with `ins_nav.alignment.coarse_alignment`.
"""
