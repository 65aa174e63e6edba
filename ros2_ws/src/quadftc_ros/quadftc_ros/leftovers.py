"""What killed processes leave of Fast DDS in /dev/shm: find it, remove it.

Fast DDS 2 holds an flock on ``X_el`` or ``X_sl`` while a process owns a segment or reads from a port ``X``.
`fastdds shm clean` goes by these locks alone: it misses what has no lock file, and takes what is mapped.
"""

from __future__ import annotations

import fcntl
import os
import re
import time
from contextlib import ExitStack, suppress
from pathlib import Path

MEMORY = Path("/dev/shm")
FILE = re.compile(r"(?:sem\.)?(fastrtps_(?:port\d+|[0-9a-f]{16}))(?:_el|_sl|_mutex)?")
MAPPED = re.compile(rf"{MEMORY}/(fastrtps_\w+)\n")
MIN_AGE = 5.0  # s; a younger file may belong to a process that has not mapped or locked it yet


def find_leftovers() -> dict[str, list[Path]]:
    """Return the files of this user's segments and ports, by name, that are old and that no process maps."""
    files: dict[str, list[Path]] = {}
    for path in MEMORY.glob("*fastrtps_*"):
        if match := FILE.fullmatch(path.name):
            files.setdefault(match[1], []).append(path)
    in_use = set[str]()
    for maps in Path("/proc").glob("[0-9]*/maps") if files else ():
        with suppress(OSError):  # it has ended, or is another user's, who is known by his locks
            in_use.update(MAPPED.findall(maps.read_text(errors="replace")))
    return {name: found for name, found in files.items() if name not in in_use and all(map(_is_old, found))}


def remove_leftovers() -> int:
    """Remove of `find_leftovers` what no process holds a lock on; return how many segments and ports went."""
    return sum(_remove(name, found) for name, found in find_leftovers().items())


def _is_old(path: Path) -> bool:
    with suppress(OSError):
        status = path.stat()
        return status.st_uid == os.geteuid() and time.time() - status.st_mtime > MIN_AGE
    return False


def _remove(name: str, found: list[Path]) -> bool:
    locks = {MEMORY / f"{name}_el", *(path for path in found if path.name.endswith("_sl"))}
    with ExitStack() as held, suppress(OSError):  # meanwhile, who wants this port takes another
        for path in locks:
            lock = os.open(path, os.O_RDONLY | os.O_CREAT, 0o666)
            held.callback(os.close, lock)
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        for path in {*found, *locks}:
            path.unlink(missing_ok=True)
        return True
    return False
