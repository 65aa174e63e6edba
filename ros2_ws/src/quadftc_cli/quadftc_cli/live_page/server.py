"""The process of the page: ``python -m quadftc_cli.live_page.server CHANNEL LISTENER FLOWN [open]``.

The first two are open file descriptors: the socket from which frames of the flight come, and the one that
browsers connect to. The third is a JSON object, the fields of `page.Flown`. When it serves, the page says its
address with the token on the socket, and opens a browser if that is asked for. It ends when the socket is
closed.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import secrets
import socket
import sys
from collections.abc import AsyncGenerator
from pathlib import Path

import uvicorn
from fastapi import FastAPI

from quadftc_cli.live_page.commander import Commander
from quadftc_cli.live_page.feed import receive
from quadftc_cli.live_page.page import Flown, add_page
from quadftc_cli.live_page.picture import Picture
from quadftc_model.vehicle import load_vehicle
from quadftc_report.serve.access import OwnerOnly
from quadftc_report.serve.connections import ImpatientProtocol, allow_connections
from quadftc_report.serve.local import address_of, browser_at

OUTPUTS = Path("results")
NICE = 5  # of the page, and of a browser that it opens
LAST_WORDS = 0.5  # s; for the page to say that the flight has ended


def make_app(
    channel: socket.socket, listener: socket.socket, flown: Flown, server: list[uvicorn.Server], opens: bool
) -> FastAPI:
    """Build the application on the socket from which the flight comes; at its end it stops the server."""
    vehicle = load_vehicle(flown.vehicle)
    picture = Picture(vehicle, "free_flight" if flown.plant == "free_flight" else "test_stand")
    commander = Commander(flown.namespace)
    token = secrets.token_urlsafe()

    def take() -> None:
        frame = receive(channel)
        if frame is not None:
            picture.take(frame)
            return
        picture.over = True
        logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)  # requests that are cut off now
        loop = asyncio.get_running_loop()
        loop.remove_reader(channel)
        loop.call_later(LAST_WORDS, stop)

    def stop() -> None:
        server[0].should_exit = True

    @contextlib.asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncGenerator[None]:
        loop = asyncio.get_running_loop()
        loop.add_reader(channel, take)
        address = address_of(listener, token)
        with contextlib.suppress(OSError):  # the flight is over already, as `take` will find
            channel.send(address.encode())
        with browser_at(address, OUTPUTS) if opens else contextlib.nullcontext():
            try:
                yield
            except asyncio.CancelledError:  # a second Ctrl-C: uvicorn has nothing to add
                logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)
                raise
        commander.close()

    app = FastAPI(title="quadftc live", lifespan=lifespan, docs_url=None, redoc_url=None, openapi_url=None)
    add_page(app, picture, commander, flown)
    app.add_middleware(OwnerOnly, token=token)
    return app


def give_way() -> None:
    """Let the flight go first, also before a browser that this process opens.

    Where Linux groups processes by session, niceness counts only in a session: the group has one of its own.
    """
    os.nice(NICE)
    with contextlib.suppress(OSError):
        Path("/proc/self/autogroup").write_text(str(NICE), encoding="ascii")


def main(channel: int, listener: int, flown: str, *options: str) -> None:
    """Serve until the flight is over."""
    give_way()
    server: list[uvicorn.Server] = []
    flight, browsers = socket.socket(fileno=channel), socket.socket(fileno=listener)
    app = make_app(flight, browsers, Flown(**json.loads(flown)), server, "open" in options)
    allow_connections()
    config = uvicorn.Config(
        app,
        http=ImpatientProtocol,
        log_level="warning",
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=1,
    )
    server.append(uvicorn.Server(config))
    server[0].run(sockets=[browsers])


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:])
