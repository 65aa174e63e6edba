# pyright: basic
"""Connections of a local page: one that asks for nothing ends, so that nobody can use up all there may be.

Whoever is on this machine can connect, and a token is asked for only when a request has come.
"""

from __future__ import annotations

import asyncio
import resource
from typing import Any

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.auto import AutoHTTPProtocol

SILENCE = 10.0  # s, in which a request has to come, and the next one behind an answer
MOST_FILES = 1 << 16  # connections and files at a time, where the system allows so many


class ImpatientProtocol(AutoHTTPProtocol):  # type: ignore[valid-type, misc]
    """HTTP as uvicorn speaks it, but for clients that send no request, or go on behind an answer."""

    cycle: Any  # the request, once its headers are there
    loop: asyncio.AbstractEventLoop

    def connection_made(self, transport: asyncio.Transport) -> None:
        """Begin to wait for a request."""
        super().connection_made(transport)
        self._look_again(transport)

    def _look_again(self, transport: asyncio.Transport) -> None:
        self.loop.call_later(SILENCE, self._end_if_silent, transport)

    def _end_if_silent(self, transport: asyncio.Transport) -> None:
        if transport.is_closing() or transport.get_protocol() is not self:  # a websocket by now
            return
        if self.cycle is None or self.cycle.response_complete:
            transport.abort()
        else:
            self._look_again(transport)


def server_of(app: ASGIApp, **options: Any) -> uvicorn.Server:
    """Return what serves a page of this machine; ``options`` are uvicorn's."""
    allow_connections()
    quiet: dict[str, Any] = {"log_level": "warning", "access_log": False, "server_header": False}
    return uvicorn.Server(uvicorn.Config(app, http=ImpatientProtocol, **quiet, **options))


def allow_connections() -> None:
    """Allow this process as many connections as the system lets it have, up to `MOST_FILES`."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = MOST_FILES if hard == resource.RLIM_INFINITY else min(hard, MOST_FILES)
    if soft != resource.RLIM_INFINITY and soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
