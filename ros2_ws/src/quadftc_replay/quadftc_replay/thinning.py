"""What bounds the memory while a long log is read.

Of a signal with `MOST` samples or more, every second, fourth, ... is kept, so that its rate falls and its end
stays. Pages of a mapped file count as memory until they are given back.
"""

from __future__ import annotations

import mmap
from array import array
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

MOST = 2**20  # samples of a signal: 17 min at 1 kHz; half of them are left at least
WINDOW = 1 << 26  # bytes of a mapped file that may be in memory


class Thinning:
    """Which samples of a signal are kept as they come; whoever holds them drops every second when told to."""

    def __init__(self) -> None:
        self.count = self.kept = 0
        self.stride = 1

    def keeps(self) -> bool:
        """Count a sample, and say whether it is kept."""
        is_kept = self.count % self.stride == 0
        self.count += 1
        self.kept += is_kept
        return is_kept

    def is_full(self) -> bool:
        """Whether every second of the kept samples, from the second on, is to be dropped now."""
        if self.kept < MOST:
            return False
        self.kept //= 2
        self.stride *= 2
        return True

    def notes(self, name: str) -> Iterator[str]:
        """Say what was left out."""
        if self.stride > 1:
            yield f"{name}: long; of {self.count} samples one in {self.stride} was read"


class Places:
    """Where the samples of a signal are in a file."""

    def __init__(self) -> None:
        self.at = array("Q")
        self.thinning = Thinning()

    def add(self, at: int) -> None:
        """Take a sample."""
        if self.thinning.keeps():
            self.at.append(at)
            if self.thinning.is_full():
                del self.at[1::2]


class Messages(bytearray):
    """Messages of one length, one behind the other."""

    def __init__(self) -> None:
        super().__init__()
        self.thinning = Thinning()

    def __iadd__(self, message: Any) -> Messages:
        """Take a message."""
        if self.thinning.keeps():
            self.extend(message)
            if self.thinning.is_full():
                rows = np.frombuffer(bytes(self), np.uint8).reshape(-1, len(message))
                self[:] = rows[::2].tobytes()
        return self


class Forgetting:
    """Gives pages of a mapped file back once `WINDOW` was read."""

    def __init__(self, data: bytes | mmap.mmap) -> None:
        self.data, self.limit = data, WINDOW

    def passed(self, at: int) -> None:
        """Note that the file was read up to a place, from the one before."""
        if at > self.limit and isinstance(self.data, mmap.mmap):
            self.data.madvise(mmap.MADV_DONTNEED)
            self.limit = at + WINDOW


class Blocks:
    """Rows that come in blocks."""

    def __init__(self) -> None:
        self.thinning = Thinning()
        self._blocks: list[NDArray[Any]] = []

    def add(self, rows: NDArray[Any]) -> None:
        """Take rows (n, ...)."""
        thinning = self.thinning
        kept = rows[-thinning.count % thinning.stride :: thinning.stride]
        thinning.count += len(rows)
        thinning.kept += len(kept)
        self._blocks.append(kept)
        while thinning.is_full():
            self._blocks = [np.concatenate(self._blocks)[::2].copy()]

    def rows(self) -> NDArray[Any]:
        """All rows that are kept; at least one block has to be there."""
        return np.concatenate(self._blocks)
