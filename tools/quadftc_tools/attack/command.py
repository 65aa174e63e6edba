# pyright: basic
"""``python -m quadftc_tools.attack``: every attack of docs/security.md again, in under an hour on two cores.

    python -m quadftc_tools.attack [--only WORDS] [--long] [--quick] [--write docs/security.md]

An attack is a selection of tests, or a part of ``scripts/soak``. Each runs in a process of its own with a
limit on its time. Printed is a table: who attacks, how, how often, what held, how long it took. The exit code
is 1 if something did not hold, and what the failed process said is printed. ``--write`` puts the table into a
document, between the two marks that it has for it.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from quadftc_cli.commands import CHECK_FAILED, GOOD
from quadftc_tools.attack.table import ATTACKS, LONG, Attack

ROOT = Path(__file__).resolve().parents[3]
BEGIN, END = "<!-- attacks: begin (python -m quadftc_tools.attack --write FILE) -->", "<!-- attacks: end -->"
HEADING = "| who | attack | trials | held | time [s] |\n|---|---|---|---|---|"
SHOWN = 4000  # characters of what a failed process said
QUICK = 40  # examples, as in scripts/test


class Result(NamedTuple):
    """What became of an attack."""

    attack: Attack
    trials: int
    held: int
    seconds: float
    said: str  # where not all held

    def row(self) -> str:
        """Return the row of the table."""
        figures = f"{self.trials} | {self.held} | {self.seconds:.0f}"
        return f"| {self.attack.who} | {self.attack.what} | {figures} |"


def run(attack: Attack, quick: bool) -> Result:
    """Run an attack."""
    examples = min(attack.examples, QUICK) if quick else attack.examples
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="quadftc-attack-") as folder:
        report = Path(folder, "report.xml")
        command = [sys.executable, "-m", *attack.command]
        if attack.is_tests:
            command += ["--junitxml", str(report), "-o", "junit_family=xunit1"]  # which has properties
            command += ["-q", "-p", "no:cacheprovider", "--thorough"]
            command += ["--examples", str(examples)] if examples else []
        try:
            done = subprocess.run(
                command,
                cwd=ROOT,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                check=False,
                timeout=attack.limit,
            )
            code, said = done.returncode, done.stdout
        except subprocess.TimeoutExpired as late:
            code, said = -1, f"not over after {attack.limit:.0f} s\n{late.stdout or ''}"
        passed, failed = count_tests(report) if attack.is_tests else count_trials(said, code)
    failed += code not in (GOOD, CHECK_FAILED) and not failed  # the process itself ended badly
    return Result(
        attack,
        passed + failed,
        passed,
        time.monotonic() - begin,
        "" if code == GOOD and passed else said[-SHOWN:],
    )


def count_tests(report: Path) -> tuple[int, int]:
    """Count the trials of a JUnit report that held, and the tests that failed; skipped ones are neither.

    A test that tried more than once says so in its property ``trials``.
    """
    if not report.exists():
        return 0, 1
    cases = list(ET.parse(report).iter("testcase"))  # written by the process that we started
    bad = [each for each in cases if each.find("failure") is not None or each.find("error") is not None]
    good = [each for each in cases if each not in bad and each.find("skipped") is None]
    trials = (each.find("properties/property[@name='trials']") for each in good)
    return sum(1 if found is None else int(found.attrib["value"]) for found in trials), len(bad)


def count_trials(said: str, code: int) -> tuple[int, int]:
    """Count the lines of a part of ``scripts/soak`` that say "good", and those that say otherwise."""
    lines = [line for line in said.splitlines() if re.match(r"\w[^|]*: ", line)]
    good = sum(line.endswith("good") for line in lines)
    if not lines:
        return (1, 0) if code == GOOD else (0, 1)
    return good, len(lines) - good


def write_table(path: Path, results: Sequence[Result]) -> None:
    """Replace the table of a document; ValueError if it has no place for one."""
    text = path.read_text(encoding="utf-8")
    if text.count(BEGIN) != 1 or text.count(END) != 1:
        raise ValueError(f"{path}: expected one line '{BEGIN}' and one line '{END}'")
    before, _, rest = text.partition(BEGIN)
    rows = "\n".join(result.row() for result in results)
    path.write_text(f"{before}{BEGIN}\n{HEADING}\n{rows}\n{END}{rest.partition(END)[2]}", encoding="utf-8")


def main(arguments: Sequence[str]) -> int:
    """Run the attacks that are asked for; return the exit code."""
    parser = argparse.ArgumentParser(prog="attack", description="Every attack of docs/security.md again.")
    parser.add_argument("--only", default="", help="only attacks with this in who or what")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK} examples at most, as in scripts/test")
    parser.add_argument("--long", action="store_true", help="eight hours of flight, too")
    parser.add_argument("--write", type=Path, metavar="FILE", help="document that gets the table")
    asked = parser.parse_args(arguments)
    os.environ.setdefault("ROS_DOMAIN_ID", "101")
    results = list[Result]()
    print(HEADING)
    for attack in (*ATTACKS, *(LONG if asked.long else ())):
        if asked.only not in f"{attack.who}: {attack.what}":
            continue
        results.append(run(attack, asked.quick))
        print(results[-1].row(), flush=True)
        if results[-1].said:
            print(results[-1].said, file=sys.stderr, flush=True)
    if asked.write is not None:
        write_table(asked.write, results)
    all_held = results and all(each.held == each.trials and not each.said for each in results)
    return GOOD if all_held else CHECK_FAILED
