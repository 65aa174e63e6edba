"""The process of the page: ``python -m quadftc_cli.live_page.server CHANNEL LISTENER FLOWN [open]``.

The first two are open file descriptors: the socket from which frames of the flight come, and the one that
browsers connect to. The third is in JSON a list of vehicles, the fields of `Flown` of each. When it serves,
the page says its address with the token on the socket, and opens a browser if that is asked for. It ends when
the socket is closed.
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
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from functools import partial
from pathlib import Path

import uvicorn
from fastapi import FastAPI

from quadftc_cli.live_page.commander import Commander
from quadftc_cli.live_page.feed import Flown, receive
from quadftc_cli.live_page.page import Vehicle, add_page
from quadftc_cli.live_page.picture import Picture
from quadftc_cli.live_page.player import Player, read_recorded
from quadftc_cli.screen import say
from quadftc_model.vehicle import load_vehicle
from quadftc_report.serve.access import OwnerOnly
from quadftc_report.serve.connections import server_of
from quadftc_report.serve.local import address_of, browser_at, listen, private_files

OUTPUTS = Path("results")
NICE = 5  # of the page, and of a browser that it opens
LAST_WORDS = 0.5  # s; for the page to say that the flight has ended


Source = Callable[[str], AbstractAsyncContextManager[None]]  # feeds a picture meanwhile; takes the address


def picture_of(flown: Flown, *others: Flown) -> Picture:
    """Return an empty picture of a flight, beside others."""
    picture = Picture(load_vehicle(flown.vehicle), flown.plant)
    picture.namespace = flown.namespace
    picture.namespaces = frozenset(each.namespace for each in (flown, *others))
    return picture


@asynccontextmanager
async def following(
    channel: socket.socket, pictures: Sequence[Picture], server: list[uvicorn.Server], address: str
) -> AsyncGenerator[None]:
    """Take what comes on the socket of flights; at their end stop the server."""

    def take() -> None:
        frame = receive(channel)
        if frame is not None:
            pictures[frame.vehicle].take(frame)
            return
        for picture in pictures:
            picture.over = True
        logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)  # requests that are cut off now
        loop = asyncio.get_running_loop()
        loop.remove_reader(channel)
        loop.call_later(LAST_WORDS, stop)

    def stop() -> None:
        server[0].should_exit = True

    asyncio.get_running_loop().add_reader(channel, take)
    with contextlib.suppress(OSError):  # the flight is over already, as `take` will find
        channel.send(address.encode())
    yield


@asynccontextmanager
async def playing(player: Player, address: str) -> AsyncGenerator[None]:
    """Play a recorded flight."""
    say(f"page:   {address}", stderr=True)
    task = asyncio.create_task(player.run())
    yield
    task.cancel()


def make_app(vehicles: Sequence[Vehicle], listener: socket.socket, source: Source, opens: bool) -> FastAPI:
    """Build the application of a page, whose pictures are fed by a source."""
    token = secrets.token_urlsafe()

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncGenerator[None]:
        address = address_of(listener, token)
        browser = browser_at(address, OUTPUTS) if opens else contextlib.nullcontext()
        async with source(address):
            with browser:
                try:
                    yield
                except asyncio.CancelledError:  # a second Ctrl-C: uvicorn has nothing to add
                    logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)
                    raise
        for vehicle in vehicles:
            vehicle.commander.close()

    app = FastAPI(title="quadftc live", lifespan=lifespan, docs_url=None, redoc_url=None, openapi_url=None)
    add_page(app, vehicles)
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
    every = [Flown(*each) for each in json.loads(flown)]
    vehicles = [Vehicle(picture_of(each, *every), Commander(each.namespace), each) for each in every]
    source = partial(following, flight, [each.picture for each in vehicles], server)
    serve(make_app(vehicles, browsers, source, "open" in options), browsers, server)


def show_recorded(bag: Path, speed: float, namespace: str, port: int, opens: bool) -> None:
    """Serve the page of a recorded flight until Ctrl-C; a ValueError says what is wrong with it."""
    recorded = read_recorded(bag, namespace)
    every = [each.flown for each in recorded]
    pictures = [picture_of(flown, *every) for flown in every]
    player = Player(recorded, pictures, speed)
    vehicles = [
        Vehicle(picture, Commander(""), each.flown, player, each.events)
        for picture, each in zip(pictures, recorded, strict=True)
    ]
    said = dict.fromkeys(line for each in recorded for line in (_heading(each.flown), *each.warnings))
    with private_files(), listen(port) as listener, contextlib.suppress(KeyboardInterrupt):
        say(*said, stderr=True)
        serve(make_app(vehicles, listener, partial(playing, player), opens), listener, [])


def _heading(flown: Flown) -> str:
    return f"{f'{flown.namespace}: ' if flown.namespace else ''}{flown.title}: {flown.parts}"


def serve(app: FastAPI, listener: socket.socket, server: list[uvicorn.Server]) -> None:
    """Serve an application; ``server`` gets what serves it."""
    server.append(server_of(app, timeout_graceful_shutdown=1))
    server[0].run(sockets=[listener])


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:])
