"""Processes that a launcher starts and has to answer for: it ends all of them, and only them.

The other half is `quadftc_ros.executor.run_node`, in the processes themselves.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence

from quadftc_ros.executor import LAUNCHER, STOPPING

PATIENCE = 10.0  # s; from SIGINT to SIGKILL
SIGNALLED = 128  # exit code of a process that a signal ended, less the signal, as shells have it


class Children:
    """Processes by name; none outlives this one: should it be killed, they notice and stop by themselves."""

    def __init__(self) -> None:
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, commands: Mapping[str, Sequence[str]]) -> None:
        """Start processes, by name.

        They inherit that signals are blocked until `run_node` can handle them, so that SIGINT is not lost on
        one that is still importing. Each has a session of its own: Ctrl-C reaches this process alone.
        """
        environment = {**os.environ, LAUNCHER: str(os.getpid())}
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)
        try:
            for name, command in commands.items():
                self._processes[name] = subprocess.Popen(command, env=environment, start_new_session=True)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    def process_ids(self) -> dict[str, int]:
        """Return the process id of each."""
        return {name: process.pid for name, process in self._processes.items()}

    def ended(self) -> dict[str, int]:
        """Return the exit codes of those that have ended."""
        codes = [(name, process.poll()) for name, process in self._processes.items()]
        return {name: code if code >= 0 else SIGNALLED - code for name, code in codes if code is not None}

    def stop(self, patience: float = PATIENCE) -> int:
        """Send SIGINT to each, wait up to ``patience`` [s], kill the rest; return the worst exit code."""
        processes = self._processes.values()
        try:
            for process in processes:
                if process.poll() is None:
                    process.send_signal(signal.SIGINT)
            end = time.monotonic() + patience
            for process in processes:
                process.wait(max(0.0, end - time.monotonic()))
        except subprocess.TimeoutExpired:
            pass
        finally:  # on a second Ctrl-C, too
            for process in processes:
                if process.poll() is None:
                    process.kill()
                    process.wait()
        return max(self.ended().values(), default=0)
