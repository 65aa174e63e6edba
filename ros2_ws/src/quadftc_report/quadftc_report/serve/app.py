# pyright: basic
"""The web application: takes logs, hands out verdicts, and answers nobody but who started it.

It is meant for one user (`quadftc_report.serve.access`). Reports may not load anything and may not talk to
anybody. The whole page takes logs, a card shows each, and its forms do what the command's options do.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import secrets
from collections.abc import AsyncIterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote

from fastapi import FastAPI, HTTPException, Request
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse, Response

from quadftc_report.page import render_template
from quadftc_report.serve.access import OwnerOnly
from quadftc_report.serve.job import STAGES
from quadftc_report.serve.jobs import PICTURE, REPORT, RESULTS, VERDICT, Choice, Job, Jobs, TooLargeError
from quadftc_report.serve.local import address_of, browser_at, listen, private_files

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
SEALED = {
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline';"
    " img-src data: blob:; font-src data:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",  # a log can be judged again
}


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


def make_app(jobs: Jobs, token: str, browser: AbstractContextManager[None] | None = None) -> FastAPI:
    """Build the application on the jobs of a folder, for who has the token; ``browser`` while it serves."""

    @contextlib.asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        with browser or contextlib.nullcontext():
            try:
                yield
            except asyncio.CancelledError:  # a second Ctrl-C: uvicorn has nothing to add
                logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)
                raise
        await jobs.close()

    app = FastAPI(title="quadftc serve", lifespan=lifespan, docs_url=None, redoc_url=None, openapi_url=None)

    @app.post("/logs")
    async def receive(request: Request) -> JSONResponse:
        """Store a log; its name is in the header X-Name, percent-encoded."""
        length = request.headers.get("content-length", "0")
        if length.isdigit() and int(length) > jobs.largest:
            raise HTTPException(413, f"larger than {jobs.largest >> 20} MiB")
        try:
            job = await jobs.receive(unquote(request.headers.get("x-name", "")), request.stream())
        except TooLargeError as error:
            raise HTTPException(413, str(error)) from None
        except OSError as error:
            raise HTTPException(507, error.strerror or "cannot be stored") from None
        return JSONResponse({"id": job.id, "name": job.name})

    @app.get("/logs/{key}/{name}")
    async def result(key: str, name: str) -> FileResponse:
        """Hand out what a judgement wrote."""
        path = jobs.result(key, name)
        if path is None:
            raise HTTPException(404)
        return FileResponse(path, media_type=RESULTS[name], headers=SEALED)

    add_page(app, jobs)
    app.add_middleware(OwnerOnly, token=token)
    return app


def serve(folder: Path, port: int, at_a_time: int, largest: int, *, opens: bool = True) -> None:
    """Serve on 127.0.0.1 until interrupted; a ValueError says what is wrong with port or folder."""
    from quadftc_report.serve.connections import server_of

    token = secrets.token_urlsafe()
    with private_files(), listen(port) as listener:
        address = address_of(listener, token)
        browser = browser_at(address, folder) if opens else None
        app = make_app(Jobs(folder, at_a_time, largest), token, browser)
        print(f"page:   {address}\nlogs:   {folder}; Ctrl-C ends it", flush=True)  # noqa: T201
        with contextlib.suppress(KeyboardInterrupt):
            server_of(app).run(sockets=[listener])
