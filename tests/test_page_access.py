"""Attacks on the pages of serve and live, by HTTP alone: whoever did not start them gets nothing."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import httpx
import pytest

from quadftc_cli.live_page.feed import Flown
from quadftc_cli.live_page.flying import serving
from quadftc_report.serve.jobs import Jobs

RUN = "import sys; from pathlib import Path; from quadftc_cli.commands.serve import serve; "
RUN += "serve(Path(sys.argv[1]), int(sys.argv[2]), 2, 1, True)"
FLOWN = Flown("", "", "qball_x4", "test_stand")
BROWSER = """#!/bin/sh
file=$(echo "$1" | sed s,^file://,,)
{ echo "$@"; stat -c %a "$file"; cat "$file"; } > browser.new
mv browser.new browser.out
"""
MEBIBYTE = 1 << 20
KEY = "20200101T000000-0123abc{}"
PATIENCE = 60.0  # s


class Page(NamedTuple):
    """A page that is served under umask 000, and what an attacker may know of it."""

    base: str
    token: str
    earlier: str  # token of the start before
    process: int
    home: Path  # where it was started

    def ask(self, path: str = "/", method: str = "GET", **headers: str) -> httpx.Response:
        """Ask without a token, unless the headers have it; `_` stands for a hyphen."""
        named = {name.replace("_", "-"): value.encode() for name, value in headers.items()}
        with httpx.Client(verify=False, timeout=PATIENCE) as client:  # no certificates to load
            return client.request(method, self.base + path, headers=named)

    @property
    def is_serve(self) -> bool:
        return (self.home / "served").exists()

    @property
    def cookie(self) -> str:
        return f"quadftc-{self.base.rpartition(':')[2]}={self.token}"

    def memory(self) -> int:
        """Resident memory [bytes]."""
        pages = Path(f"/proc/{self.process}/statm").read_text().split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE")


@contextlib.contextmanager
def serve(home: Path, port: int) -> Iterator[tuple[str, int]]:
    """Start ``quadftc serve``; yields its address and its process."""
    command = [sys.executable, "-c", RUN, home / "served", str(port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=home, umask=0) as process:
        assert process.stdout is not None
        yield process.stdout.readline().split()[-1], process.pid
        process.terminate()


@contextlib.contextmanager
def live(home: Path, port: int) -> Iterator[tuple[str, int]]:
    """Start the page of ``quadftc live``, to which no flight sends anything."""
    children = Path(f"/proc/self/task/{os.getpid()}/children")
    before = set(children.read_text().split())
    with serving(port, [FLOWN], True) as (_, address, _stop):
        (process,) = set(children.read_text().split()) - before
        yield address, int(process)


@pytest.fixture(scope="module", params=[serve, live])
def page(request, tmp_path_factory) -> Iterator[Page]:
    home = tmp_path_factory.mktemp("home")
    browser = home / "browser"
    browser.write_text(BROWSER)
    browser.chmod(0o755)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(home)
        patch.setenv("BROWSER", "true")
        with request.param(home, 0) as (address, _):
            port, earlier = int(address.split(":")[2].split("/")[0]), address.partition("=")[2]
        assert list(home.rglob("open-*")) == [], "a token is left behind"
        patch.setenv("BROWSER", f"{browser} %s")
        if (home / "served").exists():
            plant_links(home / "served")
        with request.param(home, port) as (address, process):
            base, _, token = address.partition("/?token=")
            yield Page(base, token, earlier, process, home)


def plant_links(folder: Path) -> None:
    """Leave links out of the folder, as another user could have while it was everybody's."""
    folder.chmod(0o777)
    (folder / "secret").write_text("secret")
    job = {"name": "planted.ulg", "received": "2020-01-01T00:00:00Z", "state": "done"}
    for digit, name in ((1, "verdict.json"), (2, "job.json.new"), (3, "")):
        path = folder / KEY.format(digit)
        path.mkdir()
        (path / "job.json").write_text(json.dumps({**job, "id": path.name}))
        if name:
            (path / name).symlink_to(folder / "secret")
    (folder / KEY.format(4)).symlink_to(folder / KEY.format(3))


of_serve = pytest.mark.parametrize("page", [serve], indirect=True)  # live takes no uploads


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "evil.example"}, 403),
        ({"Host": "127.0.0.1.evil.example"}, 403),
        ({"Host": "localhost@evil.example"}, 403),
        ({"Host": ""}, 403),
        ({"Host": "[::1"}, 400),
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "http://127.0.0.1:1"}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": ""}, 403),
        ({"Origin": "http://[::1"}, 400),
        ({"Sec-Fetch-Site": "cross-site"}, 403),
        ({"Sec-Fetch-Site": "same-site"}, 403),
    ],
)
def test_pages_of_others_are_refused_even_with_the_cookie(page, headers, status):
    answer = page.ask(Cookie=page.cookie, **headers)
    assert (answer.status_code, answer.text.count("\n"), len(answer.text) < 100) == (status, 0, True)


def wrong_tokens(page: Page) -> tuple[str, ...]:
    token = page.token
    return (page.earlier, token[:-1], f"{token}x", token.swapcase(), "\xe9", "%00", "%ff", "a=b")


def test_no_token_or_a_wrong_one_opens_nothing(page):
    assert page.earlier != page.token
    name = page.cookie.partition("=")[0]
    for path in (
        "/",
        "/logs/x/verdict.json",
        "/list",
        "/_nicegui/x",
        "/_nicegui_ws/socket.io/?EIO=4",
        "/nothing",
    ):
        assert page.ask(path).status_code == 401, path
    for told in wrong_tokens(page):
        assert page.ask(Authorization=f"Bearer {told}").status_code == 401
        assert page.ask(Cookie=f"{name}={told}").status_code == 401
        assert page.ask(f"/?token={told}").status_code == 401
    assert page.ask("/logs", "POST").status_code == 401
    assert page.ask(Cookie=f"quadftc={page.token}").status_code == 401, "that of another port"


def test_address_that_was_printed_is_exchanged_for_a_cookie(page):
    entered = page.ask(f"/?token={page.token}", Sec_Fetch_Site="cross-site")  # from a file, as a browser says
    assert entered.headers["Set-Cookie"] == f"{page.cookie}; HttpOnly; Path=/; SameSite=strict"
    assert 'content="0; url=/"' in entered.text
    assert page.token not in entered.text
    for allowed in ({"Cookie": page.cookie}, {"Authorization": f"Bearer {page.token}"}):
        answer = page.ask(**allowed, Sec_Fetch_Site="same-origin")
        assert answer.status_code == 200
        assert "quadftc" in answer.text
        assert page.token not in answer.text
    assert page.ask(f"/nothing?token={page.token}").status_code == 404


def test_websockets_need_the_cookie(page):
    def upgrade(**headers: str) -> int:
        path = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
        key = {"Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==", "Sec-WebSocket-Version": "13"}
        return page.ask(path, Connection="Upgrade", Upgrade="websocket", **key, **headers).status_code

    assert upgrade() == 403
    assert upgrade(Cookie=page.cookie, Origin="http://evil.example") == 403
    assert upgrade(Cookie=page.cookie, Origin=page.base) == (403 if page.is_serve else 101)  # serve has none


def test_browser_gets_the_token_by_a_file_of_the_user(page):
    told = page.home / "browser.out"
    deadline = time.monotonic() + PATIENCE
    while not told.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    arguments, mode, content = told.read_text().split("\n", 2)
    assert page.token not in arguments
    assert mode == "600"
    assert f'url={page.base}/?token={page.token}"' in content
    assert page.token not in Path(f"/proc/{page.process}/cmdline").read_text()


def test_thousand_requests_of_another_site_cost_no_memory(page):
    with httpx.Client(base_url=page.base, headers={"Sec-Fetch-Site": "cross-site"}) as client:
        before = page.memory()
        for k in range(1000):
            answer = client.post("/logs", content=b"log") if k % 2 else client.get("/")
            assert answer.status_code == 403
        assert page.memory() - before < 16 * MEBIBYTE


def test_large_body_of_a_stranger_is_not_kept(page):
    before = page.memory()
    host, port = page.base.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), PATIENCE) as stranger:
        stranger.sendall(f"POST /logs HTTP/1.1\r\nHost: {host}\r\nContent-Length: {1 << 40}\r\n\r\n".encode())
        assert stranger.recv(64).startswith(b"HTTP/1.1 401")
        stranger.settimeout(0.5)
        with contextlib.suppress(OSError):  # closed, or not read further
            stranger.sendall(bytes(64 * MEBIBYTE))
    assert page.memory() - before < 16 * MEBIBYTE


@of_serve
def test_uploads_are_bounded_and_lead_nowhere(page):
    who = {"Authorization": f"Bearer {page.token}"}
    folder, before = page.home / "served", sorted((page.home / "served").iterdir())
    large = bytes(MEBIBYTE + 1)
    assert httpx.post(f"{page.base}/logs", content=large, headers=who).status_code == 413
    blocks = (large[:4096] for _ in range(257))  # length not told
    assert httpx.post(f"{page.base}/logs", content=blocks, headers=who).status_code == 413
    assert sorted(folder.iterdir()) == before
    for path in (
        "../../../../etc/passwd",
        "..%2f..%2fsecret",
        "%2e%2e/secret",
        "/etc/passwd",
        "x/../../secret",
    ):
        with socket.create_connection(("127.0.0.1", int(page.base.rpartition(":")[2])), PATIENCE) as raw:
            head = f"GET /logs/{path} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {page.token}\r\n"
            raw.sendall(f"{head}Connection: close\r\n\r\n".encode())
            assert raw.recv(4096).startswith(b"HTTP/1.1 404"), path


@of_serve
def test_links_in_the_folder_are_not_followed(page):
    who = {"Authorization": f"Bearer {page.token}"}
    listed = httpx.get(f"{page.base}/list", headers=who).text
    assert [digit for digit in "1234" if KEY.format(digit) in listed] == ["3"]
    planted = page.home / "served" / KEY.format(3) / "verdict.json"
    planted.symlink_to(page.home / "served/secret")
    for digit in "1234":
        path = f"{page.base}/logs/{KEY.format(digit)}/verdict.json"
        assert httpx.get(path, headers=who).status_code == 404
    planted.unlink()


@of_serve
def test_what_is_written_is_the_users_alone(page):
    who = {"Authorization": f"Bearer {page.token}"}
    table = b"".join(b"%d,0\n" % k for k in range(100))
    key = httpx.post(f"{page.base}/logs", content=table, headers=who).json()["id"]
    job = page.home / "served" / key
    mapping = {"mapping": "[time]"}
    deadline = time.monotonic() + PATIENCE
    while json.loads((job / "job.json").read_text())["state"] != "failed" and time.monotonic() < deadline:
        time.sleep(0.05)
    httpx.post(f"{page.base}/logs/{key}/choice", json=mapping, headers=who)
    while not (job / "mapping.toml").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    written = {job.parent, job, *job.rglob("*"), *job.parent.glob("open-*")}
    assert {path.name for path in written} >= {"served", "in", "log", "job.json", "mapping.toml"}
    assert {path.name for path in written if stat.S_IMODE(path.stat().st_mode) & 0o077} == set()


def test_folder_of_another_user_is_refused(tmp_path, monkeypatch):
    owner = tmp_path.stat().st_uid
    monkeypatch.setattr(os, "geteuid", lambda: owner + 1)
    with pytest.raises(ValueError, match="belongs to another user"):
        Jobs(tmp_path)
