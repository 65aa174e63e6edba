"""Where compiled laws are kept: a folder that belongs to the user alone.

A library is loaded into the process, so whoever can write it can run code there. The folder, and what is in
it, must belong to the user, and nobody else may write to it. Each entry has a record beside it that says what
it is and what its bytes are; one that does not fit, or was made for another processor, is made anew.

A wheel carries entries, too, for every processor of a kind: they are as safe as the modules beside them.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import stat
import tempfile
from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from typing import Any

Record = Mapping[str, Any]  # what a library is, in plain data

RECORD, LIBRARY = ".json", ".so"
CARRIED = Path(__file__).parent / "carried"  # in a wheel alone
MACHINES = {62: "x86_64", 183: "aarch64"}  # of what a wheel carries; e_machine of ELF


class CacheError(OSError):
    """The folder cannot be used: why."""


def cache_folder() -> Path:
    """Return the folder, which is made if it is not there; CacheError if it cannot be used."""
    if os.name != "posix":
        raise CacheError("compiled laws are kept on POSIX systems only")
    home = os.environ.get("QUADFTC_CACHE")
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(home) if home else Path(base) / "quadftc" / "laws"
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        folder.chmod(0o700)
        status = folder.lstat()
    except OSError as error:
        raise CacheError(f"{folder}: {error.strerror}") from None
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid():
        raise CacheError(f"{folder}: expected a folder of this user's own; set QUADFTC_CACHE to another")
    return folder


def processor() -> str:
    """Return what a library is made for: the kind of the processor, and what it can do."""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        told = sorted({line for line in lines if line.startswith(("flags", "Features", "model name"))})
        return f"{platform.machine()} {hashlib.sha256(chr(10).join(told).encode()).hexdigest()[:16]}"
    return f"{platform.machine()} {platform.processor()}"


def load_entry(key: str) -> tuple[Path, Record] | None:
    """Return library and record of an entry; None if it is not there, damaged, or not to be trusted."""
    return _load(cache_folder(), key, processor(), _trusted)


def load_carried(key: str) -> tuple[Path, Record] | None:
    """Return library and record of an entry that the wheel carries; None if it is not there, or damaged."""
    return _load(CARRIED, key, platform.machine(), lambda path: path)


def _load(
    folder: Path, key: str, made_for: str, trusted: Callable[[Path], Path]
) -> tuple[Path, Record] | None:
    try:
        record = json.loads(trusted(folder / f"{key}{RECORD}").read_text(encoding="utf-8"))
        library = trusted(folder / f"{key}-{record['sha256'][:16]}{LIBRARY}")
        content = library.read_bytes()
        fits = record["key"] == key and record["processor"] == made_for
        if not fits or hashlib.sha256(content).hexdigest() != record["sha256"]:
            return None
        return library, record
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _trusted(path: Path) -> Path:
    """Return a path; OSError if it is not a file of this user's own that nobody else may write."""
    status = path.lstat()
    if not stat.S_ISREG(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o022:
        raise OSError(f"{path}: not a file of this user's own")
    return path


def store_entry(key: str, library: bytes, record: Record) -> Path:
    """Keep an entry; OSError if it cannot be written. What is half-written is never seen."""
    return _store(cache_folder(), key, processor(), library, record)


def store_carried(folder: Path, key: str, library: bytes, record: Record) -> None:
    """Put an entry for a wheel into a folder; OSError if it cannot be written."""
    _store(folder, key, machine_of(library), library, record)


def machine_of(library: bytes) -> str:
    """Return what `platform.machine` says where a library runs; ValueError if that is not in `MACHINES`."""
    machine = MACHINES.get(int.from_bytes(library[18:20], "little"))
    if not library.startswith(b"\x7fELF\x02") or machine is None:
        raise ValueError(f"not a 64-bit library of Linux for any of {', '.join(MACHINES.values())}")
    return machine


def _store(folder: Path, key: str, made_for: str, library: bytes, record: Record) -> Path:
    digest = hashlib.sha256(library).hexdigest()
    path = folder / f"{key}-{digest[:16]}{LIBRARY}"
    _replace(path, library)
    whole = {**record, "key": key, "processor": made_for, "sha256": digest}
    try:
        _replace(folder / f"{key}{RECORD}", json.dumps(whole).encode())
    except OSError:
        path.unlink(missing_ok=True)  # nobody would find it
        raise
    return path


def _replace(path: Path, content: bytes) -> None:
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=".new-")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        Path(name).replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            Path(name).unlink()
        raise


@contextlib.contextmanager
def lock_entry(key: str) -> Generator[None]:
    """Hold an entry: of several processes one makes it, the others wait. Without a folder, no lock."""
    try:
        path = cache_folder() / f"{key}.lock"
        file = path.open("w")
        import fcntl  # not on Windows
    except OSError:
        yield
        return
    with file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
        with contextlib.suppress(OSError):
            path.unlink()
