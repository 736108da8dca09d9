"""Aids: GNSS, velocity log, depth gauge, acoustic ranges, each with its parameters, checks and measurement equation.

Imports `ins_nav.zupt` and below. Start with `ins_nav.aiding.base`.
"""
