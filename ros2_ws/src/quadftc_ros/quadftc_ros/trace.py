"""When the messages of a node come and go, by the monotonic clock that all processes of a machine share."""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

PIECE = 65536  # messages: a minute at 1 kHz

Note = Callable[[int], None]  # gets the stamp of a message [ns]


class MessageTrace:
    """Times at which a node takes and gives messages, topic by topic.

    A note takes a few tenths of a microsecond, in memory that is there already: memory that grew with the
    flight would now and then take milliseconds.
    """

    def __init__(self) -> None:
        self._rows: dict[str, _Rows] = {}

    def taken(self, topic: str) -> Note:
        """Return what notes that a message of a topic has come."""
        return self._rows.setdefault(f"taken {topic}", _Rows()).note

    def given(self, topic: str) -> Note:
        """Return what notes that a message of a topic is about to be published."""
        return self._rows.setdefault(f"given {topic}", _Rows()).note

    def save(self, path: Path) -> None:
        """Write the times as a NumPy archive, see `load_trace`; OSError if it cannot be written."""
        np.savez(path, allow_pickle=False, **{name: rows.noted() for name, rows in self._rows.items()})


def load_trace(path: Path) -> dict[str, NDArray[np.int64]]:
    """Return a saved trace: by "taken <topic>" and "given <topic>", (n, 2) of stamp and time [ns]."""
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name].astype(np.int64) for name in archive.files}


class _Rows:
    """Stamps and times [ns], in pieces of a fixed size."""

    def __init__(self) -> None:
        self._pieces = [array("q", bytes(16 * PIECE))]
        self._end = 0  # in the last piece

    def note(self, stamp_ns: int) -> None:
        if self._end == 2 * PIECE:
            self._pieces.append(array("q", bytes(16 * PIECE)))
            self._end = 0
        piece, end = self._pieces[-1], self._end
        piece[end] = stamp_ns
        piece[end + 1] = time.monotonic_ns()
        self._end = end + 2

    def noted(self) -> NDArray[np.int64]:
        *whole, last = self._pieces
        return np.concatenate([*whole, last[: self._end]]).astype(np.int64).reshape(-1, 2)
