"""The carriers of `bench.faults` and its rows: every fault with its time, size and seed."""

import functools
import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench import fault_injection as inject
from bench.fault_injection import ACCEL, GYRO, IMU, Change, Fault, Recording, Span
from bench.fault_run import recording_of
from ins_nav.config.parameters import read_file
from ins_nav.simulation.scenarios import Simulation, simulate

_AUV = Path(__file__).resolve().parents[1] / "config" / "auv.yaml"
_RATE = 50.0
"""Hz, of the IMU."""
_DURATION = 600.0
"""s, of the vehicle and the car."""
FIX, VELOCITY, LOG, DEPTH, PRESSURE, HEADING = "gnss/fix", "gnss/velocity", "log", "depth", "pressure", "heading"
RANGE, BEACON = "range/vessel", "beacon/vessel/fix"


class Carrier(NamedTuple):
    """A simulated scenario and the parameters of its navigator."""

    scenario: str
    simulated: Mapping[str, Any]
    parameters: Mapping[str, Any]
    aligned: float
    """s, by which the clean run is aligned: errors count from there."""


_VEHICLE = {"duration": _DURATION, "rate": _RATE}
_FINE = {"alignment.fine_duration": 240.0}
_DIVE = {
    "rate": _RATE,
    "alignment_time": 180.0,
    "turn_start": 90.0,
    "surface_leg": 60.0,
    "depth": 20.0,
    "dive_time": 300.0,
    "leg_length": 60.0,
    "surface_time": 60.0,
}
_UNDER_WATER = {**read_file(_AUV, "ins_node"), "alignment.fine_duration": 180.0}
_MEMS = {
    "initial.heading_deg": 31.0,
    "initial.heading_stddev_deg": 1.0,
    "alignment.fine_duration": 60.0,
    "navigation.vertical_channel": True,
    "imu.gyro_bias_stddev_deg_per_hour": 200.0,
    "imu.gyro_bias_walk_deg_per_hour_per_sqrt_hour": 20.0,
    "imu.gyro_noise_deg_per_sqrt_hour": 0.3,
    "imu.gyro_scale_stddev_ppm": 2000.0,
    "imu.gyro_misalignment_stddev_arcsec": 200.0,
    "imu.accel_bias_stddev_mg": 5.0,
    "imu.accel_bias_walk_mg_per_sqrt_hour": 0.3,
    "imu.accel_noise_ug_per_sqrt_hz": 150.0,
    "imu.accel_scale_stddev_ppm": 2000.0,
    "imu.accel_misalignment_stddev_arcsec": 200.0,
}
_CENTIMETRES = {"gnss.rate": 5.0, "gnss.horizontal_stddev": 0.01, "gnss.vertical_stddev": 0.02}

CARRIERS = {
    "vehicle": Carrier("vehicle", _VEHICLE, _FINE, 250.0),
    "vehicle, velocity": Carrier("vehicle", _VEHICLE | {"gnss.velocity_rate": 1.0}, _FINE, 250.0),
    "vehicle, log": Carrier("vehicle", _VEHICLE | {"log.rate": 5.0}, _FINE, 250.0),
    "vehicle, heading": Carrier("vehicle", _VEHICLE | {"heading.rate": 1.0}, _FINE, 250.0),
    "dive": Carrier("auv_dive", _DIVE, _UNDER_WATER, 200.0),
    "dive, pressure": Carrier("auv_dive", _DIVE | {"depth.rate": 0.0, "pressure.rate": 5.0}, _UNDER_WATER, 200.0),
    "MEMS car": Carrier("vehicle", _VEHICLE | _CENTIMETRES | {"imu.preset": "mems"}, _MEMS, 250.0),
}
"""A vehicle by gyrocompass and metre fixes, a dive by log, depth and ranges, a MEMS car by centimetre fixes."""


@functools.lru_cache(2)
def simulated(carrier: str, seed: int, more: tuple[tuple[str, Any], ...] = ()) -> Simulation:
    """The simulation of a carrier with further parameters."""
    chosen = CARRIERS[carrier]
    return simulate(chosen.scenario, seed, **{**chosen.simulated, **dict(more)})


class Row(NamedTuple):
    """A fault on a carrier.

    Attributes
    ----------
    carrier, fault : str
    faults : tuple of Fault
        Applied in order.
    span : Span
        Of the whole.
    topic : str
        That a report must name.
    simulated : tuple of (name, value)
        Further parameters of the simulation: faults of the mounting.
    """

    carrier: str
    fault: str
    faults: tuple[Fault, ...]
    span: Span
    topic: str
    simulated: tuple[tuple[str, Any], ...] = ()

    @property
    def name(self) -> str:
        """Carrier and fault."""
        return f"{self.carrier}: {self.fault}"

    def recording(self, seed: int) -> tuple[Simulation, Recording]:
        """The simulation and the messages with the fault."""
        simulation = simulated(self.carrier, seed, self.simulated)
        recording = recording_of(simulation)
        for fault in self.faults:
            recording = fault(recording)
        return simulation, recording


_STAND, _STRAIGHT, _TURN = 422.0, 450.0, 477.0
"""s, of the vehicle and the car: a stop, 12 m/s straight on, a turn by 90° in 8 s."""
_LEG, _BEND = 320.0, 360.0
"""s, of the dive: straight on, a half turn."""
_START = Span(0.0)
_FRD = np.diag([1.0, -1.0, -1.0])
_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_DEG = math.radians(1.0)
_G = 9.80665
_EARTH = 6.371e6
"""m."""


def _row(carrier: str, text: str, topic: str, change: Change, span: Span) -> Row:
    return Row(carrier, text, (Fault((topic,), change, span),), span, topic)


def _imu(carrier: str, text: str, change: Change, begin: float, length: float = math.inf) -> Row:
    return _row(carrier, text, IMU, change, Span(begin, begin + length))


def _rows() -> list[Row]:
    rows = [Row(carrier, "none", (), Span(c.aligned), "") for carrier, c in CARRIERS.items()]
    lost = inject.lost
    for carrier, turn, straight in (
        ("vehicle", _TURN, _STRAIGHT),
        ("MEMS car", _TURN, _STRAIGHT),
        ("dive", _BEND, _LEG),
    ):
        rows += [
            _imu(carrier, "IMU lost 0.3 s, turning", lost, turn + 1.0, 0.3),
            _imu(carrier, "IMU lost 2 s, turning", lost, turn, 2.0),
            _imu(carrier, "IMU lost 5 s, straight", lost, straight, 5.0),
            _imu(carrier, "IMU lost 12 s, straight", lost, straight, 12.0),
            _imu(carrier, "gyro z frozen, turning", partial(inject.frozen, columns=slice(2, 3)), turn + 4.0),
            _imu(carrier, "accelerometer x frozen", partial(inject.frozen, columns=slice(3, 4)), straight),
            _imu(carrier, "mount turned by 5° in pitch", partial(inject.turned, rpy_deg=(0, 5, 0)), straight),
            _imu(carrier, "mount turned by 10° in yaw", partial(inject.turned, rpy_deg=(0, 0, 10)), straight),
            _imu(carrier, "each sample 4 times", partial(inject.repeated_values, count=4), straight),
            _imu(carrier, "force with the wrong sign", partial(inject.mapped, matrix=-1.0, columns=ACCEL), 0.0),
            _imu(carrier, "clock back by 1 s", partial(inject.stamped_late, delay=-1.0), straight),
            _imu(carrier, "clock ahead by 3 s", partial(inject.stamped_late, delay=3.0), straight),
        ]
    rows += [
        _imu("vehicle", "IMU lost 5 s, standing", lost, _STAND, 5.0),
        *_inertial("vehicle", 5.0 * _DEG / 3600.0, 2e-3 * _G, 4e-6, 7e-4),
        *_inertial("MEMS car", 0.3 * _DEG, 50e-3 * _G, 6e-4, 0.01),
        *_inertial("dive", 20.0 * _DEG / 3600.0, 5e-3 * _G, 1.9e-5, 0.007),
        _imu("vehicle", "gyros in deg/s", partial(inject.mapped, matrix=math.degrees(1.0), columns=GYRO), 0.0),
        _imu("vehicle", "gyros in deg/s under way", partial(inject.mapped, matrix=57.3, columns=GYRO), _STRAIGHT),
        _imu("vehicle", "force in g", partial(inject.mapped, matrix=1.0 / _G, columns=ACCEL), 0.0),
        _imu("vehicle", "forward-right-down", partial(inject.mapped, matrix=np.kron(np.eye(2), _FRD)), 0.0),
        _imu(
            "vehicle",
            "forward-right-down under way",
            partial(inject.mapped, matrix=np.kron(np.eye(2), _FRD)),
            _STRAIGHT,
        ),
        _imu(
            "vehicle",
            "x and y of the gyros swapped",
            partial(inject.mapped, matrix=[[0, 1, 0], [1, 0, 0], [0, 0, 1]], columns=GYRO),
            0.0,
        ),
        _imu("vehicle", "gyros with the wrong sign", partial(inject.mapped, matrix=-1.0, columns=GYRO), 0.0),
        _imu("vehicle", "force exactly zero 10 s", partial(inject.replaced, value=0.0, columns=ACCEL), _STRAIGHT, 10.0),
        _imu("vehicle", "NaN 2 s, turning", partial(inject.replaced, value=math.nan), _TURN, 2.0),
        _imu("vehicle", "rate halved", partial(inject.thinned, count=2), _STRAIGHT),
        _imu("vehicle", "rate doubled", partial(inject.split, count=2), _STRAIGHT),
        _imu("vehicle", "batches of 10, stamped on arrival", partial(inject.batched, count=10), 0.0),
        _imu("vehicle", "batches of 10 under way", partial(inject.batched, count=10), _STRAIGHT),
        _imu("vehicle", "stamps jitter by 5 ms", partial(inject.jitter, stddev=5e-3, seed=1), 0.0),
        _imu("vehicle", "clock fast by 0.1 %", partial(inject.stamped_late, delay=0.0, rate=1e-3), 0.0),
        _imu("MEMS car", "clock fast by 0.1 %", partial(inject.stamped_late, delay=0.0, rate=1e-3), 0.0),
    ]
    for carrier in ("vehicle", "MEMS car"):
        rows += _fixes(carrier)
    return [*rows, _float(), *_velocities(), *_under_water()]


def _inertial(carrier: str, gyro: float, accel: float, gyro_noise: float, accel_noise: float) -> list[Row]:
    """Saturation, shock, ramp, noise: the last four are sizes in rad/s and m/s²."""
    begin, turn = (_LEG, _BEND) if carrier == "dive" else (_STRAIGHT, _TURN)
    step, ramp = np.repeat([gyro, accel], 3), np.repeat([gyro, accel], 3) / 60.0
    noise = 10.0 * np.repeat([gyro_noise, accel_noise], 3)
    limit = 0.05 if carrier == "dive" else 0.1
    return [
        _imu(carrier, f"gyros saturate at {limit:g} rad/s", partial(inject.clipped, limit=limit, columns=GYRO), turn),
        _imu(carrier, "accelerometers saturate at 9.6 m/s²", partial(inject.clipped, limit=9.6, columns=ACCEL), begin),
        _imu(carrier, "shock in all biases", partial(inject.offset, size=step), begin),
        _imu(carrier, "biases ramp up for 60 s", partial(inject.offset, size=0.0, rate=ramp), begin, 60.0),
        _imu(carrier, "noise ten times", partial(inject.noisy, stddev=noise, seed=1), begin),
    ]


def _metres(east: float, north: float, up: float = 0.0) -> list[float]:
    """The same in degrees and m, near 55.7°."""
    return [math.degrees(north / _EARTH), math.degrees(east / _EARTH / math.cos(55.7 * _DEG)), up]


def _fixes(carrier: str) -> list[Row]:
    begin = _STRAIGHT
    swap = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    radians = np.diag([_DEG, _DEG, 1.0])

    def fix(text: str, change: Change, begin: float = begin, length: float = math.inf) -> Row:
        return _row(carrier, text, FIX, change, Span(begin, begin + length))

    rows = [
        fix("fixes (0, 0, 0), status 0, 90 s", partial(inject.replaced, value=0.0), begin, 90.0),
        fix("fixes NaN with a fix 30 s", partial(inject.replaced, value=math.nan), begin, 30.0),
        fix("fixes jump by 50 m for 90 s", partial(inject.offset, size=_metres(40, 30)), begin, 90.0),
        fix("fixes jump by 5 km for 90 s", partial(inject.offset, size=_metres(4000, 3000)), begin, 90.0),
        fix("fixes frozen 90 s", inject.frozen, begin, 90.0),
        fix("fixes drift by 0.5 m/s for 90 s", partial(inject.offset, size=0.0, rate=_metres(0.4, 0.3)), begin, 90.0),
        fix("heights on the geoid from now on", partial(inject.offset, size=_metres(0, 0, -40.0)), begin),
        fix("other datum from the start: 100 m", partial(inject.offset, size=_metres(80, 60)), 0.0),
        fix("latitude and longitude swapped", partial(inject.mapped, matrix=swap), 0.0),
        fix("latitude and longitude in radians", partial(inject.mapped, matrix=radians), 0.0),
        fix("fixes stamped 0.15 s late", partial(inject.stamped_late, delay=0.15), 0.0),
        fix("fixes stamped 1 s early", partial(inject.stamped_late, delay=-1.0), 0.0),
        fix("fixes stamped 3 s ahead", partial(inject.stamped_late, delay=3.0), 0.0),
        fix(
            "fixes 100 times too fast",
            partial(inject.multiplied, count=100 if carrier == "vehicle" else 10),
            begin,
            20.0,
        ),
        fix(
            "correlated error of 3 m told as noise",
            partial(inject.correlated, stddev=_metres(3, 3, 3), correlation_time=60.0, seed=1),
            0.0,
        ),
    ]
    said = Span(0.0)
    lever = (("gnss.lever_arm", (1.0, 0.5, 1.2)),)
    return [
        *rows,
        Row(carrier, "lever arm of 1.6 m not given", (), said, FIX, lever),
        Row(
            carrier,
            "covariance 0 and 3 m noise",
            _two(partial(inject.noisy, stddev=_metres(3, 3, 3), seed=1), partial(inject.with_stddev, stddev=0.0), said),
            said,
            FIX,
        ),
        Row(
            carrier,
            "3 m noise told as 3 cm",
            _two(
                partial(inject.noisy, stddev=_metres(3, 3, 3), seed=1), partial(inject.with_stddev, stddev=0.03), said
            ),
            said,
            FIX,
        ),
        Row(
            carrier,
            "no-fix status with 500 m errors 30 s",
            _two(
                partial(inject.offset, size=_metres(500, 0)),
                partial(inject.with_status, status=-1),
                Span(begin, begin + 30.0),
            ),
            Span(begin, begin + 30.0),
            FIX,
        ),
    ]


def _float() -> Row:
    """Fixes of 1 cm but for 100 s, in which they are 0.8 m off with an honest 0.5 m."""
    span = Span(330.0, 430.0)
    faults = _two(partial(inject.offset, size=_metres(0.64, 0.48)), partial(inject.with_stddev, stddev=0.5), span)
    return Row("MEMS car", "float for 100 s, 0.8 m off, then fixed", faults, span, FIX)


def _two(first: Change, second: Change, span: Span, topic: str = FIX) -> tuple[Fault, ...]:
    return Fault((topic,), first, span), Fault((topic,), second, span)


def _velocities() -> list[Row]:
    begin = _STRAIGHT
    return [
        _row("vehicle, velocity", "velocity in north-east-down", VELOCITY, partial(inject.mapped, matrix=_NED), _START),
        _row(
            "vehicle, velocity",
            "velocity in north-east-down under way",
            VELOCITY,
            partial(inject.mapped, matrix=_NED),
            Span(begin),
        ),
        _row(
            "vehicle, velocity",
            "velocity zero 60 s",
            VELOCITY,
            partial(inject.replaced, value=0.0),
            Span(begin, begin + 60.0),
        ),
        _row(
            "vehicle, velocity",
            "velocity on the body's axes",
            VELOCITY,
            partial(inject.turned, rpy_deg=(0, 0, 60)),
            _START,
        ),
        _row("vehicle, log", "log forward-right-down", LOG, partial(inject.mapped, matrix=_FRD), _START),
        _row("vehicle, log", "log turned by 45°", LOG, partial(inject.turned, rpy_deg=(0, 0, 45)), _START),
        _row("vehicle, log", "log zero 60 s", LOG, partial(inject.replaced, value=0.0), Span(begin, begin + 60.0)),
        _row("vehicle, log", "log in km/h", LOG, partial(inject.mapped, matrix=3.6), _START),
        _row(
            "vehicle, heading",
            "heading off by 20° under way",
            HEADING,
            partial(inject.offset, size=20.0 * _DEG),
            Span(begin),
        ),
        _row("vehicle, heading", "heading clockwise from north", HEADING, _clockwise, _START),
        _row("vehicle, heading", "heading frozen", HEADING, inject.frozen, Span(begin)),
    ]


def _clockwise(stream: inject.Stream, span: Span) -> inject.Stream:
    """Yaw from east to the left as heading from north to the right."""
    return inject.offset(inject.mapped(stream, span, -1.0), span, 0.5 * math.pi)


def _under_water() -> list[Row]:
    leg = _LEG
    minute = Span(leg, leg + 60.0)

    def dive(text: str, topic: str, change: Change, span: Span) -> Row:
        return _row("dive", text, topic, change, span)

    return [
        dive("log forward-right-down", LOG, partial(inject.mapped, matrix=_FRD), _START),
        dive("log turned by 45°", LOG, partial(inject.turned, rpy_deg=(0, 0, 45)), _START),
        dive("log lost, NaN, 60 s", LOG, partial(inject.replaced, value=math.nan), minute),
        dive("log lost, -32.768, 60 s", LOG, partial(inject.replaced, value=-32.768), minute),
        dive("log zero 60 s", LOG, partial(inject.replaced, value=0.0), minute),
        dive("log frozen 60 s", LOG, inject.frozen, Span(_BEND - 20.0, _BEND + 40.0)),
        dive("log on water track: 0.5 m/s current", LOG, partial(inject.offset, size=[0.4, -0.3, 0.0]), minute),
        dive("log with spikes of 3 m/s, 20 %", LOG, partial(inject.spikes, share=0.2, size=3.0, seed=1), Span(leg)),
        dive(
            "log: 10 cm/s correlated told as 1 cm/s",
            LOG,
            partial(inject.correlated, stddev=0.1, correlation_time=5.0, seed=1),
            _START,
        ),
        dive("depth with the wrong sign", DEPTH, partial(inject.mapped, matrix=-1.0), _START),
        dive("depth off by 5 m", DEPTH, partial(inject.offset, size=5.0), Span(leg)),
        dive("depth frozen", DEPTH, inject.frozen, Span(260.0)),
        dive("depth drifts by 2 cm/s", DEPTH, partial(inject.offset, size=0.0, rate=0.02), Span(leg)),
        _row("dive, pressure", "pressure in hPa", PRESSURE, partial(inject.mapped, matrix=0.01), _START),
        dive("ranges doubled", RANGE, partial(inject.mapped, matrix=2.0), _START),
        dive("ranges doubled under way", RANGE, partial(inject.mapped, matrix=2.0), Span(leg)),
        dive("ranges 4 m too long", RANGE, partial(inject.offset, size=4.0), _START),
        dive("ranges in ms", RANGE, partial(inject.mapped, matrix=1.0 / 1.5), _START),
        dive("beacon lies by 100 m", BEACON, partial(inject.offset, size=_metres(80, 60)), Span(leg)),
        dive("beacon lies by 100 m from the start", BEACON, partial(inject.offset, size=_metres(80, 60)), _START),
        dive("fixes off by 50 m after the dive", FIX, partial(inject.offset, size=_metres(40, 30)), Span(500.0)),
        dive("lever arm of the log wrong by 2 m", LOG, inject.lost, _START)._replace(
            faults=(), simulated=(("log.lever_arm", (2.6, 0.0, -0.2)),)
        ),
    ]


ROWS = {row.name: row for row in _rows()}
