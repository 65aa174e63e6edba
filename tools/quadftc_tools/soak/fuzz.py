# pyright: basic
"""`scripts/soak fuzz`: bad input for every command and file, for as long as is asked for.

A separate process tries the inputs; it is started again when it ends or hangs. Of each kind of wrong answer
one input is kept in a folder, and tried first the next time.
"""

from __future__ import annotations

import hashlib
import json
import re
import select
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from rich.table import Table

from quadftc_tools.results_table import results_table
from quadftc_tools.soak.fuzz_case import NOW

HANG = 120.0  # s; an input that takes so long hangs
AGAIN = "again"  # folder of inputs that were answered wrongly
DETAIL = r"'[^']*'|\"[^\"]*\"|\d+|\s+|/\S+"  # what differs between two crashes of one kind


@dataclass
class Tally:
    """What came of the inputs of one target."""

    target: str
    tried: int = 0
    refused: int = 0  # with exit code 2
    seconds: float = 0.0  # longest wall time of one input
    cpu: float = 0.0  # most processor time of one input [s]
    crashes: dict[str, str] = field(default_factory=dict)  # kind to what was wrong


class Fuzzing:
    """Tries inputs for some targets, keeps crashes in a folder, calls ``follow`` with a line for each."""

    def __init__(self, folder: Path, names: Sequence[str], seed: int, follow: Callable[[str], None]) -> None:
        self._folder, self._seed, self._follow = folder, seed, follow
        self.tallies = {name: Tally(name) for name in names}
        (folder / AGAIN).mkdir(parents=True, exist_ok=True)

    def run(self, seconds: float) -> list[Tally]:
        """Try inputs for so long; RuntimeError if the process that tries them does not start."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._run_worker(end)
            self._seed += 1_000_000
        return list(self.tallies.values())

    def _run_worker(self, end: float) -> None:
        """Start the process that tries inputs; note what it tells, until the end."""
        command = [sys.executable, "-m", "quadftc_tools.soak.fuzz_worker", str(self._folder), str(self._seed)]
        (self._folder / NOW).unlink(missing_ok=True)
        with (
            (self._folder / "worker.log").open("ab") as log,
            subprocess.Popen([*command, *self.tallies], stdout=subprocess.PIPE, stderr=log) as process,
        ):
            assert process.stdout is not None
            try:
                how = self._listen(process.stdout, end)
            finally:
                process.kill()
        if how:
            self._ended(f"{how} (exit code {process.returncode})" if how == "the process ended" else how)

    def _listen(self, told: IO[bytes], end: float) -> str:
        """Note what is told; return why nothing more comes, empty when the time is over."""
        while (rest := end - time.monotonic()) > 0.0:
            ready, _, _ = select.select([told], [], [], min(rest, HANG))
            if not ready:
                return f"hangs: no answer for {HANG:g} s" if rest > HANG else ""
            line = told.readline()
            if not line:
                return "the process ended"
            self._note(json.loads(line))
        return ""

    def _note(self, told: dict[str, Any]) -> None:
        if "target" not in told:
            return
        tally = self.tallies[told["target"]]
        tally.tried += 1
        tally.refused += told["code"] == 2
        tally.seconds, tally.cpu = max(tally.seconds, told["seconds"]), max(tally.cpu, told["cpu"])
        if told["wrong"]:
            self._keep(tally, told["wrong"], told["case"])
        elif told["again"]:
            (self._folder / AGAIN / told["again"]).unlink(missing_ok=True)
            self._follow(f"{tally.target}: {told['again']} is answered as it should be now")

    def _ended(self, how: str) -> None:
        try:
            text = (self._folder / NOW).read_text("utf-8")
            target = str(json.loads(text)["target"])
        except (OSError, ValueError):
            raise RuntimeError(f"inputs cannot be tried: see {self._folder / 'worker.log'}") from None
        self.tallies[target].tried += 1
        self._keep(self.tallies[target], how, text)

    def _keep(self, tally: Tally, wrong: str, case: str) -> None:
        words = re.sub(DETAIL, " ", wrong)
        kind = words[:80] + words[-120:]
        name = f"{tally.target.replace(' ', '_')}-{hashlib.sha256(kind.encode()).hexdigest()[:10]}.json"
        path = self._folder / AGAIN / name
        with suppress(OSError):
            if not path.exists() or path.stat().st_size > len(case):
                path.write_text(case, encoding="utf-8")
        if kind not in tally.crashes:
            tally.crashes[kind] = wrong
            self._follow(f"{tally.target}: {wrong[:300]} ({path.name})")


def table(done: Sequence[Tally]) -> Table:
    """A row for each target, and one for all."""
    headings = ("inputs", "refused", "kinds of crashes", "worst time [s]", "processor [s]")
    shown = results_table("bad input", ("target",), headings)
    for name in (*(each.target for each in done), "all"):
        rows = [each for each in done if name in (each.target, "all")]
        shown.add_row(
            name,
            str(sum(each.tried for each in rows)),
            str(sum(each.refused for each in rows)),
            str(sum(len(each.crashes) for each in rows)),
            f"{max(each.seconds for each in rows):.2f}",
            f"{max(each.cpu for each in rows):.2f}",
        )
    return shown


def summary(done: Sequence[Tally], seed: int, minutes: float) -> dict[str, Any]:
    """What was found, ready for JSON."""
    return {
        "fault": "bad input",
        "seed": seed,
        "minutes": minutes,
        "inputs": sum(each.tried for each in done),
        "crashes": sum(len(each.crashes) for each in done),
        "worst_s": max((each.seconds for each in done), default=None),
        "passed": not any(each.crashes for each in done),
    }
