"""Files that people write: their text and tables, of a bounded size."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

LARGEST = 1 << 18  # bytes; 60 times the largest vehicle, scenario or campaign of quadftc

LONGEST = 80  # characters of a line that is shown


def read_small(path: Path) -> str:
    """Read a UTF-8 text; OSError: it cannot be read, ValueError: it is too large, or no UTF-8."""
    with path.open("rb") as file:
        content = file.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise ValueError(f"larger than {LARGEST >> 10} KiB; expected a file as people write it")
    try:
        return content.decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise ValueError(f"no text in UTF-8, from byte {error.start} on") from None


def read_toml(path: Path) -> dict[str, Any]:
    """Read a table in TOML as `read_small` does; a ValueError as well where it is no TOML."""
    text = read_small(path)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        place = re.search(r" \(at line (\d+), column \d+\)$", str(error))
        if place is None:
            raise
        wrong, said = text.split("\n")[int(place[1]) - 1].strip(), str(error)[: place.start()]
        hint = ": a value with a unit stands in quotes" if "=" in wrong and '"' not in wrong else ""
        raise ValueError(f"line {place[1]}: {wrong[:LONGEST]!r}: {said}{hint}") from None
    except RecursionError:
        raise ValueError("nested too deeply") from None
