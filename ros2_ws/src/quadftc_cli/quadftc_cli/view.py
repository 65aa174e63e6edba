# pyright: basic
"""What ``quadftc watch`` shows: the last values of a vehicle, and how they came about, as text."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from quadftc_cli.live_page.picture import MODES, kind_and_size, level_of
from quadftc_cli.screen import plain_table
from quadftc_model.arrays import Vector
from quadftc_model.rotations import euler_from_quaternion
from quadftc_model.samples import AXES
from quadftc_msgs.msg import ComponentFault

BARS = "▁▂▃▄▅▆▇█"
PERIOD = 0.25  # s; between two points of a curve
POINTS = 60  # of a curve: 15 s
SILENT = 1.0  # s; what is older is not shown as present
LEVELS = ("ok", "[yellow]WARN[/]", "[red]ERROR[/]", "[red]STALE[/]")
COLOURS = ("default", "yellow", "yellow", "red", "red")  # of `MODES`
ROWS = (  # topic, what it is called
    ("attitude/reference", "reference"),
    ("imu/data", "measured"),
    ("imu/corrected", "corrected"),
    ("plant/attitude", "truth"),
    ("fault/injected", "injected"),
    ("fault/estimate", "estimate"),
)
TOPICS = (*(topic for topic, _ in ROWS), "diagnosis", "control/status", "/diagnostics")


def sparkline(values: Sequence[float]) -> str:
    """Return a curve as a line of bars, from the least value to the largest; blank where there is none."""
    finite = [value for value in values if math.isfinite(value)]
    if not finite:
        return " " * len(values)
    low, span = min(finite), max(finite) - min(finite)
    scale = (len(BARS) - 1) / span if span > 0.0 else 0.0
    return "".join(BARS[round((value - low) * scale)] if math.isfinite(value) else " " for value in values)


def angles_of(message: Any) -> Vector:
    """Return the Euler angles [deg] of a message with an attitude or a vector [rad]."""
    if hasattr(message, "orientation"):
        turn = message.orientation
        return np.degrees(euler_from_quaternion(np.array([turn.x, turn.y, turn.z, turn.w])))
    vector = message.vector if hasattr(message, "vector") else message.angles
    return np.degrees([vector.x, vector.y, vector.z])


class View:
    """The last message of each topic, and curves of the estimate of the attitude's fault; times in s."""

    def __init__(self, vehicle: str) -> None:
        self.vehicle = vehicle
        self._last: dict[str, tuple[float, Any]] = {}
        self._statuses: dict[str, Any] = {}
        self._curves = [deque[float]([math.nan] * POINTS, POINTS) for _ in AXES]
        self._next = 0.0

    def take(self, topic: str, message: Any, now: float) -> None:
        """Note a message."""
        self._last[topic] = now, message
        if topic == "/diagnostics":
            self._statuses.update((status.name, status) for status in message.status)
        elif topic == "fault/estimate" and now >= self._next:
            self._next = now + PERIOD
            for curve, value in zip(self._curves, angles_of(message), strict=True):
                curve.append(float(value))

    def present(self, topic: str, now: float) -> Any:
        """Return the last message of a topic if it is young."""
        time, message = self._last.get(topic, (-math.inf, None))
        return message if now - time <= SILENT else None

    def line(self, now: float) -> str:
        """One line, for where there is no terminal."""
        parts: list[str] = []
        for topic, name in ROWS:
            if (message := self.present(topic, now)) is not None:
                parts.append(f"{name} " + " ".join(f"{value:.2f}" for value in angles_of(message)))
        told = Text.from_markup("; ".join(self._words(now))).plain
        return f"[deg] {', '.join(parts)}; {told}" if parts else "nothing comes: no sample within a second"

    def page(self, now: float) -> Group:
        """The whole, for a terminal."""
        table = plain_table(("", *()), AXES, f"{self.vehicle}, angles in deg")
        for topic, name in ROWS:
            message = self.present(topic, now)
            values = ["-"] * 3 if message is None else [f"{value:.2f}" for value in angles_of(message)]
            table.add_row(name, *values)
        curves = Table.grid(padding=(0, 2))
        for name, curve in zip(AXES, self._curves, strict=True):
            finite = [value for value in curve if math.isfinite(value)]
            extent = f"{min(finite):.2f} to {max(finite):.2f}" if finite else ""
            curves.add_row(f"estimate {name}", sparkline(curve), extent)
        return Group(table, curves, Text(), *(Text.from_markup(line) for line in self._words(now)))

    def _words(self, now: float) -> list[str]:
        """Say what is faulty, how the controller flies, and what warns."""
        lines: list[str] = []
        if (diagnosis := self.present("diagnosis", now)) is not None:
            found = [_finding(fault) for fault in diagnosis.faults]
            watched = (
                ", ".join(diagnosis.watched) or "nothing: no attitude yet, or an observer without states"
            )
            lines.append(f"faults: {'; '.join(found) or 'none'} (watched: {watched})")
        if (status := self.present("control/status", now)) is not None:
            known = status.mode < len(MODES)
            mode = f"[{COLOURS[status.mode]}]{MODES[status.mode]}[/]" if known else status.mode
            lines.append(f"controller: {mode}")
        for name, status in sorted(self._statuses.items()):
            if level := level_of(status):
                lines.append(f"{LEVELS[min(level, 3)]} {name}: {status.message}")
        return lines


def _finding(fault: ComponentFault) -> str:
    return f"[red]{fault.component} {fault.element}[/] {kind_and_size(fault)}"
