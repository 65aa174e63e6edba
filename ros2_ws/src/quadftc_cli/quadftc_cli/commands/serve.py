"""``quadftc serve``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

MEBIBYTE = 1 << 20


def serve(
    folder: Annotated[Path, Option(metavar="DIR", help="Where logs and verdicts are kept.")] = Path(
        "results", "served"
    ),
    port: Annotated[int, Option(min=0, max=65535, help="Port on 127.0.0.1; 0: any that is free.")] = 8347,
    jobs: Annotated[int, Option(min=1, max=64, help="Logs judged at a time.")] = 2,
    max_size: Annotated[int, Option(min=1, help="Largest log that is taken [MiB].")] = 1024,
    browser: Annotated[bool, Option(help="Open the page in the browser.")] = True,
) -> None:
    """Open a local page to drop flight logs on and read their verdicts; only you can use it."""
    from quadftc_report.serve.app import serve as run

    run(folder, port, jobs, max_size * MEBIBYTE, opens=browser)
