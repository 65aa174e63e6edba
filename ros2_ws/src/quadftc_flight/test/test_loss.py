"""The story of a lost flight: the moment, the healthy part that was named, the fault that was not."""

import dataclasses
from pathlib import Path

import numpy as np

from quadftc_flight.flight import unknown_flight
from quadftc_flight.loss import command_up_to_loss, loss_story, lost_at
from quadftc_model.samples import FAULTY, HEALTHY


def flown(lost_from=8.0):
    """Ten seconds of a rotor that fails at 6 s, while gyro y is named from 7 s on."""
    flight = unknown_flight(np.arange(1000) * 10_000_000, rotors=4)
    time = flight.time
    tilt = np.where(time >= lost_from, 1.2, 0.0)
    flight.gyro_state[:] = HEALTHY
    flight.gyro_state[time >= 7.0, 1] = FAULTY
    flight.rotor_state[:] = HEALTHY
    effectiveness = np.ones((1000, 4))
    effectiveness[time >= 6.0, 1] = 0.5
    return dataclasses.replace(
        flight,
        angles=np.stack([tilt, 0.0 * tilt, 0.0 * tilt], axis=-1),
        reference=np.zeros((1000, 3)),
        rotor_effectiveness=effectiveness,
    )


def test_story_names_moment_wrong_verdict_and_what_was_not_named():
    story = loss_story(flown())
    assert story == (
        "lost at 8.00 s: gyro y, healthy, was named from 7.00 s; rotor 2, faulty from 6.00 s, was not named"
    )


def test_a_flight_that_is_not_lost_has_no_story():
    assert lost_at(flown(lost_from=np.inf)) is None
    assert loss_story(flown(lost_from=np.inf)) == ""


def test_command_flies_only_up_to_the_loss_what_was_flown():
    command = command_up_to_loss(flown(lost_from=8.2), Path("results/my run"), "mine")
    flown_up_to = "--scheme mine --until 10s --out results/up_to_loss"
    assert command == f"quadftc run 'results/my run/scenario.yaml' {flown_up_to}"
