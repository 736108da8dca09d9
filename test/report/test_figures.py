"""Figures of results."""

import numpy as np

from ins_nav.report import figures


def test_heading_curve_does_not_jump_at_north(off):
    result, reference, errors = off
    (heading,) = [
        axes for axes in figures.figure([result], reference, [errors]).axes if axes.get_title("left") == "heading, deg"
    ]
    for line in heading.get_lines():
        values = line.get_ydata()
        assert np.isfinite(values).all()
        assert np.abs(np.diff(values)).max() < 10.0
    assert heading.yaxis.get_major_formatter()(-45.0, 0) == "315"
