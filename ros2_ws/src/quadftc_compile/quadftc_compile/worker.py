"""A process that compiles laws: recipes come in, pickled, each behind its length; lines go out."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys

from quadftc_compile.recipe import Recipe

LENGTH = 8  # bytes of the length of a recipe


class Worker:
    """Such a process, from outside; it loads JAX once for all its laws."""

    def __init__(self) -> None:
        command = [sys.executable, "-m", "quadftc_compile.worker"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def build(self, recipe: Recipe) -> dict[str, str]:
        """Compile a law into the cache; ``error`` says why it cannot be, ``unknown`` why not there."""
        try:
            content = pickle.dumps(recipe)
        except (pickle.PicklingError, AttributeError, TypeError) as error:  # a law that a function defines
            return {"unknown": str(error)}
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(len(content).to_bytes(LENGTH, "big") + content)
            self._process.stdin.flush()
            return json.loads(self._process.stdout.readline())
        except (OSError, ValueError) as error:  # it has died
            return {"unknown": str(error)}

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def main() -> None:
    """Compile the recipes on standard input."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what a library prints is no answer
    while length := sys.stdin.buffer.read(LENGTH):
        answers.write(json.dumps(_answer(sys.stdin.buffer.read(int.from_bytes(length, "big")))) + "\n")
        answers.flush()


def _answer(content: bytes) -> dict[str, str]:
    from quadftc_compile.build import BuildError, build_library

    try:
        recipe = pickle.loads(content)
    except Exception as error:  # whatever a law's own module raises
        return {"unknown": str(error)}
    try:
        build_library(recipe)
    except BuildError as error:
        return {"unknown" if error.unkept else "error": str(error)}
    return {}


if __name__ == "__main__":
    sys.unraisablehook = lambda _: None  # of a callback of JAX that Ctrl-C ends
    try:
        main()
    except KeyboardInterrupt:  # who started this hears it, too
        os._exit(130)
