# pyright: basic
"""The web application: takes logs, hands out verdicts, and refuses whoever is not a page of its own.

It is meant for this machine only (`quadftc_report.serve.local`). Reports may not load anything and may not
talk to anybody.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from urllib.parse import unquote

from fastapi import FastAPI, HTTPException, Request
from fastapi.responses import FileResponse, JSONResponse

from quadftc_report.serve.jobs import RESULTS, Jobs, TooLargeError
from quadftc_report.serve.local import OwnPagesOnly, address_of, listen
from quadftc_report.serve.page import add_page

SEALED = {
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline';"
    " img-src data: blob:; font-src data:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",  # a log can be judged again
}


def make_app(jobs: Jobs) -> FastAPI:
    """Build the application on the jobs of a folder."""

    @contextlib.asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        yield
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
    app.add_middleware(OwnPagesOnly)
    return app


def serve(folder: Path, port: int, at_a_time: int, largest: int, *, opens: bool = True) -> None:
    """Serve on 127.0.0.1 until interrupted; a ValueError says that the port is taken."""
    import uvicorn

    listener = listen(port)
    app = make_app(Jobs(folder, at_a_time, largest))
    address = address_of(listener)
    print(f"serving {folder} on {address}; end with Ctrl-C", flush=True)  # noqa: T201
    if opens:
        import webbrowser

        webbrowser.open(address)
    config = uvicorn.Config(app, log_level="warning", access_log=False, server_header=False)
    with contextlib.suppress(KeyboardInterrupt):
        uvicorn.Server(config).run(sockets=[listener])
