"""A figure on the page."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Mapping
from typing import Any
from urllib.parse import quote

from quadftc_report.description import Figure
from quadftc_report.draw_plotly import plotly_config, plotly_figure


@dataclasses.dataclass(frozen=True, eq=False)
class Drawing:
    """A figure on the page, and where the same is for print.

    Parameters
    ----------
    figure : Figure
    files : mapping of str to str
        Kind of file to its address, relative to the page; empty: there is none.
    """

    figure: Figure
    files: Mapping[str, str]

    @functools.cached_property
    def spec(self) -> dict[str, Any]:
        """What Plotly draws it from: data, layout, config."""
        return {**plotly_figure(self.figure).to_dict(), "config": plotly_config(self.figure)}


def drawings(figures: Iterable[Figure], folder: str | None) -> tuple[Drawing, ...]:
    """Return figures for the page.

    Parameters
    ----------
    figures : iterable of Figure
    folder : str, optional
        Directory of the figures for print, beside the page; None: there are none.
    """
    return tuple(Drawing(figure, _files(figure, folder)) for figure in figures)


def _files(figure: Figure, folder: str | None) -> dict[str, str]:
    if folder is None:
        return {}
    return {kind.upper(): quote(f"{folder}/{figure.key}.{kind}") for kind in ("png", "pdf")}
