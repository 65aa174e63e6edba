"""What `quadftc diagnose` says of every recorded log, one line a log: a change of behaviour is a difference.

    python -m quadftc_tools.study.golden_logs DATA

writes the verdicts on all logs below DATA anew into ``tests/golden/logs.json``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

from quadftc_bags.bag import BagError
from quadftc_cli.commands import BAD_INPUT
from quadftc_cli.commands.diagnose import EXIT_CODES
from quadftc_cli.screen import say
from quadftc_replay.inspection.diagnosis import DiagnosisOptions, diagnose_log

GOLDEN = Path(__file__).resolve().parents[3] / "tests" / "golden" / "logs.json"
FOLDERS = ("ardupilot", "blackbox", "broad", "cases", "crazyflie", "px4")
ENDINGS = (".bin", ".bbl", ".tlog", ".ulg", ".mcap", "")
SHOWN = 3  # findings of a log


def find_logs(data: Path) -> Iterator[Path]:
    """Logs below a folder, in the order of their names."""
    for path in (path for folder in FOLDERS for path in sorted((data / folder).rglob("*"))):
        if path.is_file() and path.suffix.lower() in ENDINGS and path.stem != "LICENSE":
            yield path


def judge_log(path: Path) -> dict[str, object]:
    """Exit code, headline and first findings: component, element, kind, onset [s], probability."""
    try:
        verdict = diagnose_log(path, DiagnosisOptions()).verdict
    except (BagError, ValueError) as error:
        return {"exit": BAD_INPUT, "headline": str(error).replace(str(path), path.name), "findings": []}
    findings = [
        [each.component, each.element, each.kind, round(each.onset_s, 3), round(each.probability, 3)]
        for each in verdict.findings[:SHOWN]
    ]
    return {"exit": EXIT_CODES[verdict.outcome], "headline": verdict.sentence, "findings": findings}


def main() -> None:
    """Write the golden verdicts."""
    parser = argparse.ArgumentParser(description="Write the verdicts on recorded logs anew.")
    parser.add_argument("data", type=Path, help="folder of the logs")
    data = parser.parse_args().data
    lines = [
        f"{json.dumps(path.relative_to(data).as_posix())}: {json.dumps(judge_log(path), ensure_ascii=False)}"
        for path in find_logs(data)
    ]
    GOLDEN.parent.mkdir(exist_ok=True)
    GOLDEN.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    say(f"written: {GOLDEN}, {len(lines)} logs")


if __name__ == "__main__":
    main()
