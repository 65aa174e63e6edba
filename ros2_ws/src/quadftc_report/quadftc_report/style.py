"""How the lines of a report look, on the screen and on paper: one style for each run, in every figure.

As in Wang, Huang and Zhang (2021): reference solid black, proposed dashed blue, compared dash-dotted red. The
colours are those of Okabe and Ito (2008), told apart by colour-blind readers; the dashes still tell when the
page is printed grey.
"""

from __future__ import annotations

from typing import NamedTuple

BLACK = "#000000"
GREY = "#6e6e6e"
SHADES = ("#f7edd3", "#e2e9e6", "#efe3ea", "#e4e4e4")  # windows, by their kind: sand, green, mauve, grey
PROPOSED = "#0072B2"  # blue
COMPARED = ("#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # vermilion, green, purple, orange, sky
DASHED = (3.6, 1.2)  # short gaps: no peak of a line hides in one
DASH_PATTERNS = ((5.0, 1.2, 1.2, 1.2), (1.2, 1.2), (8.0, 1.6), (5.0, 1.2, 1.2, 1.2, 1.2, 1.2))
# of the compared runs; four patterns and five colours: no two of twenty lines look alike


class LineStyle(NamedTuple):
    """Look of a line."""

    colour: str
    dashes: tuple[float, ...]  # lengths of stroke, gap, stroke ... in multiples of the width; empty: solid
    width: float  # multiple of the usual width
    layer: int  # larger: in front


def line_style(role: str, rank: int = 0) -> LineStyle:
    """Return the look of a line: of truth, reference, proposed, compared (by rank) or limit."""
    if role in ("truth", "reference"):
        return LineStyle(GREY if rank else BLACK, (), 1.0, 1)
    if role == "proposed":
        return LineStyle(PROPOSED, DASHED, 1.2, 1000)
    if role == "compared":
        dashes = DASH_PATTERNS[rank % len(DASH_PATTERNS)]
        return LineStyle(COMPARED[rank % len(COMPARED)], dashes, 1.2, 999 - rank)
    if role == "limit":
        return LineStyle(GREY, (1.0, 1.0), 0.8, 0)
    raise ValueError(f"role = {role!r}: expected truth, reference, proposed, compared or limit")


def shade_colour(rank: int) -> str:
    """Return the colour of a kind of windows; 0: faults of the attitude."""
    return SHADES[rank % len(SHADES)]
