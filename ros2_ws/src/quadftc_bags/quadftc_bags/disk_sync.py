"""Bringing a bag to the disk beside its writing, which a slow disk does not hold up."""

from __future__ import annotations

import threading

from quadftc_bags.bag_file import BagFile


class DiskSync:
    """Run `BagFile.sync` in a thread of its own, one at a time.

    Parameters
    ----------
    file : BagFile
    """

    def __init__(self, file: BagFile) -> None:
        self._file = file
        self._thread: threading.Thread | None = None
        self._error: Exception | None = None

    def begin(self) -> None:
        """Begin to bring to the disk what was flushed, unless that of the last time goes on.

        Raises
        ------
        OSError
            What went wrong the last time.
        """
        if self._thread is None or not self._thread.is_alive():
            self.wait()
            self._thread = threading.Thread(target=self._run, name="bag_sync", daemon=True)
            self._thread.start()

    def wait(self) -> None:
        """Wait for the one that goes on, if any; raises as `begin`."""
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        if self._error is not None:
            error, self._error = self._error, None
            raise error

    def _run(self) -> None:
        try:
            self._file.sync()
        except Exception as error:  # for whoever asks next
            self._error = error
