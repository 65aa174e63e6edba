"""The directory of a run as it is made: its name, room for it, the summary beside its bag."""

from __future__ import annotations

import json
import shutil
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from quadftc_flight.graph.plan import GraphError
from quadftc_flight.scenario import Scenario, Scheme

if TYPE_CHECKING:
    from quadftc_flight.summary import Summary

SUMMARY = "summary.json"


class RunError(Exception):
    """A run that cannot be made with this input; the message says why."""


def run_name(scenario: Scenario, scheme: Scheme) -> str:
    """Name of a run, of its directory and of its bag."""
    return f"{scenario.name}-{scheme.name}"


def prepare(out: Path, names: list[str], force: bool) -> None:
    """Make room for runs in ``out``; raise a `RunError` if a name is taken and may not be replaced."""
    for directory in (out / name for name in names if (out / name).exists()):
        if not force:
            advice = "choose another --out, or --force to replace the earlier run"
            raise RunError(f"{directory}: exists; {advice}")
        if not (directory / "metadata.yaml").is_file():
            raise RunError(f"{directory}: is no earlier run; not replaced")
        shutil.rmtree(directory)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(f"{out}: {error.strerror}") from None


def write_summary(out: Path, result: Summary) -> None:
    """Write the summary of a run beside its bag; ``out`` is the directory of all runs."""
    write_beside(out / result["bag"] / SUMMARY, json.dumps(result, indent=2, allow_nan=False) + "\n")


def write_beside(file: Path, text: str) -> None:
    """Write a file beside the bag, or none."""
    try:
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        with suppress(OSError):
            file.unlink()
        raise GraphError(f"{file}: {error.strerror}; the bag is whole") from None


def commit() -> dict[str, str]:
    """Return the commit of the source tree this code runs from, if it is one."""
    folder = str(Path(__file__).resolve().parent)
    command = ["git", "-C", folder, "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        found = subprocess.run(command, capture_output=True, text=True, timeout=5.0, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return {}
    return {"commit": found.stdout.strip()} if found.returncode == 0 else {}
