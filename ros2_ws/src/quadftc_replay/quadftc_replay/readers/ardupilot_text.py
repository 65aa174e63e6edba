"""A log of ArduPilot as text (``.log``) as a flight log: as `ardupilot`, from lines."""

from __future__ import annotations

from quadftc_replay.readers.ardupilot import read_text as read

__all__ = ["read"]
