"""Write what a step of each law costs into a document, as a table between its marks.

First: ``quadftc bench step --out results/step``, and the same with ``--engine numpy``. Then:
``python -m quadftc_tools.docs.law_costs results/step docs/performance.md``.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

MARKS = re.compile(r"(<!-- law costs: begin[^\n]*-->\n).*?(<!-- law costs: end -->)", re.S)
TIMES = ("NumPy [us]", "C from Python [us]", "in a loop of C [us]")
COLUMNS = ("law", "where", *TIMES, "statements", "trace [s]", "compile [s]", "KiB")
HEAD = f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|\n"


def table(folder: Path) -> str:
    """Return the table of the results in a folder; a law that no compiler takes has NumPy alone."""
    in_c, in_numpy = (_results(folder / f"step_{engine}.json") for engine in ("c", "numpy"))
    return HEAD + "".join(_row(key, row, in_c.get(key, {})) for key, row in in_numpy.items())


def renew(text: str, folder: Path) -> str:
    """Put the table between its marks."""
    return MARKS.sub(lambda match: match[1] + table(folder) + match[2], text)


def _results(path: Path) -> dict[tuple[str, str, str], dict[str, Any]]:
    rows = json.loads(path.read_text(encoding="utf-8"))["results"]
    return {(row["kind"], row["law"], row["place"]): row for row in rows}


def _row(key: tuple[str, str, str], numpy: Mapping[str, Any], in_c: Mapping[str, Any]) -> str:
    kind, law, place = key
    cells = [f"{kind} `{law}`", place, f"{numpy['best_us']:.0f}"]
    if "loop_us" in in_c:
        cells += [f"{in_c['best_us']:.1f}", f"{in_c['loop_us']:.2f}", str(in_c["statements"])]
        cells += [f"{in_c[name]:.2f}" for name in ("trace_s", "compile_s")]
        cells.append(f"{in_c['bytes'] / 1024:.0f}")
    else:
        cells += ["-"] * 6
    return f"| {' | '.join(cells)} |\n"


if __name__ == "__main__":
    source, document = map(Path, sys.argv[1:])
    document.write_text(renew(document.read_text(encoding="utf-8"), source), encoding="utf-8")
