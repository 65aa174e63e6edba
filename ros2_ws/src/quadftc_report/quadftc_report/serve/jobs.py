"""The logs that were dropped: a directory each, judged a few at a time by processes of their own.

    FOLDER/<id>/in/<name>      the file as it came; it is read, never run
    FOLDER/<id>/job.json       its name, when it came, what became of it
    FOLDER/<id>/mapping.toml   what the columns of a table mean, if somebody said so
    FOLDER/<id>/verdict.json   and what else the judgement wrote

The id is made here. Of the file's name only letters, digits, dots, hyphens and underscores get into a path.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import secrets
import shutil
import sys
from collections.abc import AsyncIterable, AsyncIterator
from datetime import datetime, timezone
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, Field, ValidationError

from quadftc_replay.inspection.verdict import Verdict
from quadftc_report.serve.job import PICTURE, STAGES
from quadftc_report.serve.local import make_private

JOB, VERDICT, REPORT = "job.json", "verdict.json", "report.html"
MAPPING = "mapping.toml"
RESULTS = {
    VERDICT: "application/json",
    REPORT: "text/html; charset=utf-8",
    PICTURE: "image/svg+xml",
}  # handed out
ID = re.compile(r"[0-9]{8}T[0-9]{6}-[0-9a-f]{8}")
LONGEST_NAME = 80  # characters
LONGEST = 1 << 16  # characters of a mapping
LONGEST_LINE = 4096  # bytes of what a process says
PATIENCE = 3600.0  # s; a judgement that takes longer is stopped
INTERRUPTED = "interrupted: the page was closed before the log was judged"

State = Literal["waiting", "running", "done", "failed"]


class TooLargeError(ValueError):
    """An upload is larger than it may be."""


class Job(BaseModel):
    """A log that was dropped."""

    id: str
    name: str  # of the file, as it is in the folder
    received: datetime
    size: int = 0  # bytes
    state: State = "waiting"
    message: str = ""  # why it failed
    stage: str = ""  # of `STAGES`, while it runs
    log: int = 0  # which of several logs in the file; 0: the only one
    system: int = 0  # which of several vehicles, by its MAVLink system; 0: the only one
    mapping: str = ""  # what the columns of a table mean
    verdict: Verdict | None = None


def _none_is_zero(value: object) -> object:
    return value or 0  # of a field that was left empty


class Choice(BaseModel):
    """Which log of a file is meant, and how it is read; None: as before."""

    log: Annotated[int, Field(ge=0), BeforeValidator(_none_is_zero)] | None = None
    system: Annotated[int, Field(ge=0, le=255), BeforeValidator(_none_is_zero)] | None = None
    mapping: Annotated[str, Field(max_length=LONGEST)] | None = None


def safe_name(name: str) -> str:
    """Return a file's name without directories and without anything but plain characters."""
    last = re.split(r"[/\\]", name)[-1]
    return re.sub(r"[^A-Za-z0-9._-]+", "_", last).lstrip(".")[-LONGEST_NAME:] or "log"


class Jobs:
    """All jobs of a folder, of which ``at_a_time`` run; used from one event loop."""

    def __init__(self, folder: Path, at_a_time: int = 2, largest: int = 1 << 30) -> None:
        self.folder = folder.resolve()
        make_private(self.folder)
        self.largest = largest  # bytes of one upload
        self.version = 0  # grows whenever something changes
        self._jobs: dict[str, Job] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._places = asyncio.Semaphore(at_a_time)
        for path in sorted(self.folder.iterdir()):
            if ID.fullmatch(path.name) and (job := _read_job(path)) is not None:
                self._jobs[job.id] = job

    def all(self) -> list[Job]:
        """Return all jobs, the latest first."""
        return sorted(self._jobs.values(), key=lambda job: job.received, reverse=True)

    async def receive(self, name: str, blocks: AsyncIterable[bytes]) -> Job:
        """Store a log block by block, and let it be judged; of one that is too large nothing is kept."""
        now = datetime.now(timezone.utc)
        key = f"{now:%Y%m%dT%H%M%S}-{secrets.token_hex(4)}"
        job = Job(id=key, name=safe_name(name), received=now)
        path = self._log(job)
        path.parent.mkdir(parents=True)
        try:
            with path.open("xb") as stream:
                async for block in blocks:
                    job.size += len(block)
                    if job.size > self.largest:
                        raise TooLargeError(f"larger than {self.largest >> 20} MiB")
                    await asyncio.to_thread(stream.write, block)
        except BaseException:  # also of a browser that went away
            shutil.rmtree(self.folder / job.id, ignore_errors=True)
            raise
        path.chmod(0o400)
        self._jobs[job.id] = job
        self._start(job)
        return job

    def judge_again(self, key: str) -> None:
        """Judge a log once more; nothing happens while it runs."""
        if (job := self._jobs.get(key)) is None or key in self._tasks:
            return
        for name in RESULTS:
            (self.folder / key / name).unlink(missing_ok=True)
        job.verdict, job.message = None, ""
        self._start(job)

    def choose(self, key: str, choice: Choice) -> None:
        """Judge a log once more: of several the one that is meant, a table by a mapping."""
        if (job := self._jobs.get(key)) is None or key in self._tasks:
            return
        for name, value in choice.model_dump(exclude_none=True).items():
            setattr(job, name, value)
        self.judge_again(key)

    def _start(self, job: Job) -> None:
        job.state = "waiting"
        self._note(job)
        self._tasks[job.id] = asyncio.create_task(self._judge(job))

    async def remove(self, key: str) -> None:
        """Stop a job if it runs, and delete its directory; nothing happens if there is none of this id."""
        if key not in self._jobs:
            return
        if task := self._tasks.pop(key, None):
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task
        self._jobs.pop(key, None)
        await asyncio.to_thread(shutil.rmtree, self.folder / key, ignore_errors=True)
        self.version += 1

    def result(self, key: str, name: str) -> Path | None:
        """Return a file that a judgement wrote, if there is one of that name."""
        path = self.folder / key / name
        is_result = key in self._jobs and name in RESULTS and path.is_file() and path == path.resolve()
        return path if is_result else None

    async def close(self) -> None:
        """Stop what runs."""
        tasks = list(self._tasks.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _log(self, job: Job) -> Path:
        return self.folder / job.id / "in" / job.name

    def _note(self, job: Job, write: bool = True) -> None:
        self.version += 1
        if write:
            text = job.model_dump_json(indent=2, exclude={"verdict", "stage"})
            whole = self.folder / job.id / f"{JOB}.new"
            whole.write_text(f"{text}\n", "utf-8")
            whole.replace(whole.with_suffix(""))

    async def _judge(self, job: Job) -> None:
        """Judge a log when there is a place."""
        async with self._places:
            job.state, job.stage = "running", STAGES[0]
            self._note(job)
            try:
                job.message = await asyncio.wait_for(self._run(job), PATIENCE)
            except asyncio.TimeoutError:
                job.message = f"stopped: not judged within {PATIENCE / 60.0:.0f} min"
            job.verdict = None if job.message else _read_verdict(self.folder / job.id)
            job.state = "done" if job.verdict else "failed"
            job.message = job.message or ("" if job.verdict else "no verdict was written")
            self._note(job)
            self._tasks.pop(job.id, None)

    async def _run(self, job: Job) -> str:
        """Run the process that judges; return what is wrong, empty if nothing is."""
        numbers = (("log", job.log), ("system", job.system))
        options = [f"--{name}={number}" for name, number in numbers if number]
        if job.mapping:
            mapping = self.folder / job.id / MAPPING
            mapping.write_text(job.mapping, "utf-8")
            options.append(f"--mapping={mapping}")
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "quadftc_report.serve.job", self._log(job), self.folder / job.id),
            *options,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
            limit=LONGEST_LINE,
        )
        assert process.stdout is not None
        said = ""
        try:
            async for line in _lines(process.stdout):
                if line in STAGES:
                    job.stage = line
                else:
                    said = line
                self._note(job, write=False)
            code = await process.wait()
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        return "" if code == 0 else said or f"the judgement ended with code {code}"


async def _lines(stream: asyncio.StreamReader) -> AsyncIterator[str]:
    """Yield the lines of a process; of one that is too long nothing."""
    while True:
        try:
            line = await stream.readline()
        except ValueError:  # longer than the limit
            continue
        if not line:
            return
        yield line.decode("utf-8", "replace").strip()


def _read_job(path: Path) -> Job | None:
    """Read a job of an earlier time; None if it is damaged, or leads out of its folder by a link."""
    if any(each.is_symlink() for each in (path, *path.rglob("*"))):
        return None
    try:
        job = Job.model_validate_json((path / JOB).read_bytes())
    except (OSError, ValidationError):
        return None
    if job.id != path.name:
        return None
    if job.state in ("waiting", "running"):
        job.state, job.message = "failed", INTERRUPTED
    job.verdict = _read_verdict(path) if job.state == "done" else None
    return job


def _read_verdict(path: Path) -> Verdict | None:
    try:
        return Verdict.model_validate_json((path / VERDICT).read_bytes())
    except (OSError, ValidationError):
        return None
