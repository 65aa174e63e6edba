"""Every node can rest and go on, by the standard lifecycle services."""

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState

from node_bench import NodeBench, imu_message, vector_message
from quadftc_ros.node import GraphNode
from quadftc_ros.recorder_node import RecorderNode
from quadftc_ros.wire import ImuWire, imu_of, vector_of

SECOND = 1_000_000_000  # ns


class Passing(GraphNode):
    """Passes samples on; named as the fault observer, whose topics it has."""

    def __init__(self, **kwargs):
        super().__init__("fault_observer", **kwargs)
        self.seen, self.kept, self.restarts = [], [], 0
        self._publish, self._message = self.publishes("imu/corrected"), ImuWire()
        self.driven_by("imu/data", self.take, restart=self.restart, decode=imu_of)
        self.reads("gyro/kept", lambda stamp_ns, value: self.kept.append(stamp_ns), decode=vector_of)
        self.ready()

    def restart(self):
        self.restarts += 1

    def take(self, stamp_ns, sample):
        self.seen.append(stamp_ns)
        self._publish(self._message(stamp_ns, sample))
        self.sampled(stamp_ns)


class Bench:
    """The node with what goes in and comes out."""

    def __init__(self, bench, **parameters):
        self.bench, self.node = bench, bench.run(Passing, **parameters)
        self.send, self.keep = bench.talk("imu/data"), bench.talk("gyro/kept")
        self.out = bench.listen("imu/corrected")
        bench.connect()

    @property
    def state(self):
        return self.bench.call(GetState, "fault_observer/get_state").current_state.label

    def change(self, label="", number=0):
        transition = Transition(label=label, id=number)
        return self.bench.call(ChangeState, "fault_observer/change_state", transition=transition).success

    def fly(self, stamp_ns):
        """Have the node take a sample, and what the topic gyro/kept brings."""
        self.send(imu_message(stamp_ns))
        self.keep(vector_message(stamp_ns))
        self.bench.until(lambda: self.node.kept[-1:] == [stamp_ns])
        self.bench.call(GetState, "fault_observer/get_state")  # whatever was on its way has come


def test_node_that_rests_takes_and_gives_nothing_but_notes_what_comes_only_once(bench):
    flown, status = Bench(bench), bench.watch_diagnostics()
    assert flown.state == "active"
    flown.fly(SECOND)
    assert flown.change("deactivate")
    assert flown.state == "inactive"
    flown.fly(2 * SECOND)
    bench.until(lambda: "fault_observer: lifecycle" in status)
    assert status["fault_observer: lifecycle"].message == "not active: publishes nothing"
    assert flown.change("activate")
    flown.fly(3 * SECOND)
    bench.until(lambda: len(flown.out) == 2)
    assert flown.node.seen == [SECOND, 3 * SECOND]
    assert flown.node.kept == [SECOND, 2 * SECOND, 3 * SECOND]
    assert flown.node.restarts == 0


def test_cleanup_forgets_and_a_node_without_autostart_waits_for_its_orders(bench):
    flown = Bench(bench, autostart=False)
    assert flown.state == "unconfigured"
    flown.fly(SECOND)
    for label in ("configure", "activate", "deactivate", "cleanup", "configure", "activate"):
        assert flown.change(label)
    flown.fly(2 * SECOND)
    assert (flown.node.seen, flown.node.restarts) == ([2 * SECOND], 1)
    assert flown.change("shutdown")
    assert flown.state == "finalized"


def test_transition_that_the_state_does_not_have_is_refused_and_the_node_lives(bench):
    flown = Bench(bench)
    ways = bench.call(GetAvailableTransitions, "fault_observer/get_available_transitions")
    labels = {each.transition.label for each in ways.available_transitions}
    assert labels == {"deactivate", "shutdown"}
    for given in ({"label": "activate"}, {"label": "nonsense"}, {"number": 3}, {"number": 200}):
        assert not flown.change(**given)
    assert flown.state == "active"


def test_node_must_act_in_a_flight_in_lockstep(lockstep_bench):
    flown = Bench.__new__(Bench)
    flown.bench, flown.node = lockstep_bench, lockstep_bench.run(Passing)
    send = lockstep_bench.talk("imu/data")
    lockstep_bench.connect()
    assert flown.change("deactivate")
    assert flown.change("activate")
    send(imu_message(SECOND))
    lockstep_bench.until(lambda: flown.node.seen)
    assert not flown.change("deactivate")
    assert flown.state == "active"


@pytest.mark.parametrize("autostart", [True, False])
def test_node_that_is_destroyed_leaves_the_graph(autostart):
    with NodeBench() as bench:
        node = bench.run(Passing, autostart=autostart)
        bench.until(lambda: "fault_observer" in bench.tester.get_node_names())
        bench._nodes.remove(node)
        bench._executor.remove_node(node)
        node.destroy_node()
        bench.until(lambda: "fault_observer" not in bench.tester.get_node_names())


def test_recorder_that_rests_stores_nothing(tmp_path):
    with NodeBench() as bench:
        node = bench.run(RecorderNode, directory=str(tmp_path / "bag"))
        send = bench.talk("imu/data")
        bench.connect()
        stored = lambda: node.flush() and node.status.counts.get("/imu/data")  # noqa: E731
        send(imu_message(SECOND))
        bench.until(lambda: stored() == 1)
        node.trigger_deactivate()
        send(imu_message(2 * SECOND))
        bench.call(GetState, "recorder/get_state")  # the sample has come
        node.trigger_activate()
        send(imu_message(3 * SECOND))
        bench.until(lambda: stored() == 2)
        assert node.finish().counts["/imu/data"] == 2
