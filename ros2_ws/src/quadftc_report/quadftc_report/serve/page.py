# pyright: basic
"""The page: the whole of it takes logs, a card shows each, and its forms do what the command's options do."""

from __future__ import annotations

import re
import secrets
from typing import NamedTuple

from fastapi import FastAPI, Request
from fastapi.responses import HTMLResponse, Response

from quadftc_report.page import render_template
from quadftc_report.serve.job import STAGES
from quadftc_report.serve.jobs import PICTURE, REPORT, VERDICT, Choice, Job, Jobs

FORMATS = (
    "ROS 1 and ROS 2 bags, PX4 ULog, ArduPilot .BIN and .log, MAVLink .tlog, Betaflight and INAV blackbox,"
    " Crazyflie uSD, tables (CSV); as they are, or in a ZIP, gzip or Zstandard file"
)
NO_FRAMES = {"Content-Security-Policy": "frame-ancestors 'none'", "Cache-Control": "no-store"}
ASKS = re.compile(r"; choose one with --(log|system): (.*)")
ASKS_MAPPING = "--mapping FILE"
OPTIONS = ("log", "system", "mapping")
CHOICES = re.compile(r", (?=\d+ )")
MAPPING = """[time]
column = "time"
unit = "s"

[[signal]]
quantity = "gyro"
columns = ["gyro_x", "gyro_y", "gyro_z"]
unit = "rad/s"
"""  # to begin with


class Question(NamedTuple):
    """What a card asks, and what it was told so far."""

    text: str  # of the reader
    fields: tuple[str, ...]  # options that are typed
    option: str = ""  # one that is chosen
    choices: tuple[tuple[str, str], ...] = ()  # its values, with what the reader says of each
    is_open: bool = False  # nothing can be judged before it is answered


def question_of(job: Job) -> Question:
    """Return what the reader of a log wants to know, by what it said."""
    told = tuple(each for each in OPTIONS if getattr(job, each))
    if match := ASKS.search(job.message):
        option, values = match.groups()
        choices = tuple((each.split()[0], each) for each in CHOICES.split(values))
        fields = tuple(each for each in told if each != option or values.endswith("more"))
        return Question(job.message[: match.start()], fields, option, choices, True)
    if ASKS_MAPPING in job.message:
        text = job.message.partition("; expected")[0].replace(ASKS_MAPPING, "a mapping")
        return Question(text, tuple(dict.fromkeys((*told, "mapping"))), is_open=True)
    return Question(job.message, told, is_open=bool(told) and job.state == "failed")


def render_list(jobs: Jobs) -> str:
    """Return the cards of all logs."""
    return render_template(
        "serve_list.html",
        jobs=jobs,
        cards=[(job, question_of(job)) for job in jobs.all()],
        stages=STAGES,
        mapping=MAPPING,
        report=REPORT,
        verdict=VERDICT,
        picture=PICTURE,
    )


def add_page(app: FastAPI, jobs: Jobs) -> None:
    """Add the page and what its buttons ask for to an application."""
    run = secrets.token_hex(4)

    @app.get("/")
    async def page() -> HTMLResponse:
        text = render_template("serve.html", jobs=jobs, formats=FORMATS, cards=render_list(jobs))
        return HTMLResponse(text, headers=NO_FRAMES)

    @app.get("/list")
    async def listing(request: Request) -> Response:
        """Return the cards, or 304 if nothing has changed."""
        tag = f'"{run}-{jobs.version}"'
        if request.headers.get("if-none-match") == tag:
            return Response(status_code=304)
        return HTMLResponse(render_list(jobs), headers={**NO_FRAMES, "ETag": tag})

    @app.post("/logs/{key}/choice", status_code=204)
    async def choose(key: str, choice: Choice) -> None:
        jobs.choose(key, choice)

    @app.post("/logs/{key}/again", status_code=204)
    async def again(key: str) -> None:
        jobs.judge_again(key)

    @app.post("/logs/{key}/remove", status_code=204)
    async def remove(key: str) -> None:
        await jobs.remove(key)
