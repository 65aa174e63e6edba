"""Many flights of a firmware side by side, each in a process and folder of its own."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import yaml

from quadftc_campaign.workers import run_tasks, started_workers
from quadftc_flight.run_files import RunError
from quadftc_flight.summary import Summary
from quadftc_sitl.firmware import SitlError, parameter_file
from quadftc_sitl.plan import SitlPlan, plan_of_text
from quadftc_sitl.sitl_flight import SUMMARY, fly_sitl

JOB = "job.yaml"  # what a folder was flown with


class Job(NamedTuple):
    """A flight that is to be flown."""

    name: str
    text: str  # of its scenario, with the key `autopilot`
    scheme: str
    autopilot: str
    binary: Path
    parameters: Mapping[str, float]
    out: Path  # its folder
    engine: str

    @property
    def inputs(self) -> str:
        """All that decides the flight, but for the binary."""
        return yaml.safe_dump([self.text, self.scheme, self.autopilot, dict(self.parameters), self.engine])


def job_of(plan: SitlPlan, binary: Path, parameters: Mapping[str, float], out: Path, engine: str) -> Job:
    """Return the job of a plan; the flights of ``out`` have a folder each."""
    text = yaml.safe_dump(plan.raw, sort_keys=False, width=120)
    names = plan.scheme.name, plan.autopilot.name
    return Job(plan.name, text, *names, binary, parameters, out / plan.name, engine)


def fly_jobs(
    jobs: Sequence[Job], workers: int, resume: bool, follow: Callable[[int], object]
) -> list[Summary]:
    """Fly jobs, so many side by side; return their summaries in order.

    With ``resume`` those that were flown are kept. A flight that could not be flown has a summary with
    ``error``, and none is kept of it. ``follow(done)`` is called after each.
    """
    found = {number: stored for number, job in enumerate(jobs) if (stored := _stored(job, resume))}
    follow(len(found))
    left = [number for number in range(len(jobs)) if number not in found]
    if workers == 1:
        for number in left:
            found[number] = fly_job(jobs[number])
            follow(len(found))
        return [found[number] for number in range(len(jobs))]
    with started_workers(workers) as pool:
        for place, summary in run_tasks(pool, _fly, [(jobs[number],) for number in left]):
            found[left[place]] = summary
            follow(len(found))
    return [found[number] for number in range(len(jobs))]


def _fly(job: Job, _progress: object) -> Summary:
    """Fly one job in a process, anew where one was lost with it."""
    clear(job.out)
    return fly_job(job)


def fly_job(job: Job) -> Summary:
    """Fly one job in this process; return its summary."""
    plan = plan_of_text(job.text, job.scheme, job.name, job.autopilot)
    try:
        result = fly_sitl(plan, job.binary, job.out, job.parameters, engine=job.engine)
    except SitlError as error:
        return {"name": job.name, "error": str(error)}
    (job.out / JOB).write_text(job.inputs, encoding="utf-8")
    return result


def _stored(job: Job, resume: bool) -> Summary | None:
    """Return the summary of a flight that was flown; clear what is left of one that was not."""
    if not job.out.exists():
        return None
    if not resume:
        raise RunError(f"{job.out}: exists; choose another --out, --resume, or --force to replace it")
    try:
        inputs = (job.out / JOB).read_text(encoding="utf-8")
        summary = json.loads((job.out / SUMMARY).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        clear(job.out)
        return None
    if inputs != job.inputs:
        raise RunError(f"{job.out}: was flown with other inputs; choose another --out")
    return summary


def clear(folder: Path) -> None:
    """Remove the folder of a flight; anything else is a RunError."""
    if not folder.exists():
        return
    if not (folder / "parameters.parm").is_file():
        raise RunError(f"{folder}: is no flight of an autopilot; not replaced")
    shutil.rmtree(folder)


def write_lost(jobs: Sequence[Job], summaries: Sequence[Summary], out: Path) -> list[Path]:
    """Write the scenario of each lost flight, with the parameters that files gave, to be flown again.

    They are in the folder ``lost``; the first line of a scenario is the command.
    """
    written: list[Path] = []
    for job, summary in zip(jobs, summaries, strict=True):
        if summary.get("survived", True):
            continue
        folder = out / "lost"
        folder.mkdir(exist_ok=True)
        file = folder / f"{job.name}.yaml"
        options = f"--autopilot {job.autopilot} --binary {job.binary} --scheme {job.scheme}"
        if job.parameters:
            given = file.with_suffix(".parm")
            given.write_text(parameter_file(job.parameters), encoding="ascii")
            options += f" --parameters {given.name}"
        file.write_text(f"# quadftc sitl {file.name} {options}\n{job.text}", encoding="utf-8")
        written.append(file)
    return written
