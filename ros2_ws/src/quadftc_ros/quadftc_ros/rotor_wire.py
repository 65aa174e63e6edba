"""The messages about faults of rotors, as `quadftc_ros.wire`: their true condition, and their diagnosis.

Readers raise ValueError for bytes that are no such message, or of another number of rotors.
"""

from __future__ import annotations

import numpy as np
from std_msgs.msg import Header

from quadftc_bags.cdr.message import FieldReader, FieldWriter
from quadftc_model.samples import ALARMS, RotorCondition, RotorEstimate
from quadftc_msgs.msg import RotorCondition as RotorConditionMessage
from quadftc_msgs.msg import RotorStatus
from quadftc_ros.conversions import Floats
from quadftc_ros.topics import BASE_FRAME

_CONDITION = RotorCondition._fields
_STATUS = ("state", "effectiveness", "std_dev", "probability", "ambiguous")


class RotorConditionWire:
    """Makes serialised conditions of rotors."""

    def __init__(self, count: int, frame: str = BASE_FRAME) -> None:
        self._healthy = *[1.0] * count, *[np.inf] * count, *[False] * count, *[0.0] * count
        message = RotorConditionMessage(header=Header(frame_id=frame))
        message.effectiveness, message.speed_limit = [1.0] * count, [np.inf] * count
        message.stuck, message.unbalance = [False] * count, [0.0] * count
        self._write = FieldWriter(message, *_CONDITION)

    def __call__(self, stamp_ns: int, condition: RotorCondition | None) -> bytes:
        """Return the message of a condition; None: all rotors are healthy."""
        if condition is None:
            return self._write(stamp_ns, *self._healthy)
        return self._write(stamp_ns, *(number for column in condition for number in column.tolist()))


class RotorConditionReader:
    """Reads conditions of rotors."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._read = FieldReader(RotorConditionMessage, *_CONDITION)

    def __call__(self, data: bytes) -> RotorCondition:
        """Return the condition (count,) of a message."""
        count, values = self._count, self._read(data)[1]
        if len(values) != 4 * count:
            raise ValueError(f"{len(values)} numbers: expected 4 for each of {count} rotors")
        parts = [np.array(values[first : first + count]) for first in range(0, 4 * count, count)]
        return RotorCondition(*parts)


class RotorStatusWire:
    """Makes serialised diagnoses of rotors."""

    def __init__(self, count: int, frame: str = BASE_FRAME) -> None:
        header = Header(frame_id=frame)
        self._write_nothing = FieldWriter(RotorStatus(header=header))
        message = RotorStatus(header=header, state=[0] * count, effectiveness=[1.0] * count)
        message.std_dev = message.probability = [-1.0] * count
        message.ambiguous = [False] * count
        self._write = FieldWriter(message, *_STATUS)

    def __call__(self, stamp_ns: int, rotors: RotorEstimate | None) -> bytes:
        """Return the message of an estimate of one vehicle, without rotors where it says nothing of them."""
        if rotors is None:
            return self._write_nothing(stamp_ns)
        columns = (getattr(rotors, name).tolist() for name in _STATUS)
        return self._write(stamp_ns, *(number for column in columns for number in column))


class EffectivenessReader:
    """Reads from diagnoses of rotors the effectiveness that a controller counts on."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._read = FieldReader(RotorStatus, "state", "effectiveness")

    def __call__(self, data: bytes) -> Floats | None:
        """Return the effectiveness (count,), as `samples.effectiveness_of`; None without a diagnosis."""
        count, values = self._count, self._read(data)[1]
        if not values:
            return None
        if len(values) != 2 * count:
            raise ValueError(f"{len(values)} numbers: expected 2 for each of {count} rotors")
        rows = zip(values[:count], values[count:], strict=True)
        return np.array([min(max(left, 0.0), 1.0) if state in ALARMS else 1.0 for state, left in rows])
