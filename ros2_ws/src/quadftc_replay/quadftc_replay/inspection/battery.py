"""Whether the battery breaks down in flight: its voltage falls far below what the flight takes it to.

A load l takes R l of a voltage. R is fitted to the changes from sample to sample, in which neither the charge
nor one breakdown counts. What the load does not explain is held against a straight line through the flight,
as it discharges, and against the median of the moments before.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import ndimage

from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.compass import robust_fit
from quadftc_replay.inspection.flight import BRIDGED, Flight, rotor_level
from quadftc_replay.inspection.found import Curve, Found, confidence, make_found
from quadftc_replay.inspection.whitening import Floats, Mask, runs_of

FEWEST = 10  # samples
LEAST = 2.5  # V; of one cell that is empty
SAG = 0.12  # 1; of the median voltage in flight
LEFT = 0.25  # 1; share of that by which it has left the usual voltage
LASTS = 0.3  # s
BEFORE = 10.0  # s; in which no sound battery falls so far
UNMEASURED = "nothing flies on that, so the voltage is not measured"


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
        return f"it reads {usual:.3g} V in flight: {UNMEASURED}"
    return f"{count} samples of the voltage in flight are too few" if count < FEWEST else None


def battery_findings(flight: Flight) -> Iterator[Found]:
    """Say when a battery that can be judged breaks down."""
    battery = flight.log.battery
    assert battery is not None
    flying = flight.in_flight(battery.time)
    volts = battery.value[:, 0]
    level = rotor_level(flight.log)
    unloaded = volts if level is None else volts + _sag(battery, level, flying)
    charge = _discharge(battery.time, unloaded, flying)
    known = np.maximum(charge, _before(battery.time, unloaded, flying))
    # where a log ends in the air, what falls so far may take it with it
    is_cut, last = flight.log.end - flight.intervals[-1].end < BRIDGED, int(np.flatnonzero(flying)[-1]) + 1
    until = 0
    for first in (run.start for run in runs_of(flying & (unloaded < (1.0 - SAG) * known))):
        low = flying[first:] & (unloaded[first:] < (1.0 - SAG) * known[first])
        run = slice(first, first + runs_of(low)[0].stop)  # what came before is soon forgotten
        start, end = float(battery.time[first]), float(battery.time[run.stop - 1])
        goes_out = is_cut and run.stop == last and last - first > 1
        if first < until or (end - start < LASTS and not goes_out):
            continue
        until = run.stop
        lowest, usual = float(unloaded[run].min()), float(known[run.start])
        start = _leaves(battery.time[: run.start + 1], unloaded[: run.start + 1], usual)
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


def _sag(battery: Signal, level: Signal, flying: Mask) -> Floats:
    """What the load takes of a voltage (n,) more than its usual one does [V]."""
    count = max(1, round(level.rate / max(battery.rate, 1e-9)))
    load = Signal(level.time, ndimage.uniform_filter1d(np.nan_to_num(level.value), count, axis=0))
    at = load.at(battery.time)
    both = flying[1:] & flying[:-1]
    per_load = robust_fit(np.diff(at, axis=0)[both], np.diff(battery.value[:, 0])[both])[0][0]
    return max(-float(per_load), 0.0) * (at[:, 0] - float(np.median(at[flying, 0])))


def _discharge(time: Floats, volts: Floats, flying: Mask) -> Floats:
    """Return the voltage at each sample (n,) that falls along a straight line; the median if it rises."""
    columns = np.column_stack([np.ones(len(time)), time])
    line = robust_fit(columns[flying], volts[flying])[0]
    return columns @ line if line[1] < 0.0 else np.full(len(time), float(np.median(volts[flying])))


def _before(time: Floats, volts: Floats, flying: Mask) -> Floats:
    """Median of a voltage (n,) in flight over `BEFORE` until each sample; -inf while that is not known."""
    stride = max(1, int(LASTS / max(float(np.median(np.diff(time))), 1e-9) / FEWEST))
    rows = np.flatnonzero(flying)[::stride]
    moments = np.arange(time[0], time[-1] + LASTS, LASTS)
    spans = np.searchsorted(time[rows], (moments - BEFORE, moments)).T
    parts = [volts[rows[slice(*span)]] for span in spans]
    medians = np.array([np.median(part) if len(part) >= FEWEST else -np.inf for part in parts])
    return np.asarray(medians[np.searchsorted(moments, time, side="right") - 1], np.float64)


def _leaves(time: Floats, volts: Floats, usual: float) -> float:
    """Return when the last fall of a voltage (n,) begins that ends far below the usual [s]."""
    still = np.flatnonzero(volts > (1.0 - LEFT * SAG) * usual)
    return float(time[min(int(still[-1]) + 1, len(time) - 1) if len(still) else 0])
