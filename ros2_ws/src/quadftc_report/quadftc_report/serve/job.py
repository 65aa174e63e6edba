"""Judge one log in a process of its own.

    python -m quadftc_report.serve.job LOG DIR [--log=N] [--system=N] [--mapping=FILE]

writes ``verdict.json``, ``report.html`` and ``picture.svg`` into DIR. Standard output has a line of
`STAGES` as each begins. With exit code 2 its last line says what is wrong with the log.
"""

from __future__ import annotations

import argparse
import resource
import sys
from pathlib import Path

BAD_INPUT = 2  # exit code
MEMORY = 8 << 30  # bytes of address space, libraries among them
CPU_TIME = 1800  # s
LARGEST_FILE = 1 << 30  # bytes that may be written into one file
STAGES = ("reading", "judging sensors", "judging rotors", "drawing")  # in this order
SENSORS = 0.7  # share of `inspect` after which it turns to the rotors
PICTURE = "picture.svg"


def limit_resources() -> None:
    """Bound what a log can use up, whatever is in it."""
    for what, most in (
        (resource.RLIMIT_AS, MEMORY),
        (resource.RLIMIT_CPU, CPU_TIME),
        (resource.RLIMIT_FSIZE, LARGEST_FILE),
        (resource.RLIMIT_CORE, 0),
    ):
        hard = resource.getrlimit(what)[1]
        bound = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(what, (bound, bound))


def stage_of(share: float) -> str:
    """Return the stage in which `diagnose_log` is after a share of its work."""
    from quadftc_replay.inspection.diagnosis import READING

    begins = (READING, READING + (1.0 - READING) * SENSORS)
    return STAGES[sum(share >= begin for begin in begins)]


def main() -> int:
    """Judge the log of the command line."""
    limit_resources()
    from quadftc_replay.inspection.diagnosis import DiagnosisOptions, diagnose_log, write_verdict
    from quadftc_replay.readers import LogChoice

    parser = argparse.ArgumentParser(allow_abbrev=False)
    parser.add_argument("log", type=Path)
    parser.add_argument("directory", type=Path)
    parser.add_argument("--log", type=int, default=0, dest="number")
    parser.add_argument("--system", type=int, default=0)
    parser.add_argument("--mapping", type=Path)
    asked = parser.parse_args()
    log, stage = asked.log, ""

    def enter(new: str) -> None:
        nonlocal stage
        if new != stage:
            stage = new
            sys.stdout.write(f"{stage}\n")
            sys.stdout.flush()

    # what is wrong with the log is the last line, without its path
    enter(STAGES[0])
    try:
        options = DiagnosisOptions(choice=LogChoice(asked.number, asked.system, asked.mapping))
        inspection = diagnose_log(log, options, lambda share: enter(stage_of(share)))
    except MemoryError:
        sys.stdout.write("the log needs more memory than it may have\n")
        return BAD_INPUT
    except (ValueError, OSError) as error:
        words = str(error).replace(f"{log}: ", "").replace(str(log), log.name)
        words = " ".join(words.replace(str(asked.mapping), "mapping").split())
        sys.stdout.write(f"{words}\n")
        return BAD_INPUT
    enter(STAGES[-1])
    from quadftc_report.draw_matplotlib import save_picture
    from quadftc_report.verdict_page import figures_of, write_page

    write_page(inspection, asked.directory)
    save_picture(figures_of(inspection)[0][0], asked.directory / PICTURE)
    write_verdict(inspection.verdict, asked.directory)
    return 0


if __name__ == "__main__":
    sys.exit(main())
