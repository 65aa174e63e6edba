"""The process of the page: ``python -m quadftc_cli.live_page.server CHANNEL LISTENER FLOWN [ADDRESS]``.

The first two are open file descriptors: the socket from which frames of the flight come, and the one that
browsers connect to. The third is a JSON object, the fields of `page.Flown`. The page says "ready" on the
socket when it serves, opens a browser at the address, if there is one, and ends when the socket is closed.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import socket
import sys
import threading
import webbrowser
from collections.abc import AsyncGenerator
from pathlib import Path

import uvicorn
from fastapi import FastAPI

from quadftc_cli.live_page.commander import Commander
from quadftc_cli.live_page.feed import receive
from quadftc_cli.live_page.page import Flown, add_page
from quadftc_cli.live_page.picture import Picture
from quadftc_model.vehicle import load_vehicle
from quadftc_report.serve.local import OwnPagesOnly

READY = b"ready"
NICE = 5  # of the page, and of a browser that it opens
LAST_WORDS = 0.5  # s; for the page to say that the flight has ended


def make_app(
    channel: socket.socket, flown: Flown, server: list[uvicorn.Server], address: str = ""
) -> FastAPI:
    """Build the application on the socket from which the flight comes; at its end it stops the server."""
    vehicle = load_vehicle(flown.vehicle)
    picture = Picture(vehicle, "free_flight" if flown.plant == "free_flight" else "test_stand")
    commander = Commander(flown.namespace)

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
        channel.send(READY)
        if address:
            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()  # may not return
        yield
        commander.close()

    app = FastAPI(title="quadftc live", lifespan=lifespan, docs_url=None, redoc_url=None, openapi_url=None)
    add_page(app, picture, commander, flown)
    app.add_middleware(OwnPagesOnly)
    return app


def give_way() -> None:
    """Let the flight go first, also before a browser that this process opens.

    Where Linux groups processes by session, niceness counts only in a session: the group has one of its own.
    """
    os.nice(NICE)
    with contextlib.suppress(OSError):
        Path("/proc/self/autogroup").write_text(str(NICE), encoding="ascii")


def main(channel: int, listener: int, flown: str, address: str = "") -> None:
    """Serve until the flight is over."""
    give_way()
    server: list[uvicorn.Server] = []
    app = make_app(socket.socket(fileno=channel), Flown(**json.loads(flown)), server, address)
    config = uvicorn.Config(
        app, log_level="warning", access_log=False, server_header=False, timeout_graceful_shutdown=1
    )
    server.append(uvicorn.Server(config))
    server[0].run(sockets=[socket.socket(fileno=listener)])


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:])
