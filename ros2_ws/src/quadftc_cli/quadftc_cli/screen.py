"""What the commands print: lines, tables, and the progress of what takes long."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

from rich import progress
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.errors import MarkupError
from rich.table import Table
from rich.text import Text

LINE_PERIOD = 5.0  # s between two lines of progress where there is no terminal
STRIDE = 0.005  # share between two updates of a bar

Update = Callable[..., None]  # sets the share of a task (0 to 1) and, if given, a note behind its bar


class Screen(Console):
    """A console that steers no terminal by what it shows, such as names of files and topics."""

    def render_str(self, text: str, *, markup: bool | None = None, **how: Any) -> Text:
        """Return a text with its markup, if that makes sense; control characters are escaped."""
        try:
            return super().render_str(printable(text), markup=markup, **how)
        except MarkupError:
            return super().render_str(printable(text), markup=False, **how)


def printable(text: str) -> str:
    """Return a text whose control characters, but line breaks and tabs, are escaped."""
    return "".join(
        each if each.isprintable() or each in "\n\t" else each.encode("unicode_escape").decode()
        for each in text
    )


def console(stderr: bool = False) -> Console:
    """Console that does not wrap in files and pipes, where the width is unknown."""
    found = Screen(stderr=stderr, highlight=False)
    return found if found.is_terminal else Screen(stderr=stderr, highlight=False, width=120)


def say(*lines: str, stderr: bool = False) -> None:
    """Print lines as they are, without markup."""
    screen = console(stderr)
    for line in lines:
        screen.print(line, markup=False, soft_wrap=True)


def warn(lines: Iterable[str]) -> None:
    """Print warnings."""
    say(*(f"warning: {line}" for line in lines), stderr=True)


def plain_table(left: Iterable[str], right: Iterable[str], title: str | None = None) -> Table:
    """Table with a rule below its headings only: columns of words, then columns of numbers."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False, title=None if title is None else Text(printable(title)))
    for heading in left:
        table.add_column(Text(heading), no_wrap=True)
    for heading in right:
        table.add_column(Text(heading), justify="right", no_wrap=True)
    return table


class Bars(progress.Progress):
    """Show how far several tasks are: bars on a terminal, a line every few seconds elsewhere.

    Use as a context manager. ``still`` redraws on updates only: the thread that animates bars would delay a
    flight in real time.
    """

    def __init__(self, screen: Console, still: bool = False) -> None:
        super().__init__(
            *(progress.TextColumn("{task.description}", markup=False), progress.BarColumn()),
            *(progress.TaskProgressColumn(), progress.TextColumn("{task.fields[note]}", markup=False)),
            *(progress.TimeElapsedColumn(), progress.TimeRemainingColumn()),
            console=screen,
            auto_refresh=not still,
            disable=not screen.is_terminal,
        )
        self._still = still
        self._shares: dict[str, float] = {}
        self._next_line = time.monotonic() + LINE_PERIOD

    def add(self, name: str) -> Update:
        """Add a task; return what sets its share."""
        task = self.add_task(printable(name), total=1.0, note="")
        self._shares[name] = 0.0

        def update(share: float, /, note: str = "") -> None:
            if share in (0.0, 1.0) or share - self._shares[name] >= STRIDE:
                self._shares[name] = share
                self.update(task, completed=share, note=printable(note), refresh=self._still)
                self._print_line()

        return update

    def _print_line(self) -> None:
        """Without a terminal, print the shares of the tasks that are under way."""
        under_way = [f"{name} {share:.0%}" for name, share in self._shares.items() if 0.0 < share < 1.0]
        if under_way and not self.console.is_terminal and time.monotonic() >= self._next_line:
            self._next_line = time.monotonic() + LINE_PERIOD
            say(", ".join(under_way), stderr=True)

    def stop(self) -> None:
        """End the bars; where there is no terminal, rich would print an empty line."""
        if self.console.is_terminal:
            super().stop()
