"""A vehicle that falls though its rotors are asked to carry it has lost the thrust of all of them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_replay.flight_log import FlightLog, Floats, Signal
from quadftc_replay.inspection.flight import prepare
from quadftc_replay.inspection.inspect import inspect
from quadftc_replay.inspection.thrust import thrust_findings

RATE, FAILS, HITS = 50.0, 10.0, 11.0  # Hz, s, s
HOVER = np.full(4, 0.4)
NONE, ALL = np.zeros(4), np.ones(4)


def falling(works: Floats, asked: Floats) -> FlightLog:
    """A vehicle that hovers until 10 s; then its rotors give the share ``works`` of what is asked for."""
    rng, time = np.random.default_rng(0), np.arange(0.0, HITS, 1.0 / RATE)
    late = (time > FAILS)[:, None]
    commands = np.where(late, asked, HOVER)
    thrust = (commands * np.where(late, works, 1.0)).mean(axis=1) / HOVER.mean() * STANDARD_GRAVITY
    force = np.stack([*np.zeros((2, len(time))), thrust], axis=1) + 0.2 * rng.standard_normal((len(time), 3))
    speed = np.cumsum(thrust - STANDARD_GRAVITY) / RATE
    return FlightLog(
        path=Path("falling"),
        format="test",
        gyros={
            "": Signal(time, 0.3 * np.sin(3.0 * time)[:, None] + 0.01 * rng.standard_normal((len(time), 3)))
        },
        accelerometers={"": Signal(time, force)},
        velocity=Signal(time, np.stack([*np.zeros((2, len(time))), speed], axis=1)),
        rotor_commands=Signal(time, commands),
    )


def test_vehicle_that_falls_while_its_rotors_are_asked_to_carry_it_has_lost_their_thrust():
    verdict = inspect(falling(NONE, np.full(4, 0.9))).verdict
    assert verdict.sentence.startswith("All rotors give no thrust from 10.")
    assert [(each.component, each.element, each.kind) for each in verdict.findings] == [("rotor", "", "off")]
    assert verdict.findings[0].size == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("works", "asked"),
    [
        (ALL, HOVER),  # it hovers on
        (ALL, np.full(4, 0.02)),  # it is told to fall
        (np.array([0.0, 1.0, 1.0, 1.0]), np.array([1.0, 0.25, 0.25, 0.25])),  # one rotor is lost
    ],
)
def test_rotors_that_give_what_they_are_asked_for_are_not_blamed(works: Floats, asked: Floats):
    assert thrust_findings(prepare(falling(works, asked))) == []


def test_vehicle_that_does_not_fall_has_its_thrust_whatever_the_accelerometer_says():
    log = falling(NONE, np.full(4, 0.9))
    assert log.velocity is not None
    log.velocity.value[:] = 0.0
    assert thrust_findings(prepare(log)) == []


@pytest.mark.parametrize(("asked", "ending"), [(0.9, "in flight"), (0.0, "switched off in the air")])
def test_rotors_that_stand_while_they_are_asked_to_turn_were_not_stopped(asked: float, ending: str):
    log = falling(NONE, np.full(4, asked))
    assert log.rotor_commands is not None
    time = log.rotor_commands.time
    speeds = Signal(time, np.where(time[:, None] > FAILS, 0.0, np.full(4, 700.0)))
    assert inspect(dataclasses.replace(log, rotor_speeds=speeds)).verdict.ending.kind == ending
