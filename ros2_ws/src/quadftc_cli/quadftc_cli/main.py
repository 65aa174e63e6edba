# pyright: basic
"""The ``quadftc`` command.

Exit codes: 0 good; 1 a check of a scenario or a condition of the theory failed; 2 bad input; 3 graph,
recording or software failed; 130 interrupted.
"""

from __future__ import annotations

import ast
import errno
import functools
import importlib.util
import os
import signal
import sys
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from quadftc_cli import commands
from quadftc_cli.commands import BAD_INPUT, GOOD, INTERNAL, INTERRUPTED
from quadftc_model.versions import software_version
from quadftc_ros.reach import stay_local

stay_local()  # read when ROS starts

# errors by their names, as their modules take long to import: raised by bad input; by a graph
BAD_INPUT_ERRORS = ("quadftc_campaign.errors.CampaignError", "quadftc_flight.run_files.RunError")
GRAPH_ERROR = "quadftc_flight.graph.plan.GraphError"
# what is there with ROS 2 only; and what the extras of the wheel install
ROS = ("rclpy", "ament_index_python", "quadftc_msgs", "builtin_interfaces", "std_msgs", "sensor_msgs", "rcl_")
EXTRAS = {
    "serve": ("fastapi", "nicegui", "starlette", "uvicorn"),
    "batch": ("jax", "optax", "polars"),
    "isolability": ("sympy",),
}
PYDANTIC = "Value error, "  # what pydantic writes before the words of a refused option
MAX_LINES, MAX_LINE = 11, 1200  # of what is said about a bad input; characters
PATHS_FAULT = (
    *(errno.ENOENT, errno.EACCES, errno.EPERM, errno.EEXIST, errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG),
    *(errno.ELOOP, errno.EROFS, errno.EINVAL, errno.ENOSPC, errno.EDQUOT, errno.EFBIG),
)  # errors of the system that say that a path was bad input, or that its disk takes no more

# entry points by which a package adds subcommands: functions, or a typer.Typer with commands of its own
SUBCOMMANDS = "quadftc.commands"
_IN = commands.__name__
OWN_ENTRIES = tuple(EntryPoint(name, f"{_IN}.{place}", SUBCOMMANDS) for name, place in commands.OWN.items())


class Subcommands(TyperGroup):
    """The subcommands of all installed packages; only the one that is called is imported."""

    _called = False

    def list_commands(self, ctx: Any) -> list[str]:
        """Return their names."""
        return sorted({*commands.OWN, *(entry.name for entry in _others())})

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return one by its name, None if there is none; to be listed, only its name and what it does."""
        own = [entry for entry in OWN_ENTRIES if entry.name == cmd_name]
        for entry in own or _others().select(name=cmd_name):
            return _loaded(entry) if self._called else TyperCommand(cmd_name, help=purpose(entry))
        return None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that is called, and import it."""
        self._called = True
        try:
            return super().resolve_command(ctx, args)
        finally:
            self._called = False


@functools.cache
def _others() -> EntryPoints:
    """Return the entry points of other packages' subcommands; to look for them takes a tenth of a second."""
    return entry_points(group=SUBCOMMANDS)


def _loaded(entry: EntryPoint) -> Any:
    """Import a subcommand."""
    found = entry.load()
    if not isinstance(found, typer.Typer):
        function, found = found, typer.Typer(**PLAIN)
        found.command(entry.name)(function)
    command = typer.main.get_command(found)
    command.name = entry.name
    return command


def purpose(entry: EntryPoint) -> str:
    """Return the first sentence that a subcommand says of itself, read from its source: nothing is imported.

    It is the docstring of a function, or ``help`` of a ``typer.Typer(...)``.
    """
    try:
        spec = importlib.util.find_spec(entry.module)
        source = Path(spec.origin or "").read_text(encoding="utf-8") if spec is not None else ""
    except (ImportError, OSError):
        return "(cannot be imported)"
    for statement in ast.parse(source).body:
        if isinstance(statement, ast.FunctionDef) and statement.name == entry.attr:
            return (ast.get_docstring(statement) or "").partition("\n\n")[0]
        if isinstance(statement, ast.Assign) and isinstance(statement.value, ast.Call):
            names = [target.id for target in statement.targets if isinstance(target, ast.Name)]
            for word in statement.value.keywords:
                if entry.attr in names and word.arg == "help" and isinstance(word.value, ast.Constant):
                    return str(word.value.value)
    return ""


PLAIN: dict[str, Any] = {"add_completion": False, "rich_markup_mode": None}
app = typer.Typer(
    cls=Subcommands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["--help", "-h"]},
)


def _show_version(asked: bool) -> None:
    if asked:
        typer.echo(f"quadftc {software_version()}, Python {sys.version.split()[0]}")
        raise typer.Exit


@app.callback()
def _root(
    show_version: Annotated[
        bool, typer.Option("--version", help="Show the version.", callback=_show_version, is_eager=True)
    ] = False,
) -> None:
    """Fault-tolerant attitude control for multirotors: fly scenarios, record, judge."""


def main() -> None:
    """Run the command; turn every error into a line and an exit code."""
    code = guarded(sys.argv[1:])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # nothing is left that could be stopped
    sys.exit(code)


def guarded(arguments: list[str], command: typer.Typer = app) -> int:
    """Run a command; turn every error into a line, and return the exit code."""
    try:
        result = command(arguments or ["--help"], standalone_mode=False)
        return result if isinstance(result, int) else GOOD
    except typer.TyperException as error:
        words = error.format_message() if hasattr(error, "format_message") else str(error)
        return _refuse(" ".join(words.replace(PYDANTIC, "").split()))
    except ValueError as error:
        return _refuse(str(error))
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED
    except Exception as error:
        names = {f"{each.__module__}.{each.__qualname__}" for each in type(error).__mro__}
        if names & {*BAD_INPUT_ERRORS}:
            return _refuse(str(error))
        if isinstance(error, ModuleNotFoundError) and (remedy := _remedy(error.name or "")):
            return _refuse(f"{error.name} is not installed: {remedy}")
        if GRAPH_ERROR in names:
            _say_error(f"error: {error}")
            return INTERNAL
        if isinstance(error, OSError) and error.errno in PATHS_FAULT:
            return _refuse(f"{error.filename or 'standard output'}: {error.strerror}")
        _say_error(_shortened(f"internal error: {type(error).__name__}: {error}"))
        if os.environ.get("QUADFTC_DEBUG"):
            import traceback

            traceback.print_exc()
        else:
            _say_error("set QUADFTC_DEBUG=1 to see where")
        return INTERNAL


def _remedy(module: str) -> str:
    """Return how to get a module that some commands need; empty if every command needs it."""
    if module.partition(".")[0].startswith(ROS):
        return "this needs ROS 2 Jazzy and the workspace (README.md)"
    extras = [extra for extra, modules in EXTRAS.items() if module.partition(".")[0] in modules]
    return f"pip install 'quadftc[{extras[0]}]'" if extras else ""


def _say_error(*lines: str) -> None:
    from quadftc_cli.screen import say

    say(*lines, stderr=True)


def _refuse(words: str) -> int:
    """Say what is wrong with the input, on a line for each problem; return the exit code."""
    lines = words.splitlines() or ["bad input"]
    _say_error(*(_shortened(f"error: {line}") for line in lines[:MAX_LINES]))
    if len(lines) > MAX_LINES:
        _say_error(f"error: and {len(lines) - MAX_LINES} more lines")
    return BAD_INPUT


def _shortened(line: str) -> str:
    """Leave out the middle of what is too long to be read."""
    return line if len(line) <= MAX_LINE else f"{line[: MAX_LINE // 2]} [...] {line[-MAX_LINE // 2 :]}"


if __name__ == "__main__":
    main()
