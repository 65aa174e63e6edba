"""A process that compiles one law: a recipe comes in, pickled; a line of JSON goes out."""

from __future__ import annotations

import json
import os
import pickle
import sys


def main() -> None:
    """Compile the recipe on standard input."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what a library prints is no answer
    from quadftc_compile.build import BuildError, build_library

    try:
        recipe = pickle.loads(sys.stdin.buffer.read())
    except Exception as error:  # whatever a law's own module raises
        answers.write(json.dumps({"unknown": str(error)}) + "\n")
        return
    try:
        build_library(recipe)
        answers.write("{}\n")
    except BuildError as error:
        answers.write(json.dumps({"unknown" if error.unkept else "error": str(error)}) + "\n")


if __name__ == "__main__":
    main()
