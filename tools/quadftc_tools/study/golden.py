"""What a fault observer says on all recordings and flights that it is judged on, beside what is stored.

    python -m quadftc_tools.study.golden DIR --observer NAME [--set tuning|judging] [--write]
    python -m quadftc_tools.study.golden --observer NAME --campaign which_sensor --seed 421 --count 160

DIR holds the recordings, in ``broad/`` and ``crazyflie/``; without it there are the simulated flights alone.
Printed are a table of counts and each difference to ``tests/golden/observers/NAME.json``, which ``--write``
writes anew. The exit code is 1 if there is a difference. ``--campaign`` flies others, of any campaign.
docs/judging.md says how to use it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

from quadftc_cli.commands import BAD_INPUT, CHECK_FAILED, GOOD
from quadftc_cli.screen import say
from quadftc_fdi.fault_observer import fault_observers
from quadftc_tools.study.golden_alarms import Verdict, count_table, differences, read_verdicts, write_verdicts
from quadftc_tools.study.golden_trials import SETS, Trial, flights_of, trials

STORED = Path(__file__).resolve().parents[3] / "tests" / "golden" / "observers"


def judge(chosen: Iterable[Trial], observer: str) -> list[tuple[Trial, Verdict]]:
    """Return what an observer says on some trials."""
    return [(trial, trial.judge(observer)) for trial in chosen]


def stored_verdicts(observer: str) -> dict[str, Verdict]:
    """Return what is stored of an observer; nothing if there is no file."""
    path = STORED / f"{observer}.json"
    return read_verdicts(path) if path.is_file() else {}


def table(judged: Iterable[tuple[Trial, Verdict]]) -> str:
    """Write counts by set and kind of trial; first those of all recordings."""
    groups: dict[tuple[str, str], list[Verdict]] = {}
    for trial, verdict in judged:
        if verdict.error_deg is None:
            groups.setdefault((trial.part, "all recordings"), []).append(verdict)
        groups.setdefault((trial.part, trial.kind), []).append(verdict)
    return count_table(groups)


def main() -> int:
    """Judge an observer; print the table and the differences."""
    parser = argparse.ArgumentParser(prog="golden", description="Verdicts of a fault observer, old and new.")
    parser.add_argument("directory", type=Path, nargs="?", help="directory of the recordings")
    parser.add_argument("--observer", required=True, help="name of a fault observer")
    parser.add_argument("--set", choices=SETS, dest="part", help="this half alone")
    parser.add_argument("--write", action="store_true", help="store the verdicts")
    parser.add_argument("--campaign", metavar="NAME", help="other flights alone, of campaigns/NAME.yaml")
    parser.add_argument("--seed", type=int, default=1, help="of these")
    parser.add_argument("--count", type=int, default=100, help="of these")
    options = parser.parse_args()
    try:
        fault_observers.get(options.observer)  # a ValueError names those that there are
        if options.campaign:
            say(table(judge(flights_of(options.campaign, options.seed, options.count), options.observer)))
            return GOOD
        return _run(options.directory, options.observer, options.part, options.write)
    except (ValueError, OSError) as error:
        say(f"error: {error}", stderr=True)
        return BAD_INPUT


def _run(directory: Path | None, observer: str, part: str | None, write: bool) -> int:
    if write and (directory is None or part):
        raise ValueError("--write: expected DIR and no --set, as all verdicts are stored together")
    stored = stored_verdicts(observer)
    judged = judge([trial for trial in trials(directory) if part in (None, trial.part)], observer)
    verdicts = {trial.name: verdict for trial, verdict in judged}
    changes = differences(stored, verdicts) if stored else ["nothing is stored of it"]
    say(f"{observer}\n\n{table(judged)}\n", *changes)
    if write:
        write_verdicts(STORED / f"{observer}.json", verdicts)
        return GOOD
    return CHECK_FAILED if changes else GOOD


if __name__ == "__main__":
    raise SystemExit(main())
