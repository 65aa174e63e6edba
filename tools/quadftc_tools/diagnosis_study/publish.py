"""Where the results go: a JSON file, the tables of the document, and its figures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from quadftc_tools.diagnosis_study.document import with_tables
from quadftc_tools.diagnosis_study.figures import save_figures
from quadftc_tools.diagnosis_study.tables import tables

FILE, DOCUMENT, FIGURES = "diagnosis.json", "diagnosis.md", "figures"


def publish(results: Mapping[str, Any], out: Path, docs: Path | None) -> list[Path]:
    """Write ``diagnosis.json``; into ``docs``, if given, tables and figures. Return the files.

    Parameters
    ----------
    results : mapping
        Of `gather`.
    out : Path
        Directory, which exists.
    docs : Path, optional
        Directory of the document.

    Raises
    ------
    ValueError
        If the document has no place for a table.
    OSError
        If a file cannot be read or written.
    """
    file = out / FILE
    file.write_text(json.dumps(results, separators=(",", ":"), allow_nan=False) + "\n", encoding="utf-8")
    if docs is None:
        return [file]
    document = docs / DOCUMENT
    text = with_tables(document.read_text(encoding="utf-8"), tables(results), str(document))
    document.write_text(text, encoding="utf-8")
    return [file, document, *save_figures(results, docs / FIGURES)]
