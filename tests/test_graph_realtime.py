"""Real time: flights by the wall clock, in one process and in several, also when a node falls silent."""

from __future__ import annotations

import os
import signal

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState

from node_bench import NodeBench
from quadftc_bags.bag import read_bag
from quadftc_flight.graph import following
from quadftc_flight.graph.plan import GraphError, GraphPlan
from quadftc_flight.graph.processes import ProcessGraph
from quadftc_flight.scenario import find_scenario, load_scenario, node_parameters, with_duration
from quadftc_msgs.msg import ControlStatus
from quadftc_msgs.srv import InjectFault
from quadftc_ros.scheduling import Scheduling

DURATION = 1.0  # s
RATE = 250  # Hz
PERIOD_NS = 4_000_000
TRUTH = ("plant/attitude", "plant/rate", "disturbance/applied")
VECTORS = {
    "fault/injected": "vector",
    "fault/estimate": "vector",
    "disturbance/estimate": "vector",
    "torque/command": "vector",
    "attitude/reference": "angles",
    "control/status": "error",
    "imu/corrected": "orientation_xyzw",
}


@pytest.fixture(scope="module")
def paper_scenario():
    return with_duration(load_scenario(find_scenario("paper_faults")), DURATION)


@pytest.mark.parametrize(
    ("graph", "wait"), [("composed", "sleep"), ("composed", "poll"), ("processes", "sleep")]
)
def test_flight_in_real_time_is_whole_and_at_the_rate(fly_graph, paper_scenario, graph, wait):
    options = {"graph": graph, "scheduling": Scheduling(wait)}
    directory, summary = fly_graph(paper_scenario, "proposed", mode="realtime", **options)
    bag = read_bag(directory)
    for topic in TRUTH:
        stamps = bag.series(topic).stamp_ns
        # all of them, unless the machine was too busy to listen for a while
        assert 0.9 * DURATION * RATE < len(stamps) <= DURATION * RATE, topic
        assert np.all(np.diff(stamps) > 0), topic
        assert np.all(np.diff(stamps) % PERIOD_NS == 0), topic
    first_ns = bag.series("plant/attitude").stamp_ns[0]
    for topic, field in VECTORS.items():
        series = bag.series(topic)
        assert len(series) > 0.5 * DURATION * RATE, topic  # best effort, so a busy machine loses more
        assert np.all((series.stamp_ns - first_ns) % PERIOD_NS == 0), topic
        assert np.all(np.isfinite(series[field])), topic
    assert summary["mode"] == "realtime"
    assert summary["wall_time_s"] > 0.9 * DURATION


def test_fault_injected_in_flight_is_estimated_and_a_silent_diagnosis_is_flown_without_until_it_is_back():
    """The fault observer is deactivated. Frozen, it could hold a lock of the transport others wait for."""
    plan = GraphPlan({"fault_observer": {"observer": "supervised"}, "plant": {"rate": 100.0}}, "realtime")
    with NodeBench("realtime") as bench, ProcessGraph(plan) as graph:
        truth, estimates = bench.listen("fault/injected"), bench.listen("fault/estimate")
        states = bench.listen("control/status")
        assert graph.wait_until_connected()
        bench.connect()
        answers = []

        def change(label):
            request = {"transition": Transition(label=label)}
            answers.append(bench.call(ChangeState, "fault_observer/change_state", **request).success)

        def watch(_samples):
            bench.until(lambda: states and states[-1].mode == ControlStatus.MODE_FULL)
            request = {"kind": "bias", "channel": "attitude", "axes": ["roll"]}
            request |= {"parameter_names": ["value"], "parameter_values": [0.05]}
            answers.append(bench.call(InjectFault, "fault_injector/inject", **request).success)
            bench.until(lambda: abs(estimates[-1].vector.x - 0.05) < 0.005)
            change("deactivate")
            bench.until(lambda: states[-1].mode == ControlStatus.MODE_NO_DIAGNOSIS)
            change("activate")
            bench.until(lambda: states[-1].mode == ControlStatus.MODE_FULL)
            return False

        graph.run(watch)
    assert answers == [True] * 3
    assert truth[-1].vector.x == pytest.approx(0.05, abs=1e-9)
    assert graph.exit_code == 0


def test_flight_ends_with_an_error_when_the_plant_hangs(paper_scenario, monkeypatch):
    """The diagnostics of the other nodes go on; they must not pass for a flight."""
    monkeypatch.setattr(following, "STALL_TIMEOUT", 2.0)  # s; the plant tells its samples every second
    plan = GraphPlan(node_parameters(paper_scenario), "realtime")
    with ProcessGraph(plan) as graph:
        plant, stopped = graph.children.process_ids()["plant"], []

        def follow(samples: int) -> bool:
            if samples and not stopped:
                stopped.append(samples)
                os.kill(plant, signal.SIGSTOP)
            return True

        try:
            with pytest.raises(GraphError, match=r"the flight stalled after .* no new sample"):
                graph.run(follow)
        finally:
            os.kill(plant, signal.SIGCONT)
    assert stopped
