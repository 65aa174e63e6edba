# pyright: basic
"""Draw docs/figures/flight.gif: the vehicle from behind, with and without diagnosis.

    python -m quadftc_tools.docs.moving_picture docs/figures/flight.gif

Both flights are flown by the closed loop without ROS, from the scenario beside this file.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from PIL import Image

from quadftc_flight.closed_loop import fly
from quadftc_flight.flight import Flight
from quadftc_flight.scenario import load_scenario

mpl.use("Agg")
from matplotlib import pyplot as plt

SCENARIO = Path(__file__).with_suffix(".yaml")
START, STOP, FRAMES_PER_SECOND = 6.5, 14.0, 10  # s, s, 1/s; the part of the flight that is shown
FAULT = (8.0, 12.0)  # s
SCHEMES = {"conventional": ("without diagnosis", "#c23b22"), "supervised": ("quadftc", "#1f6fb4")}
COLOURS = 48  # of the palette; keeps the file small


def _draw_vehicle(axes: Any, roll: float, colour: str) -> None:
    """Draw the vehicle from behind: arms, rotors and body, turned by the true roll [rad]."""
    along = np.array([np.cos(roll), -np.sin(roll)])  # to the right: a positive roll lowers that side
    up = np.array([np.sin(roll), np.cos(roll)])
    axes.axhline(0.0, color="#d9d9d9", linewidth=1.0, zorder=0)
    axes.plot(*np.array([-along, along]).T, color=colour, linewidth=5.0, solid_capstyle="round")
    for side in (-1.0, 1.0):
        hub = side * along + 0.14 * up
        axes.plot(*np.array([side * along, hub]).T, color=colour, linewidth=3.0)
        axes.plot(*np.array([hub - 0.42 * along, hub + 0.42 * along]).T, color="#555555", linewidth=2.5)
    axes.plot(*np.array([-0.16 * along, 0.16 * along]).T, color="#333333", linewidth=14.0)


def _draw_frame(flights: dict[str, Flight], now: float) -> Image.Image:
    """Draw all of one moment."""
    figure, grid = plt.subplot_mosaic(
        [["conventional", "supervised"], ["roll", "roll"]],
        figsize=(6.4, 3.8),
        height_ratios=(1.5, 1.0),
        layout="constrained",
    )
    lying = FAULT[0] <= now < FAULT[1]
    for scheme, (name, colour) in SCHEMES.items():
        flight, axes = flights[scheme], grid[scheme]
        roll = flight.angles[np.searchsorted(flight.time, now), 0]
        _draw_vehicle(axes, roll, colour)
        axes.set(xlim=(-1.7, 1.7), ylim=(-0.75, 0.75), xticks=[], yticks=[], aspect="equal")
        axes.set_title(f"{name}: true roll {np.degrees(roll):+.1f} deg".replace("-0.0", "+0.0"), fontsize=10)
        past = (flight.time >= START) & (flight.time <= now)
        grid["roll"].plot(
            flight.time[past] - START,
            np.degrees(flight.angles[past, 0]),
            color=colour,
            linewidth=1.6,
            label=name,
        )
    roll_axes = grid["roll"]
    roll_axes.axvspan(FAULT[0] - START, FAULT[1] - START, color="#f3e6b3", linewidth=0.0)
    roll_axes.text(
        0.5 * sum(FAULT) - START,
        3.0,
        "attitude sensor reads 8 deg too much",
        ha="center",
        fontsize=9,
        alpha=1.0 if lying else 0.45,
    )
    roll_axes.set(xlim=(0.0, STOP - START), ylim=(-11.0, 6.0), xlabel="time [s]", ylabel="true roll [deg]")
    roll_axes.grid(color="#eeeeee")
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=100)
    plt.close(figure)
    return Image.open(buffer).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)


def main(path: str) -> None:
    """Fly, draw and write the picture."""
    scenario = load_scenario(SCENARIO)
    flights = {scheme: fly(scenario, scheme) for scheme in SCHEMES}
    moments = np.arange(START, STOP, 1.0 / FRAMES_PER_SECOND)
    first, *others = [_draw_frame(flights, float(moment)) for moment in moments]
    first.save(
        path, save_all=True, append_images=others, duration=1000 // FRAMES_PER_SECOND, loop=0, optimize=True
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
