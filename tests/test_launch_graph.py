"""scripts/launch_graph.py: starts the graph either way, ends it cleanly, answers for its exit codes."""

from __future__ import annotations

import contextlib
import importlib.util
import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from sensor_msgs.msg import Imu

from bag_messages import messages_by_topic
from node_bench import NodeBench, imu_message
from quadftc_bags.bag import read_bag
from quadftc_flight.graph.composed import ComposedGraph
from quadftc_flight.graph.introduction import introduction
from quadftc_flight.graph.plan import EXECUTABLES, GraphPlan
from quadftc_flight.graph.processes import executable_path
from quadftc_flight.scenario import load_scenario, node_parameters
from quadftc_ros.qos import topic_profile
from quadftc_ros.scheduling import ORDINARY, Scheduling, SchedulingError, scheduled

SCRIPT = Path(__file__).resolve().parents[1] / "scripts" / "launch_graph.py"
BUSY = Path(__file__).parent / "scenarios" / "busy.yaml"
END = 60.0  # s; for a process to end on its own


def the_script():
    """The launcher as a module."""
    spec = importlib.util.spec_from_file_location("launch_graph", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    return script


@contextlib.contextmanager
def started(*arguments: object) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, str(SCRIPT), *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()  # does nothing to one that has ended


def finished(*arguments: object) -> tuple[int, str]:
    with started(*arguments) as process:
        _, errors = process.communicate(timeout=2 * END)
    assert "Traceback" not in errors
    return process.returncode, errors


@contextlib.contextmanager
def flying(*arguments: object) -> Iterator[subprocess.Popen[str]]:
    """The launcher, once its nodes command torques; none of them is left in the end."""
    with NodeBench("realtime") as bench:
        torques = bench.listen("torque/command")
        with started(*arguments) as process:
            bench.until(lambda: torques)
            yield process
    end = time.monotonic() + END
    while nodes_running() and time.monotonic() < end and process.returncode == -signal.SIGKILL:
        time.sleep(0.1)  # they notice by themselves
    assert nodes_running() == []


def nodes_running() -> list[str]:
    """Node processes of this workspace that are alive, by their command lines."""
    ours = {str(executable_path(*row)) for row in EXECUTABLES.values()}
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # ended meanwhile, or not ours to look at
            words = (process / "cmdline").read_bytes().decode().split("\0")
            domain = f"ROS_DOMAIN_ID={os.environ['ROS_DOMAIN_ID']}".encode()
            if ours & set(words) and domain in (process / "environ").read_bytes().split(b"\0"):
                found.append(" ".join(words))
    return found


def test_flight_of_a_scenario_in_processes_is_that_in_one_and_ends_with_0(
    tmp_path: Path, fly_graph, busy_scenario
):
    arguments = ("--graph", "processes", "--mode", "lockstep", "--record", tmp_path / "bag")
    code, errors = finished("--scenario", BUSY, *arguments)
    assert code == 0, errors
    assert f"ROS domain {os.environ['ROS_DOMAIN_ID']}, " in errors
    assert "sockets on 127.0.0.1; SROS2 off (--network opens it)" in errors  # who can find the graph
    assert nodes_running() == []
    composed = messages_by_topic(fly_graph(busy_scenario, "proposed")[0])
    processes = messages_by_topic(tmp_path / "bag")
    assert len(composed["/plant/attitude"]) == 500
    assert composed.keys() == processes.keys()
    assert [topic for topic in composed if composed[topic] != processes[topic]] == []


def other_domain() -> int:
    """A domain that no test session has: those are below (see conftest.py)."""
    return 81 + int(os.environ["ROS_DOMAIN_ID"]) % 20


@pytest.mark.parametrize("by", ["namespace", pytest.param("domain", marks=pytest.mark.thorough)])
def test_two_graphs_side_by_side_do_not_hear_each_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, by: str
):
    """Both fly the same scenario in lock-step at the same time, and give the bags that one alone gives."""
    both = ("--scenario", BUSY, "--mode", "lockstep", "--network")
    with started(*both, "--record", tmp_path / "one") as first:
        if by == "domain":
            monkeypatch.setenv("ROS_DOMAIN_ID", str(other_domain()))
        namespace = ("--namespace", "other") if by == "namespace" else ()
        code, errors = finished(*both, *namespace, "--record", tmp_path / "other")
        _, first_errors = first.communicate(timeout=2 * END)
    assert (first.returncode, code) == (0, 0), first_errors + errors
    assert "this machine and its network" in errors  # who can find the graph
    assert nodes_running() == []
    one, other = read_bag(tmp_path / "one"), read_bag(tmp_path / "other")
    for topic in ("plant/attitude", "torque/command", "control/status"):
        mine, theirs = one.series(topic), other.series(topic)
        assert len(mine) == len(theirs) > 300
        for field in ("vector", "error"):
            if field in mine.fields:
                assert (mine[field] == theirs[field]).all()


def test_signal_ends_the_graph_with_0():
    """In one process; in several, SIGTERM ends the nodes that were started again."""
    with flying("--graph", "composed") as process:
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=END)
    assert process.returncode == 0, errors
    assert "Traceback" not in errors


def test_death_of_a_node_ends_the_rest_and_is_reported():
    with flying("--graph", "processes") as process:
        os.kill(child_of(process, "disturbance_observer"), signal.SIGKILL)
        _, errors = process.communicate(timeout=END)
    assert process.returncode not in (0, None)
    assert "disturbance_observer" in errors


def child_of(process: subprocess.Popen[str], name: str) -> int:
    """Process id of a node of a launcher; 0: there is none."""
    for child in children_of(process):
        with contextlib.suppress(OSError):
            if f"/{name}".encode() in Path(f"/proc/{child}/cmdline").read_bytes():
                return int(child)
    return 0


def test_dead_node_is_started_again_if_asked_for_as_urgent_as_before():
    wanted = Scheduling(priority=5)
    try:
        with scheduled(wanted):
            urgency = ["--realtime-priority", "5"]
    except SchedulingError:  # the machine does not allow it
        wanted, urgency = ORDINARY, []
    with NodeBench("realtime") as bench:
        estimates = bench.listen("disturbance/estimate")
        with started("--graph", "processes", "--respawn", *urgency) as process:
            bench.until(lambda: estimates)
            victim = child_of(process, "disturbance_observer")
            os.kill(victim, signal.SIGKILL)
            bench.until(lambda: child_of(process, "disturbance_observer") not in (0, victim))
            estimates.clear()
            bench.until(lambda: estimates)
            restarted = child_of(process, "disturbance_observer")
            bench.until(lambda: os.sched_getparam(restarted).sched_priority == wanted.priority)
            process.send_signal(signal.SIGTERM)
            _, errors = process.communicate(timeout=END)
    assert process.returncode == 0, errors
    assert "Traceback" not in errors
    assert "disturbance_observer ended with exit code 137: starts again in 0.1 s" in errors
    assert nodes_running() == []


def test_nodes_end_when_their_launcher_is_killed():
    with flying("--graph", "processes") as process:
        process.kill()
        process.wait()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--scenario", "nowhere"), ("nowhere", "paper_faults")),
        (("--scenario", BUSY, "--scheme", "best"), ("best", "proposed")),
        (("--scheme", "proposed"), ("--scheme", "--scenario")),
        (("--respawn",), ("respawn", "processes")),
        (("--onboard",), ("--onboard", "--vehicle")),
        (("--onboard", "--vehicle", "x500", "--mode", "lockstep"), ("--onboard", "real time")),
        (("--remap", "imu/dat:=/a"), ("imu/dat", "imu/data")),
        (("--remap", "imu/data"), ("expected TOPIC:=OTHER",)),
        (("--namespace", "bad name"), ("bad name", "alphanumerics")),
        (("--scenario", BUSY, "--vehicle", "x500"), ("--vehicle", "scenario")),
        (("--params", "missing.yaml"), ("missing.yaml",)),
        (("--params", BUSY), ("busy.yaml", "ros__parameters")),
    ],
)
def test_wrong_input_ends_with_2_and_one_line(arguments, words: tuple[str, ...], monkeypatch, capsys):
    """In this process, which has imported everything already."""
    script = the_script()
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), *map(str, arguments)])
    code, errors = script.main(), capsys.readouterr().err
    assert code == 2
    assert len(errors.strip().splitlines()) == 1
    assert all(word in errors for word in words)


def children_of(process: subprocess.Popen[str]) -> list[str]:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text(encoding="ascii").split()
    return []


@pytest.mark.parametrize(
    ("number", "patience"),
    [
        (signal.SIGINT, 0),
        (signal.SIGTERM, 0),
        pytest.param(signal.SIGTERM, 1, marks=pytest.mark.thorough),
        (signal.SIGINT, 6),
    ],
)
def test_signal_while_the_nodes_are_starting_leaves_none_behind(number: signal.Signals, patience: int):
    """Whether none, one or all of the nodes have been started, and hardly one of them can hear yet."""
    with started("--graph", "processes") as process:
        end = time.monotonic() + END
        while len(children_of(process)) < patience and time.monotonic() < end:
            time.sleep(0.001)
        process.send_signal(number)
        _, errors = process.communicate(timeout=END)
    assert process.returncode in ((0,) if patience else (0, 130, -number)), errors
    assert "Traceback" not in errors or patience == 0  # Python itself, still importing
    assert nodes_running() == []


def test_second_signal_does_not_leave_nodes_behind():
    with flying("--graph", "processes") as process:
        for _ in range(2):
            process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=END)
    assert process.returncode in (0, 130, 128 + signal.SIGKILL), errors
    assert "Traceback" not in errors


@pytest.mark.parametrize("graph", ["composed", pytest.param("processes", marks=pytest.mark.thorough)])
def test_whole_number_where_ros_wants_another_type_is_named(tmp_path: Path, graph: str):
    (tmp_path / "graph.yaml").write_text("plant: {ros__parameters: {rate: 250}}\n", encoding="utf-8")
    code, errors = finished("--params", tmp_path / "graph.yaml", "--graph", graph)
    assert code == 2
    assert "error: rate = 250: expected a number with a decimal point" in errors
    assert nodes_running() == []


def test_parameter_file_gives_back_the_parameters_it_was_made_from(tmp_path: Path):
    parameters = node_parameters(load_scenario(BUSY), "proposed")
    plan = GraphPlan(parameters, "lockstep", "drone1")
    (tmp_path / "graph.yaml").write_text(plan.parameter_file(), encoding="utf-8")
    read = the_script().parameters_from_file(tmp_path / "graph.yaml")
    assert read == {node: plan.node_parameters(node) for node in plan.executables}


@pytest.mark.parametrize(("plant", "kind"), [("test_stand", "test_stand"), ("free_flight", "free_flight")])
def test_graph_is_that_of_its_plant_whatever_nodes_have_parameters(plant: str, kind: str):
    parameters = {"plant": {"plant": plant}, "position_controller": {"mode": "realtime"}}
    assert GraphPlan(parameters).plant == kind
    assert GraphPlan({"position_controller": {}}).plant == "test_stand"


def told(*arguments: object) -> str:
    """What the launcher says of a graph before it starts it."""
    script = the_script()
    options = script.parse([str(argument) for argument in arguments])
    plan = GraphPlan(script.node_parameters_of(options), namespace=options.namespace, onboard=options.onboard)
    return "\n".join(introduction(plan))


def test_recommended_observer_flies_by_default_and_setpoints_are_live():
    words = told("--namespace", "drone1")
    assert "flies: qball_x4, test stand; observer bank, disturbance observer exosystem" in words
    assert "scripts/quadftc set attitude roll=5deg --namespace drone1" in words
    assert "scripts/quadftc inject bias" in words
    assert "declares no faults" not in words


def test_imu_of_the_default_flight_has_noise_as_readings_without_look_stuck():
    from quadftc_sim.sensors import GRADES

    script = the_script()
    plant = script.node_parameters_of(script.parse([]))["plant"]
    file = Path(__file__).parents[1] / "ros2_ws/src/quadftc_bringup/config/graph.yaml"
    launched = script.parameters_from_file(file)["plant"]
    for name, value in GRADES["mems"].items():
        assert plant[f"imu.{name}"] == value
        assert launched[f"imu.{name}"] == value


def test_observer_without_states_is_announced():
    assert "observer sliding_mode declares no faults" in told("--scenario", BUSY, "--scheme", "proposed")


def test_on_board_there_is_neither_plant_nor_injector():
    words = told("--onboard", "--vehicle", "x500")
    assert "flies: x500, on board" in words
    assert "inject" not in words
    plan = GraphPlan({}, "realtime", onboard=True)
    assert {*plan.executables} == {"fault_observer", "controller", "disturbance_observer", "reference"}
    observer = plan.node_parameters("fault_observer")
    assert (observer["bank.feels_gravity"], observer["bank.attitude_from_gyro"]) == (False, True)


def test_on_board_a_real_imu_is_followed_and_recorded_by_its_usual_name(tmp_path: Path):
    remaps = ("imu/data:=/mavros/imu/data",)
    bag, stamps = tmp_path / "bag", itertools.count(10**9, 4 * 10**6)
    plan = GraphPlan({}, "realtime", bag=bag, onboard=True, remaps=remaps)
    with NodeBench("realtime") as bench:
        sender = bench.tester.create_publisher(Imu, "/mavros/imu/data", topic_profile("sensor", "realtime"))
        torques = bench.listen("torque/command")

        def send(_samples: int) -> bool:
            bench._executor.spin_once(timeout_sec=0.0)
            sender.publish(imu_message(next(stamps)))
            return len(torques) < 3

        with ComposedGraph(plan) as graph:
            graph.run(send)
    assert len(torques) >= 3
    assert read_bag(bag).topics["/imu/data"].count >= 3


def test_refused_start_leaves_no_bag_behind(tmp_path: Path):
    parameters = {"controller": {"controller": "nonsense"}}
    with pytest.raises(ValueError, match="nonsense"):
        ComposedGraph(GraphPlan(parameters, bag=tmp_path / "bag"))
    assert not (tmp_path / "bag").exists()
