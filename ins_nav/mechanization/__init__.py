"""Strapdown mechanization on the WGS-84 ellipsoid: IMU stream, attitude, velocity, position, replay of past samples.

The lowest layer of computation: imports no folder above it. Start with `ins_nav.mechanization.strapdown`.
"""
