# pyright: basic
"""The ``quadftc`` command.

Exit codes: 0 good, 1 a check of a scenario or a condition of the theory failed, 2 bad input, 3 graph,
recording or software failed, 130 interrupted.
"""

from __future__ import annotations

import errno
import os
import sys
import traceback
from importlib.metadata import entry_points
from typing import Any

import typer
from typer.core import TyperGroup

# this machine only, unless asked otherwise; read when ROS starts, so before any of its modules
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

from quadftc_campaign.errors import CampaignError
from quadftc_cli.commands import BAD_INPUT, GOOD, INTERNAL, INTERRUPTED
from quadftc_cli.screen import say
from quadftc_flight.graph.plan import GraphError
from quadftc_flight.runs import RunError

MAX_LINES, MAX_LINE = 11, 1200  # of what is said about a bad input; characters
PATHS_FAULT = (
    *(errno.ENOENT, errno.EACCES, errno.EPERM, errno.EEXIST, errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG),
    *(errno.ELOOP, errno.EROFS, errno.EINVAL),
)  # errors of the system that say that a path was bad input

SUBCOMMANDS = "quadftc.commands"  # entry points: functions, or a typer.Typer with commands of its own


class Subcommands(TyperGroup):
    """The subcommands of all installed packages; only the one that is called is imported."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return their names."""
        return sorted({entry.name for entry in entry_points(group=SUBCOMMANDS)})

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return one by its name, None if there is none."""
        for entry in entry_points(group=SUBCOMMANDS, name=cmd_name):
            found = entry.load()
            if not isinstance(found, typer.Typer):
                function, found = found, typer.Typer(**PLAIN)
                found.command(cmd_name)(function)
            command = typer.main.get_command(found)
            command.name = cmd_name
            return command
        return None


PLAIN: dict[str, Any] = {"add_completion": False, "rich_markup_mode": None}
app = typer.Typer(cls=Subcommands, no_args_is_help=True, pretty_exceptions_enable=False, **PLAIN)


@app.callback()
def _root() -> None:
    """Fault-tolerant attitude control for multirotors: fly scenarios, record, judge."""


def main() -> None:
    """Run the command; turn every error into a line and an exit code."""
    sys.exit(guarded(sys.argv[1:]))


def guarded(arguments: list[str], command: typer.Typer = app) -> int:
    """Run a command; turn every error into a line, and return the exit code."""
    try:
        result = command(arguments or ["--help"], standalone_mode=False)
        return result if isinstance(result, int) else GOOD
    except typer.TyperException as error:
        return _refuse(error.format_message() if hasattr(error, "format_message") else str(error))
    except (CampaignError, RunError, ValueError) as error:
        return _refuse(str(error))
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED
    except GraphError as error:
        say(f"error: {error}", stderr=True)
        return INTERNAL
    except Exception as error:
        if isinstance(error, OSError) and error.errno in PATHS_FAULT:
            return _refuse(f"{error.filename or 'a file'}: {error.strerror}")
        say(_shortened(f"internal error: {type(error).__name__}: {error}"), stderr=True)
        if os.environ.get("QUADFTC_DEBUG"):
            traceback.print_exc()
        else:
            say("set QUADFTC_DEBUG=1 to see where", stderr=True)
        return INTERNAL


def _refuse(words: str) -> int:
    """Say what is wrong with the input, on a line for each problem; return the exit code."""
    lines = words.splitlines() or ["bad input"]
    say(*(_shortened(f"error: {line}") for line in lines[:MAX_LINES]), stderr=True)
    if len(lines) > MAX_LINES:
        say(f"error: and {len(lines) - MAX_LINES} more lines", stderr=True)
    return BAD_INPUT


def _shortened(line: str) -> str:
    """Leave out the middle of what is too long to be read."""
    return line if len(line) <= MAX_LINE else f"{line[: MAX_LINE // 2]} [...] {line[-MAX_LINE // 2 :]}"


if __name__ == "__main__":
    main()
