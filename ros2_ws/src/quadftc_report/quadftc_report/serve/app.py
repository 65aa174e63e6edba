# pyright: basic
"""The web application: takes logs, hands out verdicts, and answers nobody but who started it.

It is meant for one user (`quadftc_report.serve.access`). Reports may not load anything and may not talk to
anybody.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import secrets
from collections.abc import AsyncIterator
from contextlib import AbstractContextManager
from pathlib import Path
from urllib.parse import unquote

from fastapi import FastAPI, HTTPException, Request
from fastapi.responses import FileResponse, JSONResponse

from quadftc_report.serve.access import OwnerOnly
from quadftc_report.serve.jobs import RESULTS, Jobs, TooLargeError
from quadftc_report.serve.local import address_of, browser_at, listen, private_files
from quadftc_report.serve.page import add_page

SEALED = {
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline';"
    " img-src data: blob:; font-src data:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",  # a log can be judged again
}


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
