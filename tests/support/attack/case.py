"""One bad input: files and a command line, how a program answered it, and whether that was right."""

from __future__ import annotations

import contextlib
import io
import os
import resource
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from quadftc_cli.commands import BAD_INPUT, CHECK_FAILED, GOOD, INTERRUPTED, NOT_ENOUGH

ALLOWED = (GOOD, CHECK_FAILED, BAD_INPUT, NOT_ENOUGH, INTERRUPTED)  # exit codes
MAX_LINES, MAX_LINE = 12, 4000  # of what is said about a bad input; characters
MAX_GROWTH = 700 * 1024  # KiB by which the memory of the process may grow with one input
INSIDE = Path("outer", "inner", "work")  # working folder, within the sandbox: what is written outside shows

Program = Callable[[Sequence[str]], int]


@dataclass(frozen=True)
class Case:
    """An input: files by path in the working folder, and arguments.

    A path that ends in ``->`` is a symbolic link to the text.
    """

    target: str
    files: dict[str, bytes] = field(default_factory=dict, repr=False)  # too long to be shown
    arguments: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Outcome:
    """How a program answered: exit code, texts, and what is wrong."""

    code: int
    out: str
    err: str
    wrong: str


def try_case(case: Case, program: Program, sandbox: Path) -> Outcome:
    """Run a program on a case, in this process, in ``outer/inner/work`` of an emptied sandbox."""
    shutil.rmtree(sandbox, ignore_errors=True)
    work = sandbox / INSIDE
    work.mkdir(parents=True)
    _write(case, work)
    before, memory = _outside(sandbox), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    out, err = _stream("strict"), _stream("backslashreplace")
    code, trouble, where = -1, "", Path.cwd()
    os.chdir(work)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = program(case.arguments)
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else GOOD if error.code is None else -1
    except BaseException as error:
        trouble = f"{type(error).__name__}: {error}"
    finally:
        os.chdir(where)
    said, complained = _text(out), _text(err)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory
    wrong = trouble or _wrong(code, said, complained)
    if not wrong and _outside(sandbox) != before:
        wrong = f"wrote outside the working folder: {sorted(_outside(sandbox) - before)}"
    if not wrong and grown > MAX_GROWTH:
        wrong = f"memory grew by {grown // 1024} MiB"
    return Outcome(code, said, complained, wrong)


def _write(case: Case, work: Path) -> None:
    for name, data in case.files.items():
        path = work / name.removesuffix("->")
        path.parent.mkdir(parents=True, exist_ok=True)
        if name.endswith("->"):
            path.symlink_to(data.decode())
        else:
            path.write_bytes(data)


def _wrong(code: int, out: str, err: str) -> str:
    """Say what is wrong with an exit code and what was said; empty if nothing."""
    lines = [line for line in err.splitlines() if line.strip()]
    if code not in ALLOWED:
        return f"exit code {code}: {' '.join(lines[:1])[:400]} {' '.join(lines[-4:])[-400:]}"
    if "Traceback (most recent call last)" in out + err:
        return "a traceback"
    if code != BAD_INPUT:
        return ""
    if not any(line.startswith("error: ") for line in lines):
        return "refused without a reason"
    if len(lines) > MAX_LINES or max(map(len, lines)) > MAX_LINE:
        return f"refused in {len(lines)} lines, the longest of {max(map(len, lines))} characters"
    return ""


def _outside(sandbox: Path) -> set[str]:
    """Everything in the sandbox that is not in the working folder."""
    work = str(INSIDE)
    found = [path for depth in ("*", "*/*", "*/*/*") for path in sandbox.glob(depth)]
    names = {os.fspath(path.relative_to(sandbox)) for path in found}
    return {name for name in names if not name.startswith(work)}


def _stream(errors: str) -> io.TextIOWrapper:
    """What stands for stdout or stderr: a file, as some programs ask for its number."""
    return io.TextIOWrapper(tempfile.TemporaryFile(), encoding="utf-8", errors=errors)


def _text(stream: io.TextIOWrapper) -> str:
    with stream:
        stream.flush()
        written: Any = stream.buffer
        written.seek(0)
        return written.read().decode("utf-8", "replace")
