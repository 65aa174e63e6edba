"""Write what a step of each law costs into docs/performance.md.

First: ``quadftc bench step --out results/step``, and the same with ``--engine numpy``. Then:
``python -m quadftc_tools.docs.law_costs results/step --docs docs``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from quadftc_tools.study.page import NOTHING, markdown, run_study

FREE = "free flight"
HEADS = ("law", "NumPy [us]", "C from Python [us]", "in a loop of C [us]", "compile [s]")


def table(folder: Path) -> str:
    """Return the table of the results in a folder: of a law in both places the dearer one, in free flight.

    A law that no compiler takes has NumPy alone.
    """
    in_c, in_numpy = (_results(folder / f"step_{engine}.json") for engine in ("c", "numpy"))
    shown = (key for key in in_numpy if key[2] == FREE or (*key[:2], FREE) not in in_numpy)
    return markdown(HEADS, (_row(key, in_numpy[key], in_c.get(key, {})) for key in shown))


def _results(path: Path) -> dict[tuple[str, str, str], dict[str, Any]]:
    rows = json.loads(path.read_text(encoding="utf-8"))["results"]
    return {(row["kind"], row["law"], row["place"]): row for row in rows}


def _row(key: tuple[str, str, str], numpy: dict[str, Any], in_c: dict[str, Any]) -> list[str]:
    kind, law, _ = key
    cells = [f"{kind} `{law}`", f"{numpy['best_us']:.0f}"]
    if "loop_us" not in in_c:
        return [*cells, *(NOTHING,) * 3]
    return [*cells, f"{in_c['best_us']:.1f}", f"{in_c['loop_us']:.2f}", f"{in_c['compile_s']:.2f}"]


if __name__ == "__main__":
    known = {"folder": {"type": Path, "help": "directory of the results"}}
    sys.exit(run_study("performance.md", lambda told: {"law-costs": table(told.folder)}, known))
