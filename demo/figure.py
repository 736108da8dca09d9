"""The figure of the demo: where the vehicle was, and how well it knew it."""

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import StrMethodFormatter

from demo.mission import NAMES, Mission, local
from ins_nav.report.comparison import Comparison
from ins_nav.report.series import Array, Positions, Stamps, Track, interpolated

_COLOURS = ("#E69F00", "#56B4E9", "#0072B2", "#009E73")
"""Of the phases: Okabe and Ito's, which colour-blind people can tell apart."""
_SHADE, _FAINT = 0.13, 0.4
_ERROR, _BAND, _TRUTH, _VESSEL = "black", "0.4", "0.6", "#D55E00"
_SIGMAS = 3.0
_LEAST_HEADING, _GREATEST_HEADING = 0.01, 100.0
"""deg."""
_MARGIN = 1.3
_RAY = 4
"""One of so many ranges under water is drawn."""


def figure(mission: Mission, result: Track, reference: Track, comparison: Comparison) -> Figure:
    """Draw the track, the depth, and errors with three sigma."""
    attitude, position = comparison.attitude, comparison.position
    assert attitude is not None
    fig = Figure(figsize=(10.5, 7.4), dpi=150, layout="constrained")
    columns = fig.add_gridspec(1, 2, width_ratios=[1.0, 1.05])
    left = columns[0].subgridspec(2, 1, height_ratios=[2.4, 1.0])
    track, depth = fig.add_subplot(left[0]), fig.add_subplot(left[1])
    right = columns[1].subgridspec(3, 1)
    panels = [fig.add_subplot(right[i]) for i in range(3)]
    _track(track, mission, result, reference)
    _depth(depth, mission, result, reference)
    for i, name in enumerate(("east", "north")):
        _error(panels[i], mission, position.stamps_ns, position.values[:, i], position.stddev[:, i])
        panels[i].set_title(f"{name} position error, m", loc="left", fontsize="medium")
    # the first seconds of alignment are not worth most of the axis
    going = mission.time(position.stamps_ns) > mission.phases[1].start
    reach = _MARGIN * _SIGMAS * float(position.stddev[going, :2].max())
    for panel in panels[:2]:
        panel.set_ylim(-reach, reach)
    _heading(panels[2], mission, attitude.stamps_ns, *np.degrees([attitude.values[:, 2], attitude.stddev[:, 2]]))
    for panel in (depth, *panels):
        _dress(panel, mission)
    for panel in panels[:2]:
        panel.tick_params(labelbottom=False)
    for panel in (depth, panels[2]):
        panel.set_xlabel("time, min")
    lost = mission.log_lost.start / 60.0
    panels[0].annotate("log loses the bottom ", (lost, 0.93 * reach), ha="right", va="top", fontsize="small")
    handles: list[Artist] = [Patch(facecolor=c, alpha=0.6, label=name) for c, name in zip(_COLOURS, NAMES, strict=True)]
    handles += [
        Line2D([], [], color=_TRUTH, alpha=0.6, linewidth=4.0, label="truth"),
        Line2D([], [], color=_ERROR, label="error"),
        Patch(facecolor=_BAND, alpha=_FAINT, label="3 sigma"),
    ]
    fig.legend(
        handles=handles,
        loc="outside upper center",
        ncols=len(handles),
        frameon=False,
        columnspacing=1.3,
        handlelength=1.6,
    )
    return fig


def _track(axes: Axes, mission: Mission, result: Track, reference: Track) -> None:
    """East and north, with the way of every beacon and some of the ranges to it."""
    truth = local(reference.position, mission)
    for topic, ranges in mission.simulation.aids.items():
        prefix, _, name = topic.partition("/")
        if prefix != "range":
            continue
        at = ranges.beacon
        there = local(Positions(at.stamps_ns, at.lat, at.lon, at.height, np.empty(0)), mission)
        here = interpolated(reference.position.stamps_ns, truth, ranges.stamps_ns)
        time, dive = mission.time(ranges.stamps_ns), mission.phases[2]
        for rays in np.stack([there, here], axis=1)[(time > dive.start) & (time < dive.end)][::_RAY]:
            axes.plot(*rays.T, color=_VESSEL, alpha=0.22, linewidth=0.7)
        axes.plot(*there.T, color=_VESSEL, linewidth=1.8)
        middle = 0.5 * (there.min(axis=0) + there.max(axis=0))
        axes.annotate(name, middle, color=_VESSEL, ha="center", va="center")
    axes.plot(*truth.T, color=_TRUTH, alpha=0.6, linewidth=4.0)
    track = local(result.position, mission)
    _by_phase(axes, mission, result.position.stamps_ns, *track.T)
    axes.plot(*track[0], "o", color="black", markerfacecolor="white", markersize=7)
    axes.plot(*track[-1], "s", color="black", markersize=6)
    for text, point in (("start", track[0]), ("end", track[-1])):
        axes.annotate(text, point, xytext=(7, 5), textcoords="offset points")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("track: north over east, m", loc="left", fontsize="medium")
    axes.grid(alpha=0.3)


def _depth(axes: Axes, mission: Mission, result: Track, reference: Track) -> None:
    surface = mission.simulation.parameters["depth.surface_height"]
    truth, position = reference.position, result.position
    axes.plot(_minutes(mission, truth.stamps_ns), surface - truth.height, color=_TRUTH, alpha=0.6, linewidth=4.0)
    _by_phase(axes, mission, position.stamps_ns, _minutes(mission, position.stamps_ns), surface - position.height)
    axes.invert_yaxis()
    axes.set_title("depth, m", loc="left", fontsize="medium")


def _by_phase(axes: Axes, mission: Mission, stamps_ns: Stamps, x: Array, y: Array) -> None:
    """A line in the colours of the phases."""
    time = mission.time(stamps_ns)
    for span, colour in zip(mission.phases, _COLOURS, strict=True):
        part = (time >= span.start) & (time <= span.end)
        axes.plot(x[part], y[part], color=colour, linewidth=1.6)


def _error(axes: Axes, mission: Mission, stamps_ns: Stamps, error: Array, stddev: Array) -> None:
    minutes = _minutes(mission, stamps_ns)
    axes.fill_between(minutes, -_SIGMAS * stddev, _SIGMAS * stddev, color=_BAND, alpha=_FAINT, linewidth=0.0)
    axes.plot(minutes, error, color=_ERROR, linewidth=1.0)


def _heading(axes: Axes, mission: Mission, stamps_ns: Stamps, error: Array, stddev: Array) -> None:
    """The error's size: it falls by powers of ten."""
    minutes = _minutes(mission, stamps_ns)
    axes.set_yscale("log")
    axes.set_ylim(_LEAST_HEADING, _GREATEST_HEADING)
    axes.fill_between(minutes, _LEAST_HEADING, _SIGMAS * stddev, color=_BAND, alpha=_FAINT, linewidth=0.0)
    axes.plot(minutes, np.abs(error), color=_ERROR, linewidth=1.0)
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.set_title("heading error, size, deg", loc="left", fontsize="medium")


def _dress(axes: Axes, mission: Mission) -> None:
    """Time axis, phases, the log's loss of the bottom, grid."""
    for span, colour in zip(mission.phases, _COLOURS, strict=True):
        axes.axvspan(span.start / 60.0, span.end / 60.0, color=colour, alpha=_SHADE, linewidth=0.0)
    for time in mission.log_lost:
        axes.axvline(time / 60.0, color="0.3", linestyle=":", linewidth=1.0)
    axes.set_xlim(0.0, mission.phases[-1].end / 60.0)
    axes.grid(alpha=0.3)


def _minutes(mission: Mission, stamps_ns: Stamps) -> Array:
    minutes: Array = mission.time(stamps_ns) / 60.0
    return minutes
