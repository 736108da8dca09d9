"""Messages at the rate of the IMU as CDR bytes, read and filled in place.

rclpy converts every message field by field; at 400 Hz that costs more than navigation. A message whose strings
do not change has its numbers at constant offsets.

References
----------
.. [1] OMG, Common Object Request Broker Architecture 3.3, part 2, section 9.3: CDR transfer syntax.
.. [2] OMG, DDS Interoperability Wire Protocol 2.5, section 10: encapsulation.
"""

import struct

import numpy as np

from ins_nav.stamps import NS

_ENCAPSULATION = 4
"""Bytes before the message ([2]_); alignment counts from behind them."""
_STAMP = struct.Struct("<iI")
_LITTLE_ENDIAN = b"\x00\x01\x00\x00"


class StampedMessage:
    """A message of a header, fields that do not change, and floating-point numbers behind them.

    Parameters
    ----------
    msgtype : str
        Such as ``sensor_msgs/msg/Imu``.
    frame_id : str
        Of the header.
    *constants : str or (format, number)
        Strings, and numbers with their formats as of `struct`.
    count : int
        Of floating-point numbers.
    end : bytes
        What follows them.

    Attributes
    ----------
    msgtype : str
    numbers : ndarray, shape (count,)
        A view: what is assigned to its elements is in the message.
    """

    def __init__(
        self, msgtype: str, frame_id: str, *constants: str | tuple[str, int], count: int, end: bytes = b""
    ) -> None:
        self.msgtype = msgtype
        body = bytes(_STAMP.size)
        for constant in (frame_id, *constants):
            if isinstance(constant, str):
                text = constant.encode() + b"\0"
                body = _aligned(body, 4) + struct.pack("<I", len(text)) + text
            else:
                body = _aligned(body, struct.calcsize(constant[0])) + struct.pack(f"<{constant[0]}", constant[1])
        body = _aligned(body, 8)
        self._buffer = bytearray(_LITTLE_ENDIAN + body + bytes(8 * count) + end)
        self.numbers = np.frombuffer(self._buffer, "<f8", count, _ENCAPSULATION + len(body))

    def set_stamp(self, stamp_ns: int) -> None:
        """Header stamp from ns since the epoch."""
        _STAMP.pack_into(self._buffer, _ENCAPSULATION, *divmod(stamp_ns, NS))

    def serialized(self) -> bytes:
        """The message as it is now."""
        return bytes(self._buffer)


def _aligned(body: bytes, size: int) -> bytes:
    return body + bytes(-len(body) % size)


_IMU_NUMBERS = {order: struct.Struct(f"{order}104x3d72x3d72x") for order in "<>"}
"""Angular velocity and linear acceleration, behind orientation and its covariance, each before its covariance."""


ImuSample = tuple[int, float, float, float, float, float, float]
"""Stamp, ns, angular velocity, rad/s, and linear acceleration, m/s², on the axes of the message's frame."""


def read_imu(data: bytes) -> ImuSample:
    """The sample in a serialized sensor_msgs/Imu.

    Raises
    ------
    ValueError
        The bytes are no such message.
    """
    try:
        order = "<" if data[1] & 1 else ">"
        sec, nanosec, length = struct.unpack_from(f"{order}iII", data, _ENCAPSULATION)
        start = _ENCAPSULATION + 12 + length
        start += (_ENCAPSULATION - start) % 8
        return sec * NS + nanosec, *_IMU_NUMBERS[order].unpack_from(data, start)
    except (IndexError, struct.error) as error:
        raise ValueError(f"{len(data)} bytes are not a sensor_msgs/Imu") from error
