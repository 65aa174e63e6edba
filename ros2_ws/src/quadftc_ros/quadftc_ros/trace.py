"""When the messages of a node come and go, by the monotonic clock that all processes of a machine share."""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Note = Callable[[int], None]  # gets the stamp of a message [ns]


class MessageTrace:
    """Times at which a node takes and gives messages, topic by topic.

    Two integers are appended for each message: that takes a few tenths of a microsecond.
    """

    def __init__(self) -> None:
        self._taken: dict[str, array[int]] = {}
        self._given: dict[str, array[int]] = {}

    def taken(self, topic: str) -> Note:
        """Return what notes that a message of a topic has come."""
        return _noting(self._taken.setdefault(topic, array("q")))

    def given(self, topic: str) -> Note:
        """Return what notes that a message of a topic is about to be published."""
        return _noting(self._given.setdefault(topic, array("q")))

    def save(self, path: Path) -> None:
        """Write the times as a NumPy archive, see :func:`load_trace`.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        rows = {f"taken {topic}": np.array(row) for topic, row in self._taken.items()}
        rows.update((f"given {topic}", np.array(row)) for topic, row in self._given.items())
        np.savez(path, allow_pickle=False, **rows)


def load_trace(path: Path) -> dict[str, NDArray[np.int64]]:
    """Return what :meth:`MessageTrace.save` wrote.

    Returns
    -------
    dict
        ``"taken <topic>"`` and ``"given <topic>"``: array (n, 2) of stamp and time [ns].
    """
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name].reshape(-1, 2).astype(np.int64) for name in archive.files}


def _noting(row: array[int]) -> Note:
    append, now = row.append, time.monotonic_ns

    def note(stamp_ns: int) -> None:
        append(stamp_ns)
        append(now())

    return note
