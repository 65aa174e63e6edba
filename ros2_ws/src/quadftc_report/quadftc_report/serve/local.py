"""What makes a web page of this machine only: where it listens, and whom it answers.

A request must name the host as 127.0.0.1 or localhost; else a page of another site could reach it by a name
that it lets point here. It must come from a page of its own, if it says where from.
"""

from __future__ import annotations

import socket
from urllib.parse import urlsplit

from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

HOSTS = ("127.0.0.1", "localhost")


def listen(port: int) -> socket.socket:
    """Listen on a port of 127.0.0.1, 0: any that is free; a ValueError says that it is taken."""
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOSTS[0], port))
        listener.listen()
    except (OSError, OverflowError) as error:
        listener.close()
        reason = getattr(error, "strerror", None) or error
        raise ValueError(f"--port {port}: {reason}") from None
    return listener


def address_of(listener: socket.socket) -> str:
    """Return the address of the page for a browser."""
    return f"http://{HOSTS[0]}:{listener.getsockname()[1]}"


class OwnPagesOnly:
    """Refuses requests and websockets to another host name, or from another site's page."""

    def __init__(self, app: ASGIApp, hosts: tuple[str, ...] = HOSTS) -> None:
        self.app, self.hosts = app, hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or answer 403."""
        if scope["type"] in ("http", "websocket") and not self._is_own(scope):
            if scope["type"] == "websocket":
                await send({"type": "websocket.close", "code": 1008})
                return
            await PlainTextResponse("only pages of this server may ask", 403)(scope, receive, send)
            return
        await self.app(scope, receive, send)

    def _is_own(self, scope: Scope) -> bool:
        headers: dict[bytes, str] = {name: value.decode("latin-1") for name, value in scope["headers"]}
        host = headers.get(b"host", "")
        origin = headers.get(b"origin")
        if urlsplit(f"//{host}").hostname not in self.hosts:
            return False
        return origin is None or urlsplit(origin).netloc == host
