"""Each node by itself, as ``ros2 run`` starts it: its topics, a parameter, and a clean end."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from node_bench import NodeBench
from quadftc_flight.graph.plan import EXECUTABLES
from quadftc_flight.graph.processes import executable_path
from quadftc_ros.topics import GRAPHS, NODES

END = 30.0  # s; for a process to end on its own
# node -> a parameter that can be changed in flight, a good value, a bad one, and a word of the refusal
CHANGES = {
    "fault_observer": ("bank.level", 0.98, 2.0, "level"),
    "disturbance_observer": ("exosystem.bandwidth", 12.0, -1.0, "bandwidth"),
    "controller": ("ismc.k_c2", [7.0, 7.0, 5.0], [-1.0, 7.0, 5.0], "k_c2"),
}

ALL_NODES = """
import sys
from rclpy.context import Context
from quadftc_flight.graph.composed import NODE_CLASSES
context = Context()
context.init(args=[])
for node_class in NODE_CLASSES.values():
    node_class(context=context).destroy_node()
context.try_shutdown()
print(sorted({"jax", "scipy"} & {name.partition(".")[0] for name in sys.modules}))
"""


@contextmanager
def running(package: str, executable: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """An installed executable, which is what ``ros2 run`` would start."""
    command = [str(executable_path(package, executable)), *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def ended_well(process: subprocess.Popen[str]) -> None:
    """Stop it by SIGINT; it must exit with 0 and say nothing of errors."""
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=END)
    assert process.returncode == 0, errors
    assert "Traceback" not in errors
    assert "FATAL" not in errors


def published_by(bench: NodeBench, node: str) -> set[str]:
    """Full names of the topics that a node publishes; none while it has not been discovered."""
    try:
        found = bench.tester.get_publisher_names_and_types_by_node(node, "/")
    except RuntimeError:
        return set()
    return {name for name, _ in found}


@pytest.mark.parametrize("node", EXECUTABLES)
def test_node_runs_alone_and_stops_cleanly(bench: NodeBench, node: str):
    kind = "test_stand" if node in NODES["test_stand"] else "free_flight"
    rows = [row for row in GRAPHS[kind].values() if node in row.publishers and row.qos != "clock"]
    wanted = {bench.tester.resolve_topic_name(row.name) for row in rows}
    assert len(wanted) > 1
    with running(*EXECUTABLES[node]) as process:
        bench.until(lambda: wanted <= published_by(bench, node))
        if node in CHANGES:
            name, good, bad, word = CHANGES[node]
            assert bench.set_parameter(node, name, good).successful
            refusal = bench.set_parameter(node, name, bad)
            assert not refusal.successful
            assert word in refusal.reason or "range" in refusal.reason
            assert bench.get_parameter(node, name) == pytest.approx(good)
        ended_well(process)


def test_recorder_runs_alone_and_leaves_a_bag(bench: NodeBench, tmp_path: Path):
    bag = tmp_path / "bag"
    with running("quadftc_ros", "recorder", "--ros-args", "-p", f"directory:={bag}") as process:
        bench.until(lambda: "/diagnostics" in published_by(bench, "recorder"))
        ended_well(process)
    assert (bag / "metadata.yaml").is_file()
    assert (bag / "bag_0.mcap").stat().st_size > 0


@pytest.mark.parametrize(
    ("node", "setting", "words"),
    [
        ("fault_observer", "observer:=nonsense", ("nonsense", "sliding_mode")),
        ("controller", "vehicle:=submarine", ("submarine", "qball_x4")),
        ("plant", "disturbances:=['constant amplitude=1lb']", ("amplitude", "Nm")),
        ("fault_injector", "faults:=['bias axes=sideways']", ("sideways", "roll")),
        ("reference", "references:=['step rise=-1']", ("rise",)),
    ],
)
def test_wrong_parameter_ends_the_node_with_one_line(node: str, setting: str, words: tuple[str, ...]):
    with running(*EXECUTABLES[node], "--ros-args", "-p", setting) as process:
        _, errors = process.communicate(timeout=END)
    assert process.returncode == 2
    assert len(errors.strip().splitlines()) == 1
    assert all(word in errors for word in words)


def test_unknown_parameter_is_warned_of_and_the_node_runs(bench: NodeBench):
    setting = "bank.rotor_lagg:=0.02"
    with running(*EXECUTABLES["fault_observer"], "--ros-args", "-p", setting) as process:
        bench.until(lambda: "/fault/estimate" in published_by(bench, "fault_observer"))
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=END)
    assert process.returncode == 0
    assert "parameter 'bank.rotor_lagg' was given" in errors
    assert "did you mean 'bank.rotor_lag'?" in errors


def test_nodes_whose_laws_are_compiled_load_neither_jax_nor_scipy_and_compile_nothing():
    for _ in range(2):  # the first time something may have to be compiled
        done = subprocess.run([sys.executable, "-c", ALL_NODES], capture_output=True, text=True, check=True)
        assert done.stdout == "[]\n"
    assert "compiling" not in done.stderr
