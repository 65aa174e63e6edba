"""Writers of flight logs: a `FlightLog` as an autopilot logs it by default, one file per autopilot.

`dataflash` and `ulog` write the bytes; they know messages and topics by name, and nothing of flights. Each is
here as no library writes them: pymavlink reads dataflash alone, and pyulog writes what it has read before.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from quadftc_replay.flight_log import FlightLog
from quadftc_replay.writers.ardupilot import write_ardupilot
from quadftc_replay.writers.px4 import write_px4

# autopilot -> what writes its log, and says which messages it wrote
WRITERS: Mapping[str, Callable[[FlightLog, Path], tuple[str, ...]]] = {
    "ardupilot": write_ardupilot,
    "px4": write_px4,
}
