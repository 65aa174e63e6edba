"""What `quadftc diagnose` says of multirotors that are wired wrong and take off.

    python -m quadftc_tools.study.wirings [--flights 20] [--seed 95000] [--docs docs]

Random vehicles rest with their rotors stopped, and then fly from a height, each with its motors in another
order, propellers on the wrong way, an axis reversed or the autopilot turned. The controller does not know.
Some are sound, some lack a rotor from the beginning. Each flight is written as ArduPilot and as PX4 log it by
default, read back and judged. The table goes into docs/diagnose.md, or onto the screen without ``--docs``.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_model.vehicle import Vehicle
from quadftc_replay.inspection.inspect import inspect
from quadftc_replay.inspection.verdict import Verdict
from quadftc_tools.study.numbers import write_share
from quadftc_tools.study.page import NOTHING, Tables, markdown, run_study
from quadftc_tools.study.random_flights import RATE, Loss, RandomFlight, draw_flight
from quadftc_tools.study.simulated_logs import Floats, Flown, as_logged, fly, log_of

SECONDS, REST = 8.0, 2.0  # s; of a flight, and before it
NOISE = 1e-4  # 1; of a quaternion at rest
WIRINGS = {  # what the plant has in place of the rotors that the controller knows: x, y, sense of rotation
    "roll reversed": (1.0, -1.0, 1.0),
    "pitch reversed": (-1.0, 1.0, 1.0),
    "yaw reversed": (1.0, 1.0, -1.0),
    "autopilot turned by 180 deg": (-1.0, -1.0, 1.0),
}
TURNED, EXCHANGED = "autopilot turned by 90 deg", "two motors exchanged"
LOST, SOUND = "a rotor gives no thrust", "sound"
ALL = (*WIRINGS, TURNED, EXCHANGED, LOST, SOUND)


def wire(vehicle: Vehicle, wiring: str, rng: np.random.Generator) -> Vehicle:
    """Return a vehicle as it is wired; one of `ALL`."""
    rotors = vehicle.rotors
    places, order, sense = rotors.positions, np.arange(len(rotors.yaw_sign)), 1.0
    if wiring in WIRINGS:
        x, y, sense = WIRINGS[wiring]
        places = places * [x, y]
    elif wiring == TURNED:
        places = np.stack([-places[:, 1], places[:, 0]], axis=1)
    elif wiring == EXCHANGED:
        pair = rng.choice(len(order), 2, replace=False)
        order[pair] = pair[::-1]
    wired = dataclasses.replace(
        rotors,
        positions=places[order],
        yaw_sign=sense * rotors.yaw_sign[order],
        spin_sign=sense * rotors.spin_sign[order],
    )
    return dataclasses.replace(vehicle, rotors=wired)


def judge_take_off(seed: int, wiring: str) -> Iterator[tuple[RandomFlight, Verdict]]:
    """Fly a seed with a wiring, and judge its logs."""
    rng = np.random.default_rng([seed, ALL.index(wiring)])
    loss = Loss(rng.random(), 1.0, 0.0) if wiring == LOST else None
    with tempfile.TemporaryDirectory(prefix="quadftc_") as folder:
        flight = draw_flight(rng, SECONDS, Path(folder), loss)
        plant = dataclasses.replace(flight.scenario.plant, vehicle=wire(flight.vehicle, wiring, rng))
        scenario = flight.scenario.model_copy(update={"plant": plant})
        log = log_of(flight, after_rest(fly(flight._replace(scenario=scenario)), rng), rng)
    for _, read in as_logged(log):
        yield flight, inspect(read).verdict


def after_rest(flown: Flown, rng: np.random.Generator) -> Flown:
    """Put a rest before a flight, level and with rotors that stand."""
    count = round(REST * RATE)

    def begin(name: str, value: Floats) -> Floats:
        stays = name in ("attitude", "true_attitude", "position")
        row = value[0] if stays else np.zeros_like(value[0])
        if name == "force":
            row = np.array([0.0, 0.0, STANDARD_GRAVITY])
        rest = np.tile(row, (count, 1))
        if name == "attitude":
            rest += NOISE * rng.standard_normal(rest.shape)
            rest /= np.linalg.norm(rest, axis=1, keepdims=True)
        return np.concatenate([rest, value])

    return Flown(*(begin(name, value) for name, value in flown._asdict().items()))


def said_of(flight: RandomFlight, verdict: Verdict) -> str:
    """Say what the first finding names."""
    if not verdict.findings:
        return "nothing"
    first = verdict.findings[0]
    if first.component == "response":
        return "response"
    is_lost = flight.rotor and (first.component, first.element) == ("rotor", str(flight.rotor))
    return "the rotor" if is_lost else "another"


def wirings_table(told: Counter[tuple[str, str]]) -> str:
    """Return how many logs of each wiring have which first finding."""
    headings = ("wired", "logs", "response first", "per cent [95 %]", "the rotor", "another", "no finding")
    rows: list[tuple[str, ...]] = []
    for wiring in ALL:
        own = Counter({said: count for (name, said), count in told.items() if name == wiring})
        logs, hits = own.total(), own["response"]
        if logs:
            rotor = str(own["the rotor"]) if wiring == LOST else NOTHING
            others = rotor, str(own["another"]), str(own["nothing"])
            rows.append((wiring, str(logs), str(hits), write_share(hits, logs), *others))
    return markdown(headings, rows)


def make(options: argparse.Namespace) -> Tables:
    """Fly and judge; return the table."""
    told: Counter[tuple[str, str]] = Counter()
    for seed in range(options.seed, options.seed + options.flights):
        for wiring in ALL:
            for flight, verdict in judge_take_off(seed, wiring):
                told[wiring, said_of(flight, verdict)] += 1
    return {"wirings": wirings_table(told)}


if __name__ == "__main__":
    known = {
        "--flights": {"type": int, "default": 20, "help": "of each wiring"},
        "--seed": {"type": int, "default": 95000, "help": "of the first flight"},
    }
    sys.exit(run_study("diagnose.md", make, known))
