# pyright: basic
"""Draw docs/figures/flight.gif: the vehicle in the scene of ``quadftc live``, with and without diagnosis.

    python -m quadftc_tools.docs.moving_picture docs/figures/flight.gif

Both flights are flown by the closed loop without ROS, from the scenario beside this file. Chromium and its
driver take the pictures.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from PIL import Image

from quadftc_flight.closed_loop import fly
from quadftc_flight.flight import Flight
from quadftc_flight.scenario import load_scenario
from quadftc_tools.docs.scene_pictures import scene_camera

mpl.use("Agg")
from matplotlib import pyplot as plt

SCENARIO = Path(__file__).with_suffix(".yaml")
START, STOP, FRAMES_PER_SECOND = 6.5, 14.0, 10  # s, s, 1/s; the part of the flight that is shown
FAULT = (8.0, 12.0)  # s
SCHEMES = {"conventional": ("without diagnosis", "#c23b22"), "supervised": ("quadftc", "#1f6fb4")}
PICTURE = (700, 480)  # pixels of the scene
COLOURS = 64  # of the palette; keeps the file small


def _draw_frame(flights: dict[str, Flight], pictures: dict[str, Image.Image], now: float) -> Image.Image:
    """Draw all of one moment."""
    figure, grid = plt.subplot_mosaic(
        [["conventional", "supervised"], ["roll", "roll"]],
        figsize=(7.2, 4.3),
        height_ratios=(1.75, 1.0),
        layout="constrained",
    )
    lying = FAULT[0] <= now < FAULT[1]
    for scheme, (name, colour) in SCHEMES.items():
        flight, axes = flights[scheme], grid[scheme]
        roll = flight.angles[np.searchsorted(flight.time, now), 0]
        axes.imshow(pictures[scheme])
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
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
    pictures: dict[str, list[Image.Image]] = {}
    with scene_camera(scenario.vehicle, *PICTURE) as camera:
        for scheme, flight in flights.items():
            pictures[scheme] = list(camera.take(flight, np.searchsorted(flight.time, moments).tolist()))
    first, *others = [
        _draw_frame(flights, {scheme: pictures[scheme][k] for scheme in SCHEMES}, float(moment))
        for k, moment in enumerate(moments)
    ]
    first.save(
        path, save_all=True, append_images=others, duration=1000 // FRAMES_PER_SECOND, loop=0, optimize=True
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
