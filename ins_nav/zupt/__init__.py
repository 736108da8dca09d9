"""Calibration at stops: residual rates of a stationary carrier, ZUPT-1 and ZUPT-2, measurements for the filter.

Imports `ins_nav.stop_detection` and below. Start with `ins_nav.zupt.zupt_equations`.
"""
