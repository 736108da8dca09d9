"""Simulation: motion of a carrier over the ellipsoid, errors of its sensors, named scenarios, recordings with truth.

Imports `ins_nav.messages` and below, never `ins_nav.report`. Start with `ins_nav.simulation.scenarios`.
"""
