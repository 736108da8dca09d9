"""One figure of one or more results: track, attitude, and either errors against a reference or velocity."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator, MultipleLocator, ScalarFormatter

from ins_nav.errors import InsNavError
from ins_nav.report.comparison import Comparison, Errors, horizontal_offset
from ins_nav.report.series import Array, Attitudes, Positions, Stamps, Track, gaps

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Okabe and Ito's, which colour-blind people can distinguish."""
_REFERENCE = "0.25"
_SIGMAS = 3.0
_LEAST_ANGLE = 0.01
"""deg; and m/s and m below."""
_LEAST_SPEED = 0.02
_LEAST_POSITION = 0.02
_MINUTES_FROM = 600.0
"""s: longer time axes are in minutes."""


def figure(results: Sequence[Track], reference: Track | None = None, comparisons: Sequence[Comparison] = ()) -> Figure:
    """Draw results.

    Parameters
    ----------
    results : sequence of Track
        One at least, each in another colour.
    reference : Track, optional
    comparisons : sequence of Comparison
        Of each result with the reference, when there is one.
    """
    drawing = _Drawing(results, reference)
    has_attitude_errors = any(c.attitude is not None for c in comparisons)
    wide = 3 + has_attitude_errors
    fig = Figure(figsize=(16, 10), dpi=100, layout=ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.06))
    grid = fig.add_gridspec(4, wide, width_ratios=[1.35] + [1.0] * (wide - 1), height_ratios=[0.05, 1.0, 1.0, 1.0])
    columns = [[fig.add_subplot(grid[row, column]) for row in (1, 2, 3)] for column in range(1, wide)]
    track, speed = fig.add_subplot(grid[1:3, 0]), fig.add_subplot(grid[3, 0])
    drawing.track(track)
    drawing.speed(speed)
    drawing.attitude(columns[0])
    if comparisons:
        titles = [f"{name} position error, m" for name in ("east", "north", "up")]
        drawing.errors(columns[1], titles, [c.position for c in comparisons], 1.0, _LEAST_POSITION)
        if has_attitude_errors:
            titles = [f"{name} error, deg" for name in ("roll", "pitch", "heading")]
            drawing.errors(columns[2], titles, [c.attitude for c in comparisons], math.degrees(1.0), _LEAST_ANGLE)
    else:
        drawing.velocity(columns[1])
    for column in [*columns, [speed]]:
        for axes in column:
            drawing.dress(axes, labelled=axes is column[-1])
    legend = track.get_legend_handles_labels()[0]
    legend.append(Line2D([], [], color="black", marker="o", markerfacecolor="white", linestyle="", label="start"))
    legend.append(Line2D([], [], color="black", marker="s", linestyle="", label="end"))
    if any(np.isfinite(e.stddev).any() for c in comparisons for e in (c.position, c.attitude) if e is not None):
        legend.append(Patch(**_band("black"), label=f"±{_SIGMAS:g} sigma of the result"))
    top = fig.add_subplot(grid[0, :])
    top.axis("off")
    top.legend(handles=legend, loc="center left", ncols=len(legend), frameon=False, borderpad=0.0)
    return fig


def save(fig: Figure, path: Path) -> None:
    """Write the figure, in the format of the suffix.

    Raises
    ------
    InsNavError
    """
    try:
        fig.savefig(path)
    except OSError as error:
        raise InsNavError(f"{path}: cannot write the figure: {error.strerror}") from error
    except ValueError as error:
        raise InsNavError(f"{path}: cannot write the figure: {error}") from error


class _Drawing:
    """Time axis, colours and origin of the track, common to all panels."""

    def __init__(self, results: Sequence[Track], reference: Track | None) -> None:
        self._results = results
        self._reference = reference
        self._start_ns = min(int(r.position.stamps_ns[0]) for r in results)
        self._end_ns = max(int(r.position.stamps_ns[-1]) for r in results)
        self._minutes = (self._end_ns - self._start_ns) * 1e-9 > _MINUTES_FROM

    def _time(self, stamps_ns: Stamps) -> Array:
        return (stamps_ns - self._start_ns) / (60e9 if self._minutes else 1e9)

    def _within(self, stamps_ns: Stamps) -> slice:
        """Limits of the results: a reference may be longer."""
        return slice(*np.searchsorted(stamps_ns, [self._start_ns, self._end_ns + 1]))

    def _curve(self, axes: Axes, stamps_ns: Stamps, values: Array, colour: str, jump: float = np.inf) -> None:
        """A line with breaks where there are gaps in time, or jumps."""
        broken = gaps(stamps_ns) | (np.abs(np.diff(values)) > jump)
        at = np.flatnonzero(broken) + 1
        is_reference = colour == _REFERENCE
        axes.plot(
            np.insert(self._time(stamps_ns), at, np.nan),
            np.insert(values, at, np.nan),
            color=colour,
            linewidth=2.2 if is_reference else 1.2,
            alpha=0.5 if is_reference else 1.0,
        )

    def _all(self) -> list[tuple[Track, str]]:
        """Tracks and colours, the reference lowest."""
        coloured = [(r, _COLOURS[i % len(_COLOURS)]) for i, r in enumerate(self._results)]
        return [(self._reference, _REFERENCE), *coloured] if self._reference else coloured

    def track(self, axes: Axes) -> None:
        """Track, east and north from the start."""
        origin = self._results[0].position
        lat, lon, start = float(origin.lat[0]), float(origin.lon[0]), origin.ecef[:1]

        def local(position: Positions, part: slice) -> Array:
            return horizontal_offset(position.ecef[part], start, lat, lon)

        if self._reference:
            position = self._reference.position
            x, y = local(position, self._within(position.stamps_ns)).T
            # single fixes are dots; a line ends with a mark, since it may be a point
            style: dict[str, Any] = {"linestyle": "", "marker": "."}
            if self._reference.attitude is not None:
                style = {"linewidth": 2.2, "marker": "s", "markevery": [-1]}
            axes.plot(x, y, color=_REFERENCE, alpha=0.5, **style, label=f"reference {self._reference.name}")
        for result, colour in self._all()[-len(self._results) :]:
            x, y = local(result.position, slice(None)).T
            axes.plot(x, y, color=colour, linewidth=1.4, label=result.name)
            axes.plot(x[0], y[0], "o", color=colour, markerfacecolor="white", markersize=9)
            axes.plot(x[-1], y[-1], "s", color=colour, markersize=7)
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.08)
        _at_least(axes, _LEAST_POSITION)
        axes.set_title(f"track from {np.degrees(lat):.5f}°, {np.degrees(lon):.5f}°", loc="left", fontsize="medium")
        axes.set_xlabel("east, m")
        axes.set_ylabel("north, m")
        axes.grid(alpha=0.3)

    def speed(self, axes: Axes) -> None:
        """Horizontal speed."""
        for track, colour in self._all():
            if track.velocity is not None:
                part = self._within(track.velocity.stamps_ns)
                enu = track.velocity.enu[part]
                self._curve(axes, track.velocity.stamps_ns[part], np.hypot(enu[:, 0], enu[:, 1]), colour)
        axes.set_title("horizontal speed, m/s", loc="left", fontsize="medium")
        _at_least(axes, _LEAST_SPEED)

    def velocity(self, column: Sequence[Axes]) -> None:
        """East, north and up."""
        for i, (axes, name) in enumerate(zip(column, ("east", "north", "up"), strict=True)):
            for track, colour in self._all():
                if track.velocity is not None:
                    part = self._within(track.velocity.stamps_ns)
                    self._curve(axes, track.velocity.stamps_ns[part], track.velocity.enu[part, i], colour)
            axes.set_title(f"{name} velocity, m/s", loc="left", fontsize="medium")
            _at_least(axes, _LEAST_SPEED)

    def attitude(self, column: Sequence[Axes]) -> None:
        """Roll, pitch and heading; the axis of the heading is cut in the widest unused sector."""
        cut = _rarest_heading([result.attitude for result in self._results if result.attitude is not None])
        for track, colour in self._all():
            if track.attitude is not None:
                part = self._within(track.attitude.stamps_ns)
                euler = track.attitude.euler[part]
                euler[:, 2] = cut + (euler[:, 2] - cut) % (2.0 * np.pi)
                for i, axes in enumerate(column):
                    self._curve(axes, track.attitude.stamps_ns[part], np.degrees(euler[:, i]), colour, 180.0)
        for axes, name in zip(column, ("roll", "pitch", "heading"), strict=True):
            axes.set_title(f"{name}, deg", loc="left", fontsize="medium")
            _at_least(axes, _LEAST_ANGLE)
        column[2].yaxis.set_major_formatter(lambda value, _: f"{round(value % 360.0, 4) % 360.0:g}")
        if np.ptp(column[2].get_ylim()) > 150.0:
            column[2].yaxis.set_major_locator(MultipleLocator(45.0))

    def errors(
        self,
        column: Sequence[Axes],
        titles: Sequence[str],
        errors: Sequence[Errors | None],
        scale: float,
        least: float,
    ) -> None:
        """Three components of an error, times a scale, with a band of three sigma where it is given."""
        for i, (axes, title) in enumerate(zip(column, titles, strict=True)):
            axes.axhline(0.0, color=_REFERENCE, linewidth=0.8)
            for k, error in enumerate(errors):
                if error is None:
                    continue
                colour = _COLOURS[k % len(_COLOURS)]
                self._curve(axes, error.stamps_ns, scale * error.values[:, i], colour)
                band = _SIGMAS * scale * error.stddev[:, i]
                axes.fill_between(self._time(error.stamps_ns), -band, band, **_band(colour))
            axes.set_title(title, loc="left", fontsize="medium")
            _at_least(axes, least)

    def dress(self, axes: Axes, labelled: bool) -> None:
        """Time axis and grid."""
        axes.set_xlim(0.0, self._time(np.array([self._end_ns]))[0])
        axes.xaxis.set_major_locator(MaxNLocator(6))
        axes.grid(alpha=0.3)
        axes.tick_params(labelbottom=labelled)
        if isinstance(axes.yaxis.get_major_formatter(), ScalarFormatter):
            axes.ticklabel_format(axis="y", useOffset=False)
        if labelled:
            axes.set_xlabel("time since the first solution, " + ("min" if self._minutes else "s"))


def _rarest_heading(attitudes: Sequence[Attitudes]) -> float:
    """Middle of the widest sector, rad, in which no heading lies."""
    heading = np.unique(np.concatenate([attitude.euler[:, 2] for attitude in attitudes]))
    widths = np.diff(heading, append=heading[0] + 2.0 * np.pi)
    widest = int(np.argmax(widths))
    return float(heading[widest] + 0.5 * widths[widest] - 2.0 * np.pi)


def _band(colour: str) -> dict[str, Any]:
    """Style of a band of sigmas."""
    return {"facecolor": to_rgba(colour, 0.12), "edgecolor": to_rgba(colour, 0.5), "linewidth": 0.8}


def _at_least(axes: Axes, span: float) -> None:
    """Widen the vertical axis to a span below which only rounding is visible."""
    low, high = axes.get_ylim()
    if high - low < span:
        middle = 0.5 * (low + high)
        axes.set_ylim(middle - 0.5 * span, middle + 0.5 * span)
