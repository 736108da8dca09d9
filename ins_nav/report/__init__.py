"""Figures and tables of result bags, with errors against a reference where there is one.

Imports `ins_nav.messages` and below, never `ins_nav.simulation`. Start with `ins_nav.report.series`.
"""
