"""Progress of what takes long: bars on a terminal, a line every few seconds elsewhere."""

from __future__ import annotations

import time
from types import TracebackType
from typing import Protocol

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from typing_extensions import Self

LINE_PERIOD = 5.0  # s between two lines where there is no terminal
STRIDE = 0.005  # share between two updates of a bar


class Update(Protocol):
    """Sets the share of a task (0 to 1) and a note behind its bar."""

    def __call__(self, share: float, /, note: str = "") -> None: ...  # noqa: D102


class Bars:
    """Show how far several tasks are; use as a context manager.

    Parameters
    ----------
    screen : Console
    still : bool
        Redraw only on updates: the thread that animates bars would delay a flight in real time.
    """

    def __init__(self, screen: Console, still: bool = False) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn())
        self._bars = Progress(
            *columns,
            TextColumn("{task.fields[note]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=screen,
            auto_refresh=not still,
            disable=not screen.is_terminal,
        )
        self._screen = screen
        self._still = still
        self._shares: dict[TaskID, tuple[str, float]] = {}
        self._next_line = time.monotonic() + LINE_PERIOD

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()

    def add(self, name: str) -> Update:
        """Add a task; return what sets its share (0 to 1) and a note behind its bar."""
        task = self._bars.add_task(name, total=1.0, note="")
        self._shares[task] = (name, 0.0)

        def update(share: float, /, note: str = "") -> None:
            if 0.0 < share < 1.0 and share - self._shares[task][1] < STRIDE:
                return
            self._shares[task] = (name, share)
            self._bars.update(task, completed=share, note=note, refresh=self._still)
            self._print_line()

        return update

    def _print_line(self) -> None:
        """Without a terminal, print the shares of the tasks that are under way."""
        if self._screen.is_terminal or time.monotonic() < self._next_line:
            return
        self._next_line = time.monotonic() + LINE_PERIOD
        under_way = [f"{name} {share:.0%}" for name, share in self._shares.values() if 0.0 < share < 1.0]
        if under_way:
            self._screen.print(", ".join(under_way), markup=False, soft_wrap=True)
