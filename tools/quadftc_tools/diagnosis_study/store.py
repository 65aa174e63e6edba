"""Records of the study in a file of JSON lines, one for each flight and observer.

Lines are added as flights end, so that a study that was interrupted goes on where it was; of several records
of one flight and observer the last counts.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any, cast

Record = dict[str, Any]
Key = tuple[str, str, str]  # setting, variant, flight

FILE = "flights.jsonl"
FIELDS = ("setting", "variant", "flight", "digest")


class Store:
    """The records in a directory.

    Parameters
    ----------
    directory : Path
        Made if it does not exist.

    Raises
    ------
    ValueError
        If the file in it is not one of this study; the message names the line.
    """

    def __init__(self, directory: Path) -> None:
        directory.mkdir(parents=True, exist_ok=True)
        self.path = directory / FILE
        self._records: dict[Key, Record] = {}
        if self.path.exists():
            self._read()

    def __len__(self) -> int:
        return len(self._records)

    def get(self, setting: str, variant: str, flight: str, digest: str | None) -> Record | None:
        """Return a record if there is one of this digest; None as digest: of any."""
        record = self._records.get((setting, variant, flight))
        return record if record is not None and digest in (None, record["digest"]) else None

    def add(self, records: Iterable[Record]) -> None:
        """Write records and keep them."""
        found = list(records)
        with self.path.open("a", encoding="utf-8") as file:
            file.writelines(
                f"{json.dumps(record, separators=(',', ':'), allow_nan=False)}\n" for record in found
            )
        for record in found:
            self._records[_key(record)] = record

    def _read(self) -> None:
        data = self.path.read_bytes()
        whole = data[: data.rfind(b"\n") + 1]
        if len(whole) < len(data):  # the last line was cut short; lines to come shall not join it
            self.path.write_bytes(whole)
        for number, line in enumerate(whole.splitlines(), start=1):
            record = _parsed(line, f"{self.path}: line {number}")
            self._records[_key(record)] = record


def _parsed(line: bytes, where: str) -> Record:
    try:
        found: Any = json.loads(line)
    except ValueError:
        found = None
    record = cast("Record", found) if isinstance(found, dict) else {}
    if not all(isinstance(record.get(name), str) for name in FIELDS):
        raise ValueError(
            f"{where}: expected a record of this study; remove the line or choose another directory"
        )
    return record


def _key(record: Record) -> Key:
    return record["setting"], record["variant"], record["flight"]
