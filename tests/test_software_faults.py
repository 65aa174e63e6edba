"""Nodes killed and stopped in flight: the vehicle stays where it should be.

The long form is `scripts/soak nodes`; docs/reliability.md has its results.
"""

from __future__ import annotations

import dataclasses
import random

import pytest

from quadftc_tools.soak.command import passed
from quadftc_tools.soak.node_judgement import KILL, Hit, Trial
from quadftc_tools.soak.nodes import (
    ALL,
    CHANGING_FAULT,
    DISTURBANCE,
    SENSOR_FAULT,
    STOP,
    flights_of,
    fly_and_judge,
)

# s; meanwhile the attitude runs on the gyro, and its error grows. A quiet machine starts a node in 1 s.
LONGEST_AWAY = 3.0


@pytest.mark.thorough
def test_flight_goes_on_when_nodes_are_killed_and_stopped():
    """Observers killed, while a sensor fault changes and in a disturbance; a controller stopped."""
    hits = [
        Hit("fault_observer", KILL, CHANGING_FAULT),
        Hit("disturbance_observer", KILL, DISTURBANCE),
        Hit("controller", STOP, SENSOR_FAULT),
    ]
    trials = fly_and_judge(hits, 1)
    if any(trial.void for trial in trials):
        reasons = "; ".join(trial.wrong for trial in trials if trial.void)
        pytest.skip(f"the flight was already lost before anything was hit: {reasons}")
    if trials[0].away_s > LONGEST_AWAY:
        pytest.skip(f"the machine is too busy: starting a node took {trials[0].away_s:.1f} s")
    assert [trial.wrong for trial in trials] == [""] * 3, trials
    assert all(trial.away_s > 0.2 for trial in trials[:2])  # they were away, and came back


def test_soak_hits_everything_in_turn():
    flights = list(flights_of(ALL, len(ALL), random.Random(1)))
    assert sorted(map(repr, (hit for hits in flights for hit in hits))) == sorted(map(repr, ALL))


def test_trial_that_went_wrong_before_anything_was_done_does_not_count():
    good = Trial("controller", STOP, DISTURBANCE, 0.2, 0.0, 0.1, 0.01, "")
    bad = dataclasses.replace(good, largest_deg=9.0, wrong="attitude off by 9.0 deg")
    assert passed([good])
    assert not passed([good, bad])
    assert passed([good, dataclasses.replace(bad, void=True)])
    assert not passed([])
