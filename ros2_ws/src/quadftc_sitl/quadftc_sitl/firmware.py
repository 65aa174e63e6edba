"""The process of an autopilot's firmware: started in a folder of its own, on loopback, and ended with us.

It never outlives us: the kernel kills it when our process ends, however that ends (``PR_SET_PDEATHSIG``). It
leads a process group of its own, so that whatever it starts is ended with it.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO

LOOPBACK = "127.0.0.1"
PR_SET_PDEATHSIG = 1  # linux/prctl.h
OUTPUT, PARAMETERS = "output.txt", "parameters.parm"  # files in its folder
TAIL = 12  # lines of its output that an error shows
PATIENCE = 3.0  # s; from being asked to end until it is killed

# becomes the firmware, which the kernel kills with us; no fork of a process that has threads of JAX
START = f"""
import ctypes, os, sys
parent, said = map(int, sys.argv[1:3])
os.set_inheritable(said, False)
ctypes.CDLL(None).prctl({PR_SET_PDEATHSIG}, {int(signal.SIGKILL)}, 0, 0, 0)
if os.getppid() != parent:
    os._exit(1)
try:
    os.execvp(sys.argv[3], sys.argv[3:])
except OSError as error:
    os.write(said, error.strerror.encode())
"""


class SitlError(ValueError):
    """A flight that cannot be flown with this binary; the message says why."""


class Firmware:
    """A running firmware; a context manager that ends it."""

    def __init__(
        self, arguments: Sequence[str], folder: Path, environment: Mapping[str, str] | None = None
    ) -> None:
        """Start it, with variables besides ours; a `SitlError` says if it cannot be started."""
        self.arguments, self.folder = list(arguments), folder
        reading, writing = os.pipe()
        self._output: IO[bytes] = (folder / OUTPUT).open("wb")
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", START, str(os.getpid()), str(writing), *self.arguments],
            cwd=folder,
            env={**os.environ, **(environment or {})},
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            pass_fds=(writing,),
        )
        os.close(writing)
        with os.fdopen(reading, encoding="utf-8") as said:
            error = said.read()  # it ends as the firmware begins
        if error:
            self._process.wait()
            self._output.close()
            raise SitlError(f"{arguments[0]}: does not start: {error}")

    @property
    def pid(self) -> int:
        """Number of its process."""
        return self._process.pid

    def check_alive(self) -> None:
        """Raise a `SitlError` with its last words if it has ended."""
        code = self._process.poll()
        if code is not None:
            how = f"killed by signal {-code}" if code < 0 else f"with code {code}"
            raise SitlError(f"{self.arguments[0]}: ended early, {how}{self.last_words()}")

    def last_words(self) -> str:
        """Return the end of what it has printed, to be put behind an error."""
        with contextlib.suppress(OSError):
            lines = (self.folder / OUTPUT).read_bytes()[-4096:].decode("utf-8", "replace").splitlines()
            if words := [line.strip() for line in lines if line.strip()][-TAIL:]:
                return "; it says:\n" + "\n".join(words)
        return ""

    def end(self, serve: Callable[[float], object] = lambda _patience: None) -> None:
        """Ask it to end, and kill it if it does not; ``serve(patience)`` is called while it ends."""
        if self._process.poll() is None:
            self._signal(signal.SIGTERM)
            for _ in range(int(PATIENCE / 0.1)):
                serve(0.05)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    self._process.wait(0.05)
                    break
        self._signal(signal.SIGKILL)  # what is left of its group, too
        self._process.wait()
        self._output.close()

    def __enter__(self) -> Firmware:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def _signal(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, number)


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    """Return a port of this machine that nobody uses now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


def parameter_file(parameters: Mapping[str, float]) -> str:
    """Write parameters, a name and a number a line."""
    return "".join(f"{name} {value:.10g}\n" for name, value in parameters.items())
