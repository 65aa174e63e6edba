"""Clocks that jump in lock-step: the vehicle stays where it should be."""

from __future__ import annotations

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
from quadftc_tools.soak.node_judgement import BACK, LARGEST, WITHIN, Hit
from quadftc_tools.soak.nodes import DISTURBANCE, SENSOR_FAULT, STOP, scenario_of

RATE = 125  # Hz
NODES = {
    "fault_observer": FaultObserverNode,
    "disturbance_observer": DisturbanceObserverNode,
    "controller": ControllerNode,
    "reference": ReferenceNode,
}


@pytest.mark.parametrize(
    ("jump", "stress"),
    [
        (0.5, SENSOR_FAULT),
        (-5.0, DISTURBANCE),
        *(pytest.param(jump, DISTURBANCE, marks=pytest.mark.thorough) for jump in (5.0, -0.1)),
    ],
)
def test_clock_that_jumps_in_lockstep_does_little(lockstep_bench, jump, stress):
    """The test is the vehicle; from 7 s on, all stamps are off by the jump [s]."""
    bench = lockstep_bench
    parameters = node_parameters(scenario_of([Hit("controller", STOP, stress)], 1))
    parameters["plant"]["rate"] = float(RATE)
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
