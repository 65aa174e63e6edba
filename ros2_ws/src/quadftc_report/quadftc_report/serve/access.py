"""Who may use a page of this machine: who started it.

A page of any site can have a browser ask 127.0.0.1, and so can every user of the machine. So a request must
name the host as 127.0.0.1 or localhost and must not come from another site's page. And it must bring the
token of this start: as ``Authorization: Bearer TOKEN``, as ``?token=TOKEN``, or in a cookie. A browser gets
the cookie for the address with the token. A page of the server then leads on to ``/``. A redirection
would count as one of the page that held the link; for that the browser keeps a strict cookie back.
"""

from __future__ import annotations

import secrets
from urllib.parse import urlsplit

from starlette.requests import HTTPConnection
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from quadftc_report.serve.local import HOSTS

ENTER = '<!doctype html><title>quadftc</title><meta http-equiv="refresh" content="0; url=/">'
SEALED = {
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
OWN_SITES = ("none", "same-origin")  # Sec-Fetch-Site; none: typed, or opened by another program
BEARER = "Bearer "


class OwnerOnly:
    """Ends requests and websockets of others, before anything is done for them."""

    def __init__(self, app: ASGIApp, token: str) -> None:
        self.app, self.token = app, token.encode()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or end it with 400, 401 or 403 and one line; a websocket with 403."""
        answer: ASGIApp | None = None
        if scope["type"] in ("http", "websocket"):
            answer = self._answer(HTTPConnection(scope))
        if answer is not None and scope["type"] == "websocket":
            answer = WebSocketClose(1008)  # policy violation
        await (answer or self.app)(scope, receive, send)

    def _answer(self, request: HTTPConnection) -> Response | None:
        """Return the answer that ends a request here; None: it may go on."""
        headers, host = request.headers, request.headers.get("host", "")
        try:
            named = urlsplit(f"//{host}").hostname
            asking = urlsplit(headers.get("origin", f"http://{host}")).netloc
        except ValueError:
            return PlainTextResponse("Host or Origin is no address", 400)
        if named not in HOSTS or asking != host:
            return PlainTextResponse("only pages of this server may ask", 403)

        cookie = f"quadftc-{request.scope['server'][1]}"  # cookies of all ports of a host lie together
        has_url = self._is_token(request.query_params.get("token", ""))
        if has_url and request.scope["path"] == "/" and request.scope.get("method") == "GET":
            enter = HTMLResponse(ENTER, headers=SEALED)
            enter.set_cookie(cookie, self.token.decode(), httponly=True, samesite="strict")
            return enter
        if headers.get("sec-fetch-site", "none") not in OWN_SITES:
            return PlainTextResponse("only pages of this server may ask", 403)
        bearer = headers.get("authorization", "").removeprefix(BEARER)
        if has_url or self._is_token(bearer) or self._is_token(request.cookies.get(cookie, "")):
            return None
        words = "open the address that the command printed: it has the token"
        return PlainTextResponse(words, 401, {"WWW-Authenticate": BEARER.strip()})

    def _is_token(self, told: str) -> bool:
        return secrets.compare_digest(told.encode("utf-8", "replace"), self.token)
