"""Pages under attack: script in what a log says, seen by a browser; connections that ask for nothing."""

from __future__ import annotations

import contextlib
import os
import re
import resource
import socket
import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest
from browser import start_browser
from sampling import sampled

from attack.flight_table import hover
from attack.logs import blackbox, dataflash, mcap, ulog
from quadftc_replay.inspection.diagnosis import DiagnosisOptions, diagnose_log
from quadftc_report.verdict_page import write_page

IMAGE = '<img src=x onerror=document.title="owned">'
SCRIPT = '</script><script>document.title="owned"</script>'
LOGS = {
    "ArduPilot": lambda: dataflash(hover(), IMAGE),
    "PX4": lambda: ulog(hover(), IMAGE + SCRIPT),
    "bag": lambda: mcap(hover(), {"/imu/data": f"/{IMAGE}{SCRIPT}/imu/data"}),
    "blackbox": lambda: blackbox(hover(), {"Firmware revision": f"Betaflight 4.5.1 {IMAGE}{SCRIPT}"}),
}
STRANGERS = 1200  # more than the files that a process usually may have
RUN = "import sys; from pathlib import Path; from quadftc_report.serve.app import serve; "
RUN += "serve(Path(sys.argv[1]), 0, 1, 1 << 20, opens=False)"
OWNED = "return document.title === 'owned' || document.querySelector('img[src=x]') !== null"


@pytest.fixture(scope="module")
def browser():
    with start_browser("SCRIPT IN THE STRINGS OF LOGS") as started:
        yield started


@pytest.mark.parametrize("name", sampled(LOGS, every=2))
def test_script_in_what_a_log_says_is_text_in_a_browser(name, tmp_path, browser):
    path = tmp_path / IMAGE.replace("/", "_")
    path.write_bytes(LOGS[name]())
    write_page(diagnose_log(path, DiagnosisOptions()), tmp_path)
    browser.get((tmp_path / "report.html").as_uri())
    assert "onerror" in browser.execute_script("return document.body.innerText"), "the text has to be there"
    assert not browser.execute_script(OWNED)


@contextlib.contextmanager
def serving(folder: Path):
    """Start ``quadftc serve``; yields its address without the token, and the token."""
    with subprocess.Popen([sys.executable, "-c", RUN, folder], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        base, token = re.findall(r"(http\S+)/\?token=(\S+)$", process.stdout.readline())[0]
        yield base, token
        process.terminate()


@pytest.mark.thorough
def test_owner_is_served_beside_strangers_who_send_nothing_or_slowly(tmp_path):
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < 2 * STRANGERS:
        pytest.skip("this system allows too few connections to try")
    resource.setrlimit(resource.RLIMIT_NOFILE, (2 * STRANGERS, hard))
    try:
        with serving(tmp_path / "served") as (base, token), contextlib.ExitStack() as strangers:
            host, port = base.removeprefix("http://").split(":")
            sockets = [
                strangers.enter_context(socket.create_connection((host, int(port)), 20.0))
                for _ in range(STRANGERS)
            ]
            begun = time.monotonic()
            for k, each in enumerate(sockets):
                if k % 2:
                    each.sendall(b"POST /logs HTTP/1.1\r\nHost: ")
            who = {"Authorization": f"Bearer {token}"}
            assert httpx.get(base, headers=who, timeout=20.0).status_code == 200
            with httpx.Client(base_url=base, headers=who, timeout=20.0) as client:
                assert {client.post("/logs", content=b"log").status_code for _ in range(20)} == {200}
            assert time.monotonic() - begun < 20.0
            for each in sockets:  # every one of them is sent away
                each.settimeout(30.0)
                with contextlib.suppress(ConnectionResetError):
                    assert each.recv(1) == b""
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_link_in_the_folder_of_results_is_not_followed(tmp_path):
    secret, out = tmp_path / "secret", tmp_path / "out"
    out.mkdir()
    log = tmp_path / "log.ulg"
    log.write_bytes(ulog(hover()))
    for name in ("verdict.json", "report.html"):
        secret.write_text("secret")
        (out / name).symlink_to(secret)
    command = [sys.executable, "-m", "quadftc_cli.main", "diagnose", log, "--out", out]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ)
    assert done.returncode in (0, 1, 4), done.stderr
    assert secret.read_text() == "secret"
    assert not any(path.is_symlink() for path in out.iterdir())
