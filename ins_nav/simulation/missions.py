"""A mission under water: the motion of scenario `auv_dive` and its parameters."""

import math
from typing import Any

from scipy.integrate import quad

from ins_nav.errors import InsNavError
from ins_nav.mechanization import attitude
from ins_nav.simulation.motion import Motion, Route, integral_of_profile, smooth_profile
from ins_nav.simulation.parameters import Parameter, Values
from ins_nav.simulation.waves import SWELL, rocking_signals

_START_TIME = 10.0
"""Time of the acceleration to cruise speed, in which the swell decays, s."""
_BOX_LEG, _BOX_TURN = 25.0, 10.0
"""Sides and turns of the box at the surface, s."""
_PITCH_TIME = 10.0
"""Time of a change of pitch to the glide angle or back, s."""
_DRAUGHT = 2.0
"""Largest distance of the IMU from the water's surface while the vehicle floats, m."""

AUV_DIVE: dict[str, Any] = {
    "duration": Parameter(0.0, "s", "length of the recording, 0: the whole mission", 0.0, 1e5),
    "rate": 100.0,
    "height": 0.0,
    "imu.preset": "fog_auv",
    **SWELL,
    "alignment_time": Parameter(300.0, "s", "time of rocking in the swell, not under way", 0.0),
    "turn_deg": Parameter(180.0, "deg", "turn during that time, to the left, 0 for none"),
    "turn_start": Parameter(150.0, "s", "when that turn begins", 0.0),
    "turn_time": Parameter(20.0, "s", "duration of that turn", 0.1),
    "speed": Parameter(1.5, "m/s", "horizontal speed, under way", 0.1),
    "surface_leg": Parameter(120.0, "s", "time of a box at the surface after that", _START_TIME),
    "surface_swell": Parameter(0.3, "", "share of the swell under way at the surface", 0.0, 1.0),
    "depth": Parameter(50.0, "m", "depth of the dive", 1.0, 11_000.0),
    "glide_angle_deg": Parameter(12.0, "deg", "pitch while it dives and surfaces", 1.0, 45.0),
    "dive_time": Parameter(3600.0, "s", "time from the beginning of the dive to the surface", 1.0),
    "leg_length": Parameter(300.0, "m", "length of the parallel legs", 1.0),
    "leg_spacing": Parameter(30.0, "m", "distance between legs; turns alternate between left and right", 1.0),
    "surface_time": Parameter(120.0, "s", "time at the surface after the dive", 0.0),
    "gnss.lever_arm": (0.0, 0.0, 0.5),
    "gnss.lost_depth": 0.3,
    "log.rate": 5.0,
    "log.lever_arm": (0.6, 0.0, -0.2),
    "log.noise_per_speed": 0.002,
    "log.scale_stddev": 0.002,
    "log.misalignment_stddev_deg": 0.1,
    "depth.rate": 5.0,
    "depth.lever_arm": (-0.4, 0.0, 0.1),
    "beacon.names": "vessel",
    "beacon.positions": (0.0, -200.0, -2.0),
    "beacon.radii": (50.0,),
    "beacon.fix_rates": (1.0,),
    "range.rate": 0.2,
    "range.delay_speed": 1500.0,
    "range.lever_arm": (-0.2, 0.0, 0.2),
    "truth.rate": 10.0,
}
"""Log of 0.2 % and 1 cm/s, depth to 5 cm, two-way ranges to 0.5 m to a vessel that circles."""


def auv_dive(p: Values) -> Motion:
    """The motion: along the bow all the time, apart from the swell."""
    if abs(p["height"] - p["depth.surface_height"]) > _DRAUGHT:
        raise InsNavError(
            f"height {p['height']:g} m differs from the height of the water, "
            f"depth.surface_height {p['depth.surface_height']:g} m; give both"
        )
    speed, aligned = p["speed"], p["alignment_time"]
    heading = attitude.heading_from_yaw(math.radians(p["heading_deg"]))  # as yaw
    route = Route(heading)
    if p["turn_deg"]:
        if p["turn_start"] + p["turn_time"] > aligned:
            raise InsNavError(
                f"turn_start {p['turn_start']:g} s and turn_time {p['turn_time']:g} s: the turn goes beyond "
                f"alignment_time {aligned:g} s; make that longer, or turn_deg 0"
            )
        route.hold(p["turn_start"])
        route.turn(math.radians(p["turn_deg"]), p["turn_time"])
    route.hold(aligned - route.time)
    route.reach(speed, _START_TIME)
    dive = aligned + p["surface_leg"]
    while route.time + _BOX_LEG + _BOX_TURN <= dive:
        route.hold(_BOX_LEG)
        route.turn(0.5 * math.pi, _BOX_TURN)
    route.hold(dive - route.time)
    surfaced = dive + p["dive_time"]
    _parallel_legs(route, p, surfaced)

    climb, descent = _vertical(p, dive, surfaced)
    angle = math.atan2(descent, speed)
    fade = 0.5 * (p["depth"] / descent + _PITCH_TIME)
    share = p["surface_swell"]
    envelope = smooth_profile(1.0, [(aligned, _START_TIME, share), (dive, fade, 0.0), (surfaced - fade, fade, share)])
    waves = rocking_signals(p, envelope, heading)
    return Motion(
        p["duration"] or surfaced + p["surface_time"],
        speed=route.speed,
        yaw=route.yaw,
        pitch=(-angle / descent) * smooth_profile(0.0, climb) + waves.pitch,
        roll=waves.roll,
        x=waves.x,
        y=waves.y,
        z=integral_of_profile(0.0, climb) + waves.z,
    )


def _parallel_legs(route: Route, p: Values, until: float) -> None:
    """Legs joined by half turns until the time given, s, then straight on once no further turn fits."""
    # a half turn as smooth as all others moves the vehicle aside by this, for a speed and a duration of 1
    turning = smooth_profile(0.0, [(0.0, 1.0, math.pi)])
    aside, _ = quad(lambda x: math.sin(float(turning(x))), 0.0, 1.0)
    leg, turn = p["leg_length"] / p["speed"], p["leg_spacing"] / (p["speed"] * aside)
    side = 1.0
    while route.time + leg + turn <= until:
        route.hold(leg)
        route.turn(side * math.pi, turn)
        side = -side


def _vertical(p: Values, dive: float, surfaced: float) -> tuple[list[tuple[float, float, float]], float]:
    """Changes of the rate of climb, and the rate of the descent, m/s."""
    descent = min(p["speed"] * math.tan(math.radians(p["glide_angle_deg"])), p["depth"] / _PITCH_TIME)
    down = p["depth"] / descent  # from the middle of one change of pitch to that of the next
    if surfaced - dive < 2.0 * (down + _PITCH_TIME):
        raise InsNavError(
            f"dive_time {p['dive_time']:g} s is too short for {p['depth']:g} m: "
            f"give {math.ceil(2.0 * (down + _PITCH_TIME))} s or more, or a larger glide_angle_deg"
        )
    up = surfaced - down - _PITCH_TIME
    changes = [
        (dive, _PITCH_TIME, -descent),
        (dive + down, _PITCH_TIME, 0.0),
        (up, _PITCH_TIME, descent),
        (up + down, _PITCH_TIME, 0.0),
    ]
    return changes, descent
