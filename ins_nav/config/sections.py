"""The sections of the parameters that are not of aids; see `ins_nav.config.declaration`.

Fields are in SI units and radians.
"""

import math
from dataclasses import dataclass

from ins_nav.config.declaration import (
    DEG,
    DEG_PER_HOUR,
    DEG_PER_SQRT_HOUR,
    MICRO_G,
    MILLI_G,
    Section,
    parameter,
)
from ins_nav.config.parameters import NAN, ParameterError

Vector = tuple[float, float, float]
_NS = 1e9
_SQRT_HOUR = 60.0
"""√s."""


@dataclass(frozen=True)
class ImuSection(Section):
    """``imu.*``: the IMU and its mounting."""

    sampling: str = parameter(
        "averaged",
        "meaning of a sample: mean over the interval that it ends (increment / interval), or value at its stamp",
        choices=("averaged", "instantaneous"),
    )
    mounting_rpy: Vector = parameter(
        [0.0, 0.0, 0.0],
        "roll, pitch, yaw of the IMU's axes in base_link",
        name="mounting_rpy_deg",
        unit="deg",
        low=-360.0,
        high=360.0,
        scale=DEG,
    )
    gyro_bias: Vector = parameter(
        [0.0, 0.0, 0.0],
        "initial gyro biases on base_link's axes",
        name="gyro_bias_deg_per_hour",
        unit="deg/h",
        scale=DEG_PER_HOUR,
    )
    accel_bias: Vector = parameter(
        [0.0, 0.0, 0.0],
        "initial accelerometer biases on base_link's axes",
        name="accel_bias_mg",
        unit="1e-3 g",
        scale=MILLI_G,
    )
    gyro_bias_stddev: float = parameter(
        0.01,
        "uncertainty of each gyro bias; coarse alignment cannot observe the east one: it adds to the heading's sigma",
        name="gyro_bias_stddev_deg_per_hour",
        unit="deg/h",
        low=0.0,
        scale=DEG_PER_HOUR,
    )
    gyro_bias_walk: float = parameter(
        0.003,
        "random walk of the gyro biases, their change in an hour; limits the use of a past ZUPT",
        name="gyro_bias_walk_deg_per_hour_per_sqrt_hour",
        unit="deg/h",
        low=0.0,
        scale=DEG_PER_HOUR / _SQRT_HOUR,
    )
    accel_bias_walk: float = parameter(
        0.01,
        "random walk of the accelerometer biases, their change in an hour",
        name="accel_bias_walk_mg_per_sqrt_hour",
        unit="1e-3 g",
        low=0.0,
        scale=MILLI_G / _SQRT_HOUR,
    )
    accel_bias_stddev: float = parameter(
        0.05,
        "uncertainty of each accelerometer bias",
        name="accel_bias_stddev_mg",
        unit="1e-3 g",
        low=0.0,
        scale=MILLI_G,
    )
    gyro_noise: float = parameter(
        NAN,
        "white noise of the gyros; not given: estimated at rest. Required where it exceeds stop.sway_deg_per_s",
        name="gyro_noise_deg_per_sqrt_hour",
        unit="deg/√h",
        low=0.0,
        high=100.0,
        scale=DEG_PER_SQRT_HOUR,
    )
    accel_noise: float = parameter(
        NAN,
        "white noise of the accelerometers; not given: estimated at rest. Required where it exceeds stop.vibration",
        name="accel_noise_ug_per_sqrt_hz",
        unit="1e-6 g/√Hz",
        low=0.0,
        high=1e5,
        scale=MICRO_G,
    )
    max_angular_velocity: float = parameter(
        35.0, "samples with a faster rate are rejected (35 is 2000 deg/s)", unit="rad/s", low=0.1
    )
    max_linear_acceleration: float = parameter(
        400.0, "samples with a larger specific force are rejected", unit="m/s^2", low=20.0
    )
    max_gap: float = parameter(
        10.0, "longest gap in the stamps that is bridged; a longer one restarts alignment", unit="s", low=0.1
    )

    @property
    def instantaneous(self) -> bool:
        """Samples are values at their stamps, not means over the intervals that they end."""
        return self.sampling == "instantaneous"


@dataclass(frozen=True)
class InitialSection(Section):
    """``initial.*``: position and heading at the start."""

    latitude: float = parameter(
        NAN,
        "latitude of the start; not given: from the first valid gnss/fix",
        name="latitude_deg",
        unit="deg",
        low=-90.0,
        high=90.0,
        scale=DEG,
    )
    longitude: float = parameter(
        NAN, "longitude of the start", name="longitude_deg", unit="deg", low=-360.0, high=360.0, scale=DEG
    )
    height: float = parameter(NAN, "ellipsoidal height of the start", unit="m", low=-12e3, high=1e6)
    position_stddev: float = parameter(1.0, "uncertainty of that position, each axis", unit="m", low=0.0, high=1e6)
    heading: float = parameter(
        NAN,
        "heading at rest, clockwise from north; given: alignment finds the level only",
        name="heading_deg",
        unit="deg",
        low=-360.0,
        high=360.0,
        scale=DEG,
    )
    heading_stddev: float = parameter(
        1.0, "uncertainty of that heading", name="heading_stddev_deg", unit="deg", low=0.0, high=180.0, scale=DEG
    )

    def __post_init__(self) -> None:
        if len({math.isnan(x) for x in (self.latitude, self.longitude, self.height)}) > 1:
            raise ParameterError(
                "initial.latitude_deg, initial.longitude_deg and initial.height go together: give all three or none"
            )


@dataclass(frozen=True)
class AlignmentSection(Section):
    """``alignment.*``: coarse and fine alignment."""

    duration: float = parameter(
        60.0, "length of coarse alignment that finds the heading", unit="s", low=5.0, high=3600.0
    )
    level_duration: float = parameter(
        5.0, "length of coarse alignment where the heading is given", unit="s", low=2.0, high=3600.0
    )
    max_speed: float = parameter(
        2.0, "a higher speed during coarse alignment is travel", unit="m/s", low=0.01, high=100.0
    )
    fine_heading: float = parameter(
        0.0,
        "fine alignment (alignment_node) ends when the heading's sigma is below this; 0: only by time",
        name="fine_heading_deg",
        unit="deg",
        low=0.0,
        high=180.0,
        scale=DEG,
    )
    fine_duration: float = parameter(
        300.0, "or after this time since the first sample", unit="s", low=0.0, high=86400.0
    )


@dataclass(frozen=True)
class NavigationSection(Section):
    """``navigation.*``: the mechanization."""

    vertical_channel: bool = parameter(
        False, "integrate vertical acceleration too: unstable without an aid of height; false: height stays"
    )
    water_surface: float = parameter(
        NAN,
        "ellipsoidal height of the water's surface, of a vehicle that dives: below it gravity is that in water, "
        "in 1000 m 88e-6 g less than in air; not given: air",
        unit="m",
        low=-500.0,
        high=9000.0,
    )


@dataclass(frozen=True)
class ZuptSection(Section):
    """``zupt.*``: corrections at stops."""

    zero_velocity: bool = parameter(
        True,
        "the filter measures zero velocity and the change of yaw at every stop; false: only when a ZUPT service is "
        "called (for a base that drifts without measurable motion, call none)",
    )
    max_rocking: float = parameter(
        10.0,
        "the ZUPT services refuse a base whose tilt varies more, RMS",
        name="max_rocking_deg",
        unit="deg",
        low=0.0,
        scale=DEG,
    )


@dataclass(frozen=True)
class StopSection(Section):
    """``stop.*``: motion of a vehicle that stands."""

    max_speed: float = parameter(
        0.1,
        "a higher mean speed over 1 s is travel; that of swell may stay below",
        unit="m/s",
        low=0.02,
        high=2.0,
    )
    vibration: float = parameter(
        0.02,
        "specific force of an idling engine, 0.1 s means, standard deviation an axis",
        unit="m/s^2",
        low=1e-4,
        high=1.0,
    )
    sway: float = parameter(
        0.06,
        "angular rate of an idling engine, 0.1 s means, standard deviation an axis",
        name="sway_deg_per_s",
        unit="deg/s",
        low=1e-4,
        high=10.0,
        scale=DEG,
    )


@dataclass(frozen=True)
class StopDetectorSection(Section):
    """``stop_detector.*``: which ZUPT service is called at a stop, and when."""

    start_sequence: str = parameter(
        "zupt1",
        "zupt1: call it until it has succeeded at two stops, then zupt2; zupt2: from the first stop on; none: from "
        "the second; never: for a base that drifts without measurable motion",
        choices=("zupt1", "zupt2", "none", "never"),
    )
    zupt1_after: float = parameter(
        20.0,
        "length of a stop at which ins_node/zupt1 is called; again after as long, until it succeeds",
        unit="s",
        low=1.0,
        high=3600.0,
    )
    zupt2_after: float = parameter(
        20.0,
        "length of a stop at which ins_node/zupt2 is called; again whenever the length has doubled, or after as "
        "long when it was refused",
        unit="s",
        low=1.0,
        high=3600.0,
    )

    @property
    def zupt1_after_ns(self) -> int:
        """ns."""
        return round(self.zupt1_after * _NS)

    @property
    def zupt2_after_ns(self) -> int:
        """ns."""
        return round(self.zupt2_after * _NS)


@dataclass(frozen=True)
class AidingSection(Section):
    """``aiding.*``: the filter, apart from each aid."""

    max_delay: float = parameter(
        2.2, "messages of aids that arrive later than this after their stamp are rejected", unit="s", low=2.2, high=8.0
    )
    feedback_time: float = parameter(
        1.0,
        "time from a sample to the correction that it leads to in ins_node (computation, transport), of recorded "
        "time; a replay at N times real time needs N times as much",
        unit="s",
        low=0.2,
        high=3.0,
    )
    until_aligned: bool = parameter(False, "use aids for fine alignment only, then navigate free inertial")
    height_walk: float = parameter(
        0.3, "random walk of height where the vertical channel is off", unit="m/√s", low=0.0, high=10.0
    )
    stop_velocity_stddev: float = parameter(
        0.02, "standard deviation of the mean velocity over a second of a stop", unit="m/s", low=1e-4, high=1.0
    )

    @property
    def max_delay_ns(self) -> int:
        """ns."""
        return round(self.max_delay * _NS)

    @property
    def feedback_time_ns(self) -> int:
        """ns."""
        return round(self.feedback_time * _NS)


@dataclass(frozen=True)
class StateFileSection(Section):
    """``state_file``."""

    path: str = parameter(
        "",
        "file of biases, calibrations of aids and the last pose: read at the start if it exists, written by "
        "ins_node/save",
        name="state_file",
    )


@dataclass(frozen=True)
class PublishSection(Section):
    """``publish.*``: rate and transforms of the output."""

    rate: float = parameter(
        0.0, "odometry, imu/data and fix a second; 0: one for every IMU sample", unit="Hz", low=0.0, high=2000.0
    )
    tf: str = parameter(
        "none",
        "transform on /tf: map_to_base_link (needs tf2_msgs) or none",
        choices=("none", "map_to_base_link"),
        former_values=((False, "none"), (True, "map_to_base_link")),
    )

    @property
    def period_ns(self) -> int:
        """ns from one solution to the next; 0: every one."""
        return round(_NS / self.rate) if self.rate else 0


@dataclass(frozen=True)
class FramesSection(Section):
    """``frames.*``: names of the frames in messages."""

    map: str = parameter("map", "frame_id of odometry: east-north-up at the start", former="map_frame")
    base_link: str = parameter("base_link", "frame_id of the body", former="base_link_frame")
