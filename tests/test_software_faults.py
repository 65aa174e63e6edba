"""Nodes killed and stopped in flight, clocks that jump: the vehicle stays where it should be.

The long form of the first is `scripts/soak nodes`; docs/reliability.md has its results.
"""

from __future__ import annotations

import dataclasses
import random

import numpy as np
import pytest

from message_objects import ImuWriter, reference_of
from quadftc_control.controller_node import ControllerNode
from quadftc_control.reference_node import ReferenceNode
from quadftc_fdi.disturbance_observer_node import DisturbanceObserverNode
from quadftc_fdi.fault_observer_node import FaultObserverNode
from quadftc_flight.scenario import node_parameters
from quadftc_model.rotations import wrap
from quadftc_ros.conversions import stamp_of
from quadftc_sim.assembly import injector_from, simulator_from
from quadftc_tools.soak.node_flight import (
    CHANGING_FAULT,
    DISTURBANCE,
    KILL,
    SENSOR_FAULT,
    STOP,
    Hit,
    scenario_of,
)
from quadftc_tools.soak.node_judgement import BACK, LARGEST, WITHIN, Trial
from quadftc_tools.soak.nodes import ALL, flights_of, flown, summary, table

RATE = 250  # Hz
NODES = {
    "fault_observer": FaultObserverNode,
    "disturbance_observer": DisturbanceObserverNode,
    "controller": ControllerNode,
    "reference": ReferenceNode,
}


def test_flight_goes_on_when_nodes_are_killed_and_stopped():
    """Observers killed, while a sensor fault changes and in a disturbance; a controller stopped."""
    hits = [
        Hit("fault_observer", KILL, CHANGING_FAULT),
        Hit("disturbance_observer", KILL, DISTURBANCE),
        Hit("controller", STOP, SENSOR_FAULT),
    ]
    trials = flown(hits, 1)
    if any(trial.void for trial in trials):
        pytest.skip("this machine cannot carry the flight now")
    assert [trial.wrong for trial in trials] == [""] * 3, trials
    assert all(trial.away > 0.2 for trial in trials[:2])  # they were away, and came back
    assert summary(trials, 1)["survived"] == table(trials).row_count - 1 == 3


def test_soak_hits_everything_in_turn():
    flights = list(flights_of(ALL, len(ALL), random.Random(1)))
    assert sorted(map(repr, (hit for hits in flights for hit in hits))) == sorted(map(repr, ALL))


def test_trial_that_went_wrong_before_anything_was_done_does_not_count():
    good = Trial("controller", STOP, DISTURBANCE, 0.2, 0.0, 0.1, 0.01, "")
    bad = dataclasses.replace(good, largest=9.0, wrong="attitude off by 9.0 deg")
    assert summary([good, bad], 1)["passed"] is False
    found = summary([good, dataclasses.replace(bad, void=True)], 1)
    assert (found["passed"], found["trials"], found["void"], found["worst_error_deg"]) == (True, 1, 1, 0.2)
    assert summary([], 1)["passed"] is False


@pytest.mark.parametrize(
    ("jump", "stress"),
    [(0.5, SENSOR_FAULT), (5.0, DISTURBANCE), (-5.0, DISTURBANCE), (-0.1, DISTURBANCE)],
)
def test_clock_that_jumps_in_lockstep_does_little(lockstep_bench, jump, stress):
    """The test is the vehicle; from 7 s on, all stamps are off by the jump [s]."""
    bench = lockstep_bench
    parameters = node_parameters(scenario_of([Hit("controller", STOP, stress)], 1))
    for name, node in NODES.items():
        bench.run(node, **{key: value for key, value in parameters[name].items() if value != []})
    send, torques = bench.talk("imu/data"), bench.listen("torque/command")
    references = bench.listen("attitude/reference")
    bench.connect()
    simulator = simulator_from(parameters["plant"], 10_000_000_000)
    injector = injector_from(parameters["fault_injector"])
    message, errors, emission = ImuWriter(), [], simulator.start()
    for k in range(12 * RATE):
        if k > 0:
            torque = torques[-1].vector if torques else None
            command = np.zeros(3) if torque is None else np.array([torque.x, torque.y, torque.z])
            emission = simulator.advance(command)
        if emission.sample is None:
            continue
        stamp_ns = emission.sample_stamp_ns + (round(jump * 1e9) if k >= 7 * RATE else 0)
        sample = injector.apply(emission.sample_stamp_ns, emission.sample).sample
        assert sample is not None
        count = len(torques)
        send(message(stamp_ns, sample))
        bench.until(lambda: len(torques) > count)  # noqa: B023
        assert stamp_of(torques[-1]) == stamp_ns
        errors.append(np.max(np.abs(wrap(emission.angles - reference_of(references[-1]).angles))))
    errors = np.degrees(errors)
    after = errors[-5 * RATE :]
    assert np.max(errors) < LARGEST
    assert np.all(after[round(WITHIN * RATE) :] < BACK)
