"""Loss of the thrust of all rotors together: the vehicle falls, though it is asked to fly.

In the air an accelerometer feels nothing but thrust and drag, however the vehicle is turned. With the mean
command u of all rotors but the one that is asked for most, which alone may be lost,

    rho = |f| / (k u),    k = median of |f| / u in the flight before

stays near one. Where more than half is missing for some time, and the velocity says that the vehicle falls,
the rotors do not give what they are asked for: power, ESCs or propellers have failed together. On the ground
rho is no less than one. A vehicle whose rotors are told to stop is asked for next to nothing.
"""

from __future__ import annotations

import numpy as np

from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.flight import FLYING, SHORTEST, SMOOTH, Flight, smooth
from quadftc_replay.inspection.found import Curve, Found, confidence, make_found
from quadftc_replay.inspection.rotors import ALL_OF_IT, FALLS, HALF
from quadftc_replay.inspection.whitening import Floats, runs_of


def thrust_findings(flight: Flight) -> list[Found]:
    """Say when all rotors together give less than half of what they are asked for, and the vehicle falls."""
    velocity = flight.log.velocity or flight.log.gps_velocity
    known = _asked_and_felt(flight)
    if known is None or velocity is None or len(velocity) < 2:
        return []
    time, asked, felt = known
    flying = flight.in_flight(time)
    usual = float(np.median(asked[flying])) if flying.any() else np.inf
    for each in flight.intervals:  # that a flight ends is what measured speeds say
        flying |= (time > each.end) & (time < min(each.end + FALLS, flight.until))
    flying &= asked > FLYING * usual
    share = felt / np.maximum(asked, 1e-9)
    share /= max(float(np.median(share[flying])), 1e-9) if flying.any() else 1.0
    means = smooth(Signal(time, np.stack([felt, share], axis=1)))
    for run in runs_of(flying & (means[:, 1] < HALF)):
        start, end = float(time[run.start]), float(time[run.stop - 1])
        whole = np.flatnonzero(flying[: run.start] & (share[: run.start] > ALL_OF_IT))
        is_known = len(whole) and time[whole[-1]] - time[whole[0]] > SHORTEST
        if is_known and end - start >= SMOOTH and _falls(velocity, float(means[run, 0].mean()), start, end):
            left = float(np.median(share[run]))
            kept = time < flight.until
            return [_found(float(time[whole[-1] + 1]), left, Signal(time[kept], share[kept, None]))]
    return []


def _asked_and_felt(flight: Flight) -> tuple[Floats, Floats, Floats] | None:
    """Times (n,) [s], what the rotors are asked for (n,), and the specific force that is felt (n,) [m/s²]."""
    commands = flight.log.rotor_commands
    forces = [each for each in flight.log.accelerometers.values() if len(each) > 1]
    if commands is None or not forces or not flight.phases_known or commands.value.shape[1] < 2:
        return None
    time = forces[0].time
    others = np.sort(np.nan_to_num(commands.value), axis=1)[:, :-1]
    asked = Signal(commands.time, others.mean(axis=1, keepdims=True)).at(time)[:, 0]
    sizes = [np.linalg.norm(np.nan_to_num(each.at(time)), axis=1) for each in forces]
    return time, asked, np.max(sizes, axis=0)


def _falls(velocity: Signal, felt: float, start: float, end: float) -> bool:
    """Whether a vehicle that feels a force [m/s²] goes down by half of what its weight makes of that."""
    rows = slice(*np.searchsorted(velocity.time, (start, end + 1.0 / velocity.rate)))
    lowest = float(np.min(velocity.value[rows, 2], initial=np.inf))
    fallen = float(velocity.at(np.array([start]))[0, 2]) - lowest
    expected = (STANDARD_GRAVITY - felt) * (end - start)
    return felt < ALL_OF_IT * STANDARD_GRAVITY and fallen > HALF * expected


def _found(onset: float, left: float, shares: Signal) -> Found:
    said = (
        f"the accelerometers feel {100 * left:.0f} % of what the rotors are asked for, and the vehicle falls"
    )
    return make_found(
        *("rotor", "", "off" if left < 1.0 - ALL_OF_IT else "loss", onset),
        size=1.0 - left,
        unit="1",
        probability=confidence(1.0 - left, HALF),
        evidence=(said,),
        curve=Curve("thrust over what is asked for", "1", shares.time, {"share": shares.value[:, 0]}),
    )
