"""A correction of the delayed filter as a message, and back."""

import math
from typing import Any

import numpy as np

from ins_nav.estimation.state_layout import SOLUTION_SIZE
from ins_nav.event_log import WARN, EventLog
from ins_nav.mechanization.nav_state import NavState
from ins_nav.navigator.correction import Correction
from ins_nav.stamps import NS

FEEDBACK = (
    ("stamp", 2),
    ("apply", 2),
    ("state", 12),
    ("gyro_bias", 3),
    ("accel_bias", 3),
    ("aligned", 1),
)
"""Parts of a feedback message, with their sizes; further errors of the IMU and the covariance follow."""
_UNIT = 1e-6
"""Of a unit quaternion's length."""


def fill_feedback(message: Any, feedback: Correction) -> None:
    """A std_msgs/Float64MultiArray of one row: stamps as s and ns, state, biases, a flag, errors, covariance.

    One message, so that nothing of it can be lost alone; its layout names the parts.
    """
    message.data = [
        *(float(x) for x in divmod(feedback.stamp_ns, NS)),
        *(float(x) for x in divmod(feedback.apply_ns, NS)),
        *map(float, feedback.state),
        *feedback.gyro_bias,
        *feedback.accel_bias,
        float(feedback.aligned),
        *_errors(feedback),
        *feedback.covariance.ravel().tolist(),
    ]
    sizes = len(_errors(feedback)), feedback.covariance.size
    for part, size in zip(message.layout.dim[len(FEEDBACK) :], sizes, strict=False):
        part.size = part.stride = size


def _errors(feedback: Correction) -> tuple[float, ...]:
    """As many as the covariance has."""
    return feedback.imu_errors or (0.0,) * (len(feedback.covariance) - SOLUTION_SIZE)


def read_feedback(message: Any) -> Correction | None:
    """The same read; None where it is not one: sizes, numbers, unit quaternions, variances."""
    data = [float(x) for x in message.data]
    size = math.isqrt(max(0, len(data) - sum(size for _, size in FEEDBACK) + SOLUTION_SIZE))  # n - 15 and n² numbers
    if size < SOLUTION_SIZE or not all(map(math.isfinite, data)):
        return None
    parts, at = {}, 0
    for name, length in FEEDBACK:
        parts[name] = tuple(data[at : at + length])
        at += length
    errors = tuple(data[at : at + size - SOLUTION_SIZE])
    if len(data) != at + len(errors) + size**2:
        return None
    state, covariance = parts["state"], np.array(data[at + len(errors) :]).reshape(size, size)
    off = max(abs(math.hypot(*q) - 1.0) for q in (state[0:4], state[7:11]))
    if off > _UNIT or covariance.diagonal().min() < 0.0:
        return None
    stamp, apply = (round(parts[name][0]) * NS + round(parts[name][1]) for name in ("stamp", "apply"))
    return Correction(
        stamp,
        apply,
        NavState(*state),
        parts["gyro_bias"],  # type: ignore[arg-type]
        parts["accel_bias"],  # type: ignore[arg-type]
        covariance,
        parts["aligned"][0] != 0.0,
        errors,
    )


def received_feedback(message: Any, topic: str, events: EventLog, stamp_ns: int) -> Correction | None:
    """`read_feedback` of a message on a topic; an event where it is malformed, with the stamp of the newest sample."""
    feedback = read_feedback(message)
    if feedback is None:
        text = f"{topic}: {len(message.data)} numbers in an unknown form, rejected: do all nodes have one version?"
        events.count(f"{topic} malformed", WARN, text, stamp_ns)
    return feedback
