# pyright: basic
"""The flights of the study of rotors, drawn by their seeds: wind, gusts, centre of mass, and a fault."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from quadftc_flight.scenario import Scenario, parse_scenario

RATE, ONSET, DURATION = 250, 8.0, 10.5  # Hz, s, s
SCENARIO = """
name: rotors
duration: {duration} s
rate: 250 Hz
seed: {seed}
vehicle: x500
plant: {{kind: free_flight, start: [2, 0, 1.5]}}
sensors: {{grade: mems}}
position_sensor: {{grade: mocap}}
trajectories:
  - {{kind: circle, centre: [0, 0, 1.5], radius: 2, speed: {speed} m/s, start: 1 s, stop: {duration} s}}
wind:
  - {{kind: constant, velocity_mean: [{east:.4f}, {north:.4f}, 0]}}
  - {{kind: dryden, wind_speed: 5, airspeed: 4, height: 6, history: {wind}}}
disturbances:
  - {{kind: gusts, std_dev: [0.01195, 0.01195, 0.022], history: {gusts}}}
  - {{kind: constant, amplitude: [{roll:.5f}, {pitch:.5f}, 0]}}
faults: [{faults}]
schemes:
  isolating:
    observer: isolating
    disturbance_observer: exosystem
    controller: ismc
    position_controller: geometric
  undiagnosed:
    disturbance_observer: exosystem
    controller: ismc
    position_controller: geometric
"""


class Case(NamedTuple):
    """A flight, and what is wrong with it."""

    scenario: Scenario
    component: str  # a sensor, rotor, or nothing
    rotor: int  # 0, 1, ...; of a faulty rotor
    loss: float  # share of its thrust


def case_of(seed: int, component: str, make: Any, duration: float = DURATION) -> Case:
    """Draw a flight; ``make`` draws the text of its fault, its rotor and the loss."""
    rng = np.random.default_rng(seed)
    wind, offset = rng.uniform(0.0, 2.0 * np.pi, 2)
    mean, torque = rng.uniform(0.0, 4.0), 0.005 * 20.24  # m/s; N m: 5 mm times the weight
    text, rotor, loss = make(rng)
    scenario = parse_scenario(
        SCENARIO.format(
            duration=duration,
            seed=seed,
            speed=2.0 if rng.integers(2) else 0.01,
            east=mean * np.cos(wind),
            north=mean * np.sin(wind),
            wind=rng.integers(10**6),
            gusts=rng.integers(10**6),
            roll=torque * np.cos(offset),
            pitch=torque * np.sin(offset),
            faults=text,
        )
    )
    return Case(scenario, component, rotor, loss)


def weak_rotor(low: float, high: float, rise: float = 0.0) -> Any:
    """Return what draws a loss between two shares; all of it: the rotor is off."""

    def make(rng: np.random.Generator) -> tuple[str, int, float]:
        rotor, loss = int(rng.integers(4)), float(rng.uniform(low, high))
        if loss >= 1.0:
            return f"{{kind: 'off', rotors: [{rotor + 1}], start: {ONSET} s}}", rotor, 1.0
        value = f"value: {loss:.4f}, rise: {rise}"
        return f"{{kind: loss, rotors: [{rotor + 1}], {value}, start: {ONSET} s}}", rotor, loss

    return make


def faulty_sensor(sensor: str, kind: str, key: str, axes: Sequence[str], bounds: Any, unit: str) -> Any:
    """Return what draws a fault of a sensor."""

    def make(rng: np.random.Generator) -> tuple[str, int, float]:
        size = rng.uniform(*bounds) * rng.choice([-1.0, 1.0])
        value = f", {key}: {size:.4f}{unit}" if key else ""
        which = axes[int(rng.integers(len(axes)))]
        text = f"{{kind: {kind}, channel: {sensor}, axes: {which}{value}, start: {ONSET} s}}"
        return text, -1, 0.0

    return make
