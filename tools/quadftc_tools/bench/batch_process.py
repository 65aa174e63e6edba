"""A process that flies for a batch benchmark, pinned to a core, its environment set before it starts."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import quadftc_tools
from quadftc_campaign.batch.jax_settings import environment
from quadftc_flight.runs import RunError

# sys.path last, so that another Python keeps its own packages
BOOT = (
    "import runpy, sys; sys.path.append(sys.argv.pop(1));"
    " runpy.run_module(sys.argv.pop(1), run_name='__main__', alter_sys=True)"
)


class FlyingProcess:
    """The other end of `quadftc_tools.bench.batch_child`.

    Parameters
    ----------
    module : str
        Of the worker.
    job : mapping
    python : str, optional
        A Python that has nothing of ours installed; None: this one, in the environment it is in.

    Raises
    ------
    RunError
        If it does not start.
    """

    def __init__(self, module: str, job: Mapping[str, Any], python: str | None = None) -> None:
        root = str(Path(quadftc_tools.__file__).parents[1])
        start = [sys.executable, "-m"] if python is None else [python, "-E", "-c", BOOT, root]
        self._name = start[0]
        self._place = tempfile.TemporaryDirectory(prefix="quadftc_")  # some write where they are
        self._errors = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115
        try:
            self._process = subprocess.Popen(
                [*start, module, json.dumps(job)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                text=True,
                cwd=None if python is None else self._place.name,
                env=_variables(),
            )
        except OSError as error:
            self._forget()
            raise RunError(f"{self._name}: {error.strerror}") from None

    def go(self) -> None:
        """Have it fly."""
        if self._process.stdin is not None:
            self._process.stdin.write("go\n")
            self._process.stdin.flush()

    def answer(self) -> dict[str, Any]:
        """Wait for what it says next.

        Raises
        ------
        RunError
            If it has ended.
        """
        line = self._process.stdout.readline() if self._process.stdout is not None else ""
        try:
            found: dict[str, Any] = json.loads(line)
        except ValueError:
            raise RunError(f"{self._name}: no answer: {self._last_words()}") from None
        return found

    def finish(self) -> dict[str, Any]:
        """Tell it that this was all, and return its last answer."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        return self.answer()

    def close(self) -> None:
        """End it, if it has not."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        self._forget()

    def _forget(self) -> None:
        self._errors.close()
        self._place.cleanup()

    def _last_words(self) -> str:
        self._process.kill()
        self._process.wait()
        self._errors.seek(0)
        lines = [line.strip() for line in self._errors.read().splitlines() if line.strip()]
        return lines[-1] if lines else f"it ended with code {self._process.returncode}"


def _variables() -> dict[str, str]:
    """One thread, the CPU, and the compiler at its best; for the other simulators, too."""
    single = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")}
    return {"JAX_PLATFORMS": "cpu", **os.environ, **single, **environment(1)}
