"""A figure over time, or a map, whoever draws it: panels of traces, areas, windows, moments and bands."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_report.decimation import Indices, choose_samples

Floats = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Trace:
    """A line; ``role`` and ``rank`` choose its look (`quadftc_report.style.line_style`)."""

    name: str
    role: str  # truth, reference, proposed or compared
    t: Floats  # (n,) [s]
    y: Floats  # (n,) in the panel's unit; NaN: a gap
    rank: int = 0  # which of the compared runs

    def chosen(self) -> Indices:
        """Return the indices of the samples that are drawn; those of a path on a map as over time."""
        if np.all(np.diff(self.t) > 0.0):
            return choose_samples(self.t, self.y)
        return choose_samples(np.arange(len(self.t), dtype=np.float64), self.t, self.y)


class Envelope(NamedTuple):
    """An area around a line, such as two standard deviations either side."""

    name: str
    role: str
    t: Floats  # (n,) [s]
    low: Floats  # (n,) in the panel's unit; NaN: a gap
    high: Floats
    rank: int = 0


class Shade(NamedTuple):
    """A window of time [s], such as that of a fault; ``rank``: its kind, 0 for faults of the attitude."""

    start: float
    stop: float
    label: str
    rank: int = 0


class Mark(NamedTuple):
    """A moment [s]."""

    time: float
    label: str


class Band(NamedTuple):
    """A range of values at any time: the boundary layer of a run, or the authority (role ``limit``)."""

    low: float
    high: float
    label: str
    role: str
    rank: int = 0


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Panel:
    """One pair of axes; the time axis is that of the figure."""

    title: str  # short, for the hover text
    y_label: str  # without the unit
    unit: str
    traces: tuple[Trace, ...]
    shades: tuple[Shade, ...] = ()
    marks: tuple[Mark, ...] = ()
    bands: tuple[Band, ...] = ()
    envelopes: tuple[Envelope, ...] = ()
    ticks: tuple[tuple[float, str], ...] = ()  # rising values of a scale of words, and the words
    height: float = 1.0  # relative to the other panels

    def axis_label(self, gap: str = " ") -> str:
        """The label of the y axis with its unit, if it has one."""
        return f"{self.y_label}{gap}[{self.unit}]" if self.unit else self.y_label

    @property
    def tick_span(self) -> tuple[float, float]:
        """Range of the axis of a scale of words."""
        return self.ticks[0][0] - 0.4, self.ticks[-1][0] + 0.4


@dataclasses.dataclass(frozen=True, eq=False)
class Figure:
    """Panels above each other, over one time axis."""

    key: str  # unique in a report, fit for a file's name
    title: str
    caption: str  # one sentence
    panels: tuple[Panel, ...]
    span: tuple[float, float]  # of the time axis [s]; of a map its horizontal axis
    paper_figures: tuple[int, ...] = ()  # those of the paper that show the same
    x_label: str = "time [s]"
    is_map: bool = False  # both axes are places, to one scale; `t` of a trace is its horizontal place
