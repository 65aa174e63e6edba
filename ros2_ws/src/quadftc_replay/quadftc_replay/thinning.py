"""What bounds the memory while a long log is read.

Of a signal with `MOST` samples or more, every second, fourth, ... is kept, so that its rate falls and its end
stays. Pages of a mapped file count as memory until they are given back.
"""

from __future__ import annotations

import contextlib
import mmap
from array import array
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadftc_bags.bag import BagError
from quadftc_model.arrays import AnyArray

MOST = 2**20  # samples of a signal: 17 min at 1 kHz; half of them are left at least
WINDOW = 1 << 26  # bytes of a mapped file that may be in memory
GATHERED = 1 << 22  # bytes gathered at a time

Data = bytes | mmap.mmap


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


@contextlib.contextmanager
def mapped(path: Path) -> Generator[Data, None, None]:
    """Map a file; what is wrong with it, or with what is made of it, is a BagError of one line."""
    try:
        with path.open("rb") as stream:
            if not path.stat().st_size:  # cannot be mapped
                yield b""
                return
            with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
                yield data
    except BagError:
        raise
    except (OSError, ValueError) as error:
        raise BagError(f"{path}: {getattr(error, 'strerror', None) or error}") from None


def rows_at(data: Data, places: NDArray[np.int64], row: np.dtype) -> Iterator[tuple[slice, AnyArray]]:
    """Copy rows of a type from some places out of a file, block by block: which they are, and the rows."""
    view, forgetting, span = np.frombuffer(data, np.uint8), Forgetting(data), np.arange(row.itemsize)
    step = max(GATHERED // row.itemsize, 1)
    for first in range(0, len(places), step):
        block = slice(first, first + step)
        yield block, np.ascontiguousarray(view[places[block, None] + span]).view(row)[:, 0]
        forgetting.passed(int(places[block][-1]))


class Forgetting:
    """Gives pages of a mapped file back once `WINDOW` was read."""

    def __init__(self, data: Data) -> None:
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
        self._blocks: list[AnyArray] = []

    def add(self, rows: AnyArray) -> None:
        """Take rows (n, ...)."""
        thinning = self.thinning
        kept = rows[-thinning.count % thinning.stride :: thinning.stride]
        thinning.count += len(rows)
        thinning.kept += len(kept)
        self._blocks.append(kept)
        while thinning.is_full():
            self._blocks = [np.concatenate(self._blocks)[::2].copy()]

    def rows(self) -> AnyArray:
        """All rows that are kept; at least one block has to be there."""
        return np.concatenate(self._blocks)
