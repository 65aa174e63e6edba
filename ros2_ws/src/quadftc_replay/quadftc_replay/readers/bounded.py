"""A reader in a process of its own, whose processor time, memory and output are in proportion to the file.

    python -m quadftc_replay.readers.bounded PARENT SECONDS SIZE RESULT

reads a pickled function and its arguments from standard input, calls it, and pickles what it returns into
RESULT. Libraries that decode what comes from outside may loop, fill the memory or crash on a damaged file;
then this process ends, and says on standard output what is wrong. Limits hold on Linux.
"""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from quadftc_bags.bag import BagError
from quadftc_replay.flight_log import FlightLog
from quadftc_replay.readers import ONLY_ONE, LogChoice, Reader, find_reader, read_unpacked, unpacked

Read = TypeVar("Read")
BAD_INPUT, NO_MEMORY = 2, 3  # exit codes
MEGABYTE = 1e6  # bytes
START, MARGIN = 10, 10  # s of processor time for any log, and how many times what its format takes
END_WITH_PARENT = 1  # PR_SET_PDEATHSIG of prctl(2)
PATIENCE = 10  # s of waiting for a second of processor time, as on a busy machine
# bytes that any log may have, and more of a byte of the log
MEMORY, MEMORY_SHARE = 2 << 30, 4  # of address space, libraries among them
OUTPUT, OUTPUT_SHARE = 64 << 20, 40  # of the result
# threads reserve memory; modules in the working directory are not to be imported
SETTINGS = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONSAFEPATH": "1"}


def read_bounded(path: Path, choice: LogChoice = ONLY_ONE) -> FlightLog:
    """Read a log of any format as `read_log` does; a BagError says as well which limit was passed."""
    with unpacked(path, choice) as source:
        reader = find_reader(source.file, source.choice)
        return source.finish(call_bounded(reader, read_unpacked, source.file, source.choice), path)


def call_bounded(reader: Reader, read: Callable[..., Read], path: Path, *arguments: object) -> Read:
    """Call ``read(path, *arguments)``, a function of a module, in a process with the limits of a reader."""
    with tempfile.TemporaryDirectory(prefix="quadftc-") as folder:
        result = Path(folder, "result")
        _run(reader, path, pickle.dumps((read, (path, *arguments))), str(result))
        return pickle.loads(result.read_bytes())  # written by this very package


def _run(reader: Reader, path: Path, call: bytes, result: str) -> None:
    size = _size(path)
    seconds = processor_time(reader, size)
    command = [sys.executable, "-m", __name__, *map(str, (os.getpid(), seconds, size)), result]
    what = f"{path}: the reader of a {reader.name} log"
    try:
        done = subprocess.run(
            command,
            env=os.environ | SETTINGS,
            input=call,
            capture_output=True,
            check=False,
            timeout=PATIENCE * seconds,
        )
    except subprocess.TimeoutExpired:
        raise BagError(f"{what} was stopped: more than {PATIENCE * seconds} s") from None
    if done.returncode == BAD_INPUT:
        raise BagError(_last_line(done.stdout))
    share = f"for {size / MEGABYTE:.3g} MB"
    if done.returncode == NO_MEMORY:
        raise BagError(f"{what} was stopped: more than {memory(size) >> 20} MiB of memory {share}")
    if done.returncode < 0 and done.returncode == -signal.SIGXCPU:
        raise BagError(f"{what} was stopped: more than {seconds} s of processor time {share}")
    if done.returncode < 0:
        raise BagError(f"{what} crashed ({signal.Signals(-done.returncode).name})")
    if done.returncode:
        raise BagError(f"{what} failed: {_last_line(done.stderr) or f'exit code {done.returncode}'}")


def _last_line(said: bytes) -> str:
    return said.decode("utf-8", "replace").strip().rpartition("\n")[2]


def _size(path: Path) -> int:
    files = [each for each in path.iterdir() if each.is_file()] if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files)


def processor_time(reader: Reader, size: int) -> int:
    """Processor time that a log may take [s]."""
    return START + round(MARGIN * reader.cost * size / MEGABYTE)


def memory(size: int) -> int:
    """Address space that a log may take [bytes]."""
    return MEMORY + MEMORY_SHARE * size


def limit_resources(seconds: int, size: int) -> None:
    """Bound what this process can use up, and let it end with its parent."""
    import resource  # not on Windows

    ctypes.CDLL(None).prctl(END_WITH_PARENT, signal.SIGKILL)
    for what, most in (
        (resource.RLIMIT_AS, memory(size)),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_FSIZE, OUTPUT + OUTPUT_SHARE * size),
        (resource.RLIMIT_CORE, 0),
    ):
        hard = resource.getrlimit(what)[1]
        bound = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(what, (bound, hard))


def main(arguments: list[str]) -> int:
    """Call the function from standard input with the limits of the command line."""
    parent, seconds, size = map(int, arguments[:3])
    result = Path(arguments[3])
    try:
        read, given = pickle.load(sys.stdin.buffer)
        if sys.platform == "linux":
            limit_resources(seconds, size)
            if os.getppid() != parent:  # it ended before
                return BAD_INPUT
        value = read(*given)
        with result.open("wb") as stream:
            pickle.dump(value, stream, pickle.HIGHEST_PROTOCOL)
    except MemoryError:
        return NO_MEMORY
    except BagError as error:
        sys.stdout.write(" ".join(str(error).split()))
        return BAD_INPUT
    except OSError as error:
        sys.stdout.write(f"{error.filename or f'temporary file {result}'}: {error.strerror or error}")
        return BAD_INPUT
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
