"""The start of a node's executable: a signal to end counts from the first moment, not from the first spin.

It takes a second to import a node with its laws and messages. Ctrl-C in this time would be a traceback.
"""

from __future__ import annotations

import importlib
import os
import signal
from collections.abc import Callable

STOPPING = (signal.SIGINT, signal.SIGTERM)


def executable(module: str) -> Callable[[], int]:
    """Return the entry point of a node whose ``main`` is in a module; it imports the module when called.

    Until then SIGINT and SIGTERM end the process at once, with exit code 0: there is nothing to tidy up yet.
    """

    def main() -> int:
        for number in STOPPING:
            signal.signal(number, lambda *_: os._exit(0))
        return importlib.import_module(module).main()

    return main
