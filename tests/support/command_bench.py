"""The ``quadftc`` command, as installed or in the process of the tests, which saves the start of another."""

import contextlib
import re
import subprocess
import tempfile
from pathlib import Path

from quadftc_flight.graph.processes import executable_path

Done = subprocess.CompletedProcess[str]


def installed_command(*arguments: str | Path) -> list[str]:
    """Return the command line of the installed command."""
    return [str(executable_path("quadftc_cli", "quadftc")), *map(str, arguments)]


def run_installed(*arguments: str | Path) -> Done:
    """Run the installed command."""
    command = installed_command(*arguments)
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert "Traceback" not in done.stderr
    return done


def complaints(done: Done) -> list[str]:
    """Lines on stderr, without the shares of progress that a slow machine prints among them."""
    return [line for line in done.stderr.splitlines() if not re.fullmatch(r".+ \d+%", line)]


def call_quadftc(*arguments: str | Path) -> Done:
    """Run the command in this process: same exit code, same words."""
    from quadftc_cli.main import guarded

    with tempfile.TemporaryFile("w+") as words, tempfile.TemporaryFile("w+") as errors:  # as a child needs
        with contextlib.redirect_stdout(words), contextlib.redirect_stderr(errors):
            code = guarded([str(argument) for argument in arguments])
        for file in (words, errors):
            file.seek(0)
        return subprocess.CompletedProcess(arguments, code, words.read(), errors.read())
