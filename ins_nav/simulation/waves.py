"""Rocking by waves or on a test bench: parameters, and signals about a mean attitude and position."""

import math
from dataclasses import replace
from typing import NamedTuple

from ins_nav.simulation.motion import Signal, sinusoid
from ins_nav.simulation.parameters import Parameter, Values

ROCKING: dict[str, Parameter] = {
    "period": Parameter(11.0, "s", "period of roll and pitch", 0.1),
    "roll_amplitude_deg": Parameter(5.0, "deg", "amplitude of roll", 0.0, 90.0),
    "pitch_amplitude_deg": Parameter(5.0, "deg", "amplitude of pitch", 0.0, 60.0),
    "pitch_phase_deg": Parameter(90.0, "deg", "phase of pitch before roll"),
    "linear_period": Parameter(8.0, "s", "period of surge, sway and heave", 0.1),
    "surge_amplitude": Parameter(0.0, "m", "amplitude forward", 0.0),
    "sway_amplitude": Parameter(0.0, "m", "amplitude to the left, a third of a period after surge", 0.0),
    "heave_amplitude": Parameter(0.0, "m", "amplitude up, two thirds of a period after surge", 0.0),
}
"""On a bench: roll and pitch only."""
SWELL = ROCKING | {name: replace(ROCKING[name], default=0.5) for name in ("surge_amplitude", "heave_amplitude")}
"""At the surface of the sea."""


class Rocking(NamedTuple):
    """Signals to add: angles, rad (REP-103), and place on the plane, m."""

    roll: Signal
    pitch: Signal
    x: Signal
    y: Signal
    z: Signal


def rocking_signals(p: Values, envelope: Signal, along: float) -> Rocking:
    """Rocking of the parameters above, times the envelope; surge is along the given yaw, rad."""
    surge, sway, heave = (
        envelope * sinusoid(p[f"{axis}_amplitude"], p["linear_period"], -phase * 2.0 * math.pi / 3.0)
        for phase, axis in enumerate(("surge", "sway", "heave"))
    )
    pitch_phase = math.radians(p["pitch_phase_deg"])
    return Rocking(
        roll=envelope * sinusoid(math.radians(p["roll_amplitude_deg"]), p["period"]),
        pitch=envelope * sinusoid(math.radians(p["pitch_amplitude_deg"]), p["period"], pitch_phase),
        x=math.cos(along) * surge + -math.sin(along) * sway,
        y=math.sin(along) * surge + math.cos(along) * sway,
        z=heave,
    )
