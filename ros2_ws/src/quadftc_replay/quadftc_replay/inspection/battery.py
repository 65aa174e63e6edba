"""Whether the battery breaks down in flight: its voltage falls far below what the flight takes it to."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from quadftc_replay.inspection.flight import Flight, rotor_level
from quadftc_replay.inspection.found import Curve, Found, confidence, make_found
from quadftc_replay.inspection.whitening import Floats, runs_of

FEWEST = 10  # samples
LEAST = 2.5  # V; of one cell that is empty
SAG = 0.12  # 1; of the median voltage in flight
LEFT = 0.25  # 1; share of that by which it has left the usual voltage
LASTS = 0.3  # s


def cannot_judge_battery(flight: Flight) -> str | None:
    """Why nothing can be said of the battery; None: something can."""
    battery = flight.log.battery
    if battery is None:
        return "no voltage is logged"
    if not flight.phases_known:
        return "neither rotors nor thrust tell when it flies"
    flying = flight.in_flight(battery.time)
    count = int(flying.sum())
    if count >= FEWEST and (usual := float(np.median(battery.value[flying, 0]))) < LEAST:
        return f"it reads {usual:.3g} V in flight: nothing flies on that, so the voltage is not measured"
    return f"{count} samples of the voltage in flight are too few" if count < FEWEST else None


def battery_findings(flight: Flight) -> Iterator[Found]:
    """Say when a battery that can be judged breaks down."""
    battery = flight.log.battery
    assert battery is not None
    flying = flight.in_flight(battery.time)
    volts = battery.value[:, 0]
    usual = float(np.median(volts[flying]))
    low = flying & (volts < (1.0 - SAG) * usual)
    level = rotor_level(flight.log)
    for run in runs_of(low):
        start, end = float(battery.time[run.start]), float(battery.time[run.stop - 1])
        if end - start < LASTS:
            continue
        lowest = float(volts[run].min())
        start = _leaves(battery.time[: run.start + 1], volts[: run.start + 1], usual)
        said = [f"the voltage falls to {lowest:.3g} V, {100 * (1 - lowest / usual):.0f} % below the usual"]
        if level is not None:
            share = np.interp(start, level.time, level.value[:, 0]) / np.nanmedian(level.value[:, 0])
            said.append(f"the rotors are asked for {100 * share:.0f} % of their usual level then")
        yield make_found(
            *("battery", "", "brownout", start),
            end_s=end if end < flight.intervals[-1].end - LASTS else None,
            size=lowest - usual,
            unit="V",
            probability=confidence(1.0 - lowest / usual, SAG),
            evidence=tuple(said),
            curve=Curve("battery", "V", battery.time, {"voltage": volts}),
        )


def _leaves(time: Floats, volts: Floats, usual: float) -> float:
    """Return when the last fall of a voltage (n,) begins that ends far below the usual [s]."""
    still = np.flatnonzero(volts > (1.0 - LEFT * SAG) * usual)
    return float(time[min(int(still[-1]) + 1, len(time) - 1) if len(still) else 0])
