"""What makes a web page the user's alone: where it listens, how a browser gets there, who reads its files."""

from __future__ import annotations

import contextlib
import os
import socket
import tempfile
import threading
import webbrowser
from collections.abc import Generator
from pathlib import Path

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


def address_of(listener: socket.socket, token: str = "") -> str:
    """Return the address of the page for a browser, with the token that lets it in."""
    base = f"http://{HOSTS[0]}:{listener.getsockname()[1]}"
    return f"{base}/?token={token}" if token else base


@contextlib.contextmanager
def browser_at(address: str, folder: Path) -> Generator[None]:
    """Have a browser open an address that other users may not see in its command line.

    The browser opens a file of the user's alone, which leads on and is removed at the end. It lies in a
    folder that browsers in a sandbox of their own (snap) can read, or else among temporary files.
    """
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    place = folder if os.access(folder, os.W_OK) else None
    with tempfile.NamedTemporaryFile("w", prefix="open-", suffix=".html", dir=place) as file:  # mode 0600
        file.write(f'<!doctype html><meta http-equiv="refresh" content="0; url={address}">\n')
        file.flush()
        uri = Path(file.name).resolve().as_uri()
        threading.Thread(target=webbrowser.open, args=(uri,), daemon=True).start()  # may not return
        yield


@contextlib.contextmanager
def private_files() -> Generator[None]:
    """Make what this process and its children write meanwhile the user's alone: 0700 and 0600."""
    before = os.umask(0o077)
    try:
        yield
    finally:
        os.umask(before)


def make_private(folder: Path) -> None:
    """Make a folder the user's alone; a ValueError says that it is another user's."""
    folder.mkdir(parents=True, exist_ok=True)
    if folder.stat().st_uid != os.geteuid():
        raise ValueError(f"{folder}: belongs to another user; expected a folder of your own")
    folder.chmod(0o700)
