"""What each rotor has to give in steady flight, and whose weakness explains it.

A controller that holds a vehicle level makes up for a weak rotor: its share s_i = u_i / mean(u) is larger.
Steady flight has one equation for each axis, so only the trim

    c = B (s - 1),    B = (roll, pitch, yaw) effect of each rotor, every row of length 1

can be known. A rotor that lost the share lambda of its thrust gives c = x B e_i, x = lambda s_i. A
centre of mass off the middle gives any roll and pitch trim, and no yaw. c is compared with that of a healthy
flight of the same vehicle, else with none:

    chi²(i) = min over x of (c - x B e_i)' S^-1 (c - x B e_i)

Without a healthy flight, it has to leave less than a centre of mass does, which is all of the yaw trim.
S says how much trims differ without any fault, from flight to flight or from vehicle to vehicle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import special

from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.flight import Flight, rotor_level, row_means
from quadftc_replay.inspection.whitening import TO_SIGMA, Floats

# 1; standard deviations of c, in roll, pitch, yaw. From flight to flight: three flights of a Crazyflie; pitch
# may differ more, as batteries are pushed in from the front. From vehicle to vehicle: estimates, from six
BETWEEN_FLIGHTS = np.array([0.01, 0.04, 0.02])
BETWEEN_VEHICLES = np.array([0.12, 0.12, 0.2])
STEADY = 0.2  # 1; how far the mean command may be from its median
BLOCK = 2.0  # s
COMES_AGAIN = 0.35  # 1; share of what blocks differ by
LEAST = 3  # blocks
SHARPER = 7.0  # 1; by which a rotor has to explain c better than no rotor (chi², one degree of freedom)
LEAST_LOSS = 0.04  # 1
LEAST_ALONE = 0.25  # 1; without a baseline
NEARLY = 0.15  # probability of a rotor, relative to the likeliest, from which it is named as well


class Trim(NamedTuple):
    """Share of each rotor in steady flight."""

    blocks: Floats  # (m, n) means over blocks

    @property
    def share(self) -> Floats:
        """Median over the blocks (n,)."""
        return np.median(self.blocks, axis=0)

    def seen_by(self, rows: Floats) -> tuple[Floats, Floats]:
        """Trim along rows (k, n), and its variance (k,).

        Blocks differ by noise, by what is flown and by the battery; every other one counts as independent.
        What they differ by as a whole, as in wind, may come again in another flight.
        """
        along = (self.blocks - 1.0) @ rows.T
        middle = np.median(along, axis=0)
        spread = TO_SIGMA * np.median(np.abs(along - middle), axis=0)
        return middle, spread**2 * max(2.0 / len(along), COMES_AGAIN**2)


class Weak(NamedTuple):
    """A rotor that is weak."""

    rotor: int
    loss: float  # 1; share of its thrust
    more: float  # 1; of the mean, that it is asked for besides
    sigma: float
    score: float  # chi² that it explains
    probability: float
    others: tuple[int, ...]  # rotors that are nearly as likely


def rotor_thrusts(log: FlightLog) -> tuple[str, Signal] | None:
    """Return what stands for the thrust of each rotor, and what it is: speeds squared, else commands."""
    if log.rotor_commands is not None and len(log.rotor_commands) > 20:
        return "commands", log.rotor_commands
    if log.rotor_speeds is not None and len(log.rotor_speeds) > 20:
        return "speeds squared", Signal(log.rotor_speeds.time, log.rotor_speeds.value**2)
    return None


def trim_of(flight: Flight) -> Trim | None:
    """Return the trim of a flight; None if it is too short or rotors are not logged."""
    found = rotor_thrusts(flight.log)
    level = rotor_level(flight.log)
    if found is None or level is None or not flight.phases_known:
        return None
    sensor = found[1]
    steady = flight.in_flight(sensor.time) & np.isfinite(sensor.value).all(axis=1)
    mean = row_means(sensor.value)[:, 0]
    if not steady.any():
        return None
    usual = float(np.median(mean[steady]))
    steady &= np.abs(mean - usual) < STEADY * usual
    shares = sensor.value / np.maximum(mean, 1e-9)[:, None]
    starts = np.flatnonzero(np.diff(np.floor(sensor.time[steady] / BLOCK), prepend=-1.0))
    means = [part.mean(axis=0) for part in np.split(shares[steady], starts)[1:]]
    if len(means) < LEAST:
        return None
    return Trim(np.array(means))


def effects(log: FlightLog) -> Floats | None:
    """Rows roll, pitch, yaw of each rotor (3, n), each row of length 1; None: not known."""
    places, signs = log.rotor_positions, log.rotor_yaw_signs
    if places is None or signs is None:
        return None
    rows = normalised(np.stack([places[:, 1], -places[:, 0], signs]))
    return rows if np.isfinite(rows).all() else None


def normalised(rows: Floats) -> Floats:
    """Rows (k, n) of length 1 that rotors together do not move; NaN where all rotors do the same."""
    rows = rows - rows.mean(axis=1, keepdims=True)
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    return np.divide(rows, size, out=np.full_like(rows, np.nan), where=size > 0.0)


def find_weak(trim: Trim, healthy: Trim | None, layout: Floats | None) -> Weak | None:
    """Find the weak rotor that explains a trim; ``healthy`` is that of a flight without a fault."""
    rows = layout
    if rows is None or (healthy is not None and len(healthy.share) != len(trim.share)):
        return None
    spread = BETWEEN_VEHICLES if healthy is None else BETWEEN_FLIGHTS
    seen, variance = trim.seen_by(rows)
    if healthy is not None:
        usual, more = healthy.seen_by(rows)
        seen, variance = seen - usual, variance + more
    weight = 1.0 / (spread**2 + variance)
    power = np.einsum("k,ki,ki->i", weight, rows, rows)
    size = (weight * seen) @ rows / power
    explained = np.where(size > 0.0, size**2 * power, 0.0)
    rotor = int(np.argmax(explained))
    share = max(float(trim.share[rotor]), 1e-9)
    loss = min(float(size[rotor]) / share, 1.0)
    least = LEAST_ALONE if healthy is None else LEAST_LOSS
    left = float(weight @ seen**2) - float(explained[rotor])  # such as the yaw trim of a flight in circles
    if explained[rotor] < max(SHARPER, left) or loss < least:
        return None
    if healthy is None and left > weight[2] * seen[2] ** 2:
        return None  # a centre of mass off the middle explains more: it leaves the yaw trim alone
    likely = special.softmax(0.5 * np.concatenate([explained, [SHARPER / 2.0]]))
    others = [int(k) for k in np.flatnonzero(likely[:-1] > NEARLY * likely[rotor]) if k != rotor]
    sigma = float(1.0 / np.sqrt(power[rotor])) / share
    score, probability = float(explained[rotor]), float(likely[rotor])
    return Weak(rotor, loss, float(size[rotor]), sigma, score, probability, tuple(others))
