"""Figures and tables out of result bags, against a reference when there is one."""
