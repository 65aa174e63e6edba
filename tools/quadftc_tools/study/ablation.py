"""What a rule of a fault observer is worth: verdicts on the tuning set without it.

    python -m quadftc_tools.study.ablation DIR FILE OLD NEW [--observer NAME]

In a copy of the package ``quadftc_fdi``, NEW takes the place of the text OLD, which FILE has once. Table and
differences to the stored verdicts are those of `quadftc_tools.study.golden`.

docs/isolating.md has some more: drifts, the first 8 flights of ``campaigns/free_flight_drift.yaml`` with seed
231; recorded faults, 48 of ``campaigns/study_diagnosis_recordings.yaml --variant supervised --flights 1`` on
the three bags for tuning; wandering ones, 18 of ``campaigns/study_diagnosis_ahrs.yaml --flights 3``. Both
have seed 777.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import quadftc_fdi
from quadftc_cli.commands import BAD_INPUT
from quadftc_cli.screen import say


def changed_copy(folder: Path, file: str, old: str, new: str) -> None:
    """Copy the package into a folder, with another text in one file; a ValueError says what is wrong."""
    package = folder / quadftc_fdi.__name__
    shutil.copytree(Path(quadftc_fdi.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    path = package / file
    if not path.is_file():
        raise ValueError(f"{file}: not there; expected a file of {quadftc_fdi.__name__}")
    text = path.read_text(encoding="utf-8")
    if text.count(old) != 1:
        raise ValueError(f"{file}: has the text {text.count(old)} times; expected it once: {old}")
    path.write_text(text.replace(old, new), encoding="utf-8")


def main() -> int:
    """Judge an observer without a rule; return the exit code of `golden`."""
    parser = argparse.ArgumentParser(prog="ablation", description="What an observer says without a rule.")
    parser.add_argument("directory", help="directory of the recordings")
    parser.add_argument("file", help="file of quadftc_fdi")
    parser.add_argument("old", help="text that it has once")
    parser.add_argument("new", help="text in its place")
    parser.add_argument("--observer", default="isolating", help="name of a fault observer")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="quadftc_") as name:
        folder = Path(name)
        try:
            changed_copy(folder, options.file, options.old, options.new)
        except ValueError as error:
            say(f"error: {error}", stderr=True)
            return BAD_INPUT
        path = os.pathsep.join((name, *filter(None, [os.environ.get("PYTHONPATH")])))
        environment = {**os.environ, "PYTHONPATH": path, "QUADFTC_CACHE": str(folder / "laws")}
        judge = [sys.executable, "-m", "quadftc_tools.study.golden", options.directory, "--set", "tuning"]
        judge += ["--observer", options.observer]
        return subprocess.run(judge, check=False, env=environment).returncode


if __name__ == "__main__":
    raise SystemExit(main())
