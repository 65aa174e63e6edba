"""Running nodes: the executor, stopping by signals, and what every executable does with wrong arguments."""

import os
import signal
import subprocess
import sys
import time

import pytest
from rclpy.clock import Clock
from rclpy.clock_type import ClockType

from node_bench import PATIENCE
from quadftc_ros.executor import LAUNCHER, Pace, StopSignals, make_executor

NODE = """
import signal, sys
from rclpy.node import Node
from quadftc_ros.executor import run_node

class Told(Node):
    def __init__(self):
        super().__init__("told")
        self.declare_parameter("size", 1.0)
        if self.get_parameter("size").value < 0.0:
            raise ValueError("size = -1: must not\\n be negative")
        self.create_timer(0.01, self.say)
    def say(self):
        print("runs", flush=True)
        if self.get_parameter("size").value > 9.0:
            raise RuntimeError("defect")
    def destroy_node(self):
        for number in map(int, sys.argv[1].split()):  # from the launcher, after that of the terminal
            signal.raise_signal(number)
        print("destroyed", flush=True)
        super().destroy_node()

sys.exit(run_node(Told))
"""


IMPORTED = """
import signal
signal.raise_signal(signal.{})
print("imported", flush=True)
"""


def start(*arguments, late="", **environment):
    """The node; while it shuts down, signals of the numbers ``late`` come."""
    return subprocess.Popen(
        [sys.executable, "-c", NODE, late, "--ros-args", *arguments],
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_first_signal_asks_and_the_second_interrupts(number):
    before = signal.getsignal(number)
    with StopSignals() as stop:
        assert not stop.requested
        os.kill(os.getpid(), number)
        assert stop.requested
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), number)
    assert signal.getsignal(number) is before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_a_node_in_order_and_a_second_changes_nothing(number):
    with start(late=f"{signal.SIGINT:d} {signal.SIGTERM:d}") as process:
        assert process.stdout.readline() == "runs\n"
        process.send_signal(number)
        process.send_signal(number)
        output, errors = process.communicate(timeout=PATIENCE)
    assert (process.returncode, errors) == (0, "")
    assert output.endswith("destroyed\n")


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_signal_ends_a_node_in_order_while_it_is_imported(tmp_path, name):
    (tmp_path / "slow_node.py").write_text(IMPORTED.format(name), encoding="utf-8")
    call = "import sys; from quadftc_ros.starting import executable; sys.exit(executable('slow_node')())"
    path = f"{tmp_path}{os.pathsep}{os.environ['PYTHONPATH']}"
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, "-c", call], env=environment, capture_output=True, check=False, timeout=PATIENCE
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-p", "size:=-1.0"], "error: size = -1: must not be negative"),
        (["-p", "size:=big"], "size"),
        (["-p", "size"], "error: ROS arguments: "),
        (["--params-file", "/nowhere.yaml"], "/nowhere.yaml"),
    ],
)
def test_wrong_argument_is_one_line_and_exit_code_2(arguments, words):
    with start(*arguments) as process:
        output, errors = process.communicate(timeout=PATIENCE)
    lines = [line for line in errors.splitlines() if "[rcl" not in line]  # what rcl logs beside it
    assert (process.returncode, output) == (2, "")
    assert len(lines) == 1
    assert words in lines[0]


def test_defect_in_a_callback_is_not_hidden():
    with start("-p", "size:=10.0") as process:
        output, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert "RuntimeError: defect" in errors
    assert output.endswith("destroyed\n")


def test_node_stops_when_its_launcher_is_no_more():
    with start(**{LAUNCHER: "-1"}) as process:  # which is nobody's parent
        output, errors = process.communicate(timeout=PATIENCE)
    assert (process.returncode, errors) == (0, "")
    assert output.endswith("destroyed\n")


class Clockwork:
    """Something to be done every 10 ms of the monotonic clock, a number of times."""

    def __init__(self, count, period=0.01):
        self.period_ns = round(period * 1e9)
        self.begin_ns = time.monotonic_ns()
        self.left, self.times = count, []

    @property
    def due_ns(self):
        done = len(self.times)
        return self.begin_ns + (done + 1) * self.period_ns if done < self.left else sys.maxsize

    unanswered = True

    def tick(self):
        self.times.append(time.monotonic_ns())


@pytest.mark.parametrize("poll", [False, True])
def test_pace_acts_when_it_is_due_and_serves_the_nodes_meanwhile(bench, poll):
    executor = make_executor(bench.context)
    served = []
    timer = bench.tester.create_timer(0.002, lambda: served.append(1))
    executor.add_node(bench.tester)
    both = [Clockwork(5), Clockwork(3, period=0.025)]
    pace, end = Pace(executor, both, poll), time.monotonic() + PATIENCE
    while any(len(each.times) < each.left for each in both) and time.monotonic() < end:
        pace.spin(0.02)
    executor.remove_node(bench.tester)
    executor.shutdown()
    bench.tester.destroy_timer(timer)
    assert [len(each.times) for each in both] == [5, 3]
    for each in both:  # never before its time, and none left out however late
        due = [each.begin_ns + (k + 1) * each.period_ns for k in range(each.left)]
        assert all(done >= wanted for done, wanted in zip(each.times, due, strict=True))
    assert len(served) >= 5


def test_pace_ends_with_its_time_when_nothing_is_due(bench):
    executor = make_executor(bench.context)
    begin = time.monotonic()
    Pace(executor, [Clockwork(0)], poll=False).spin(0.05)
    executor.shutdown()
    assert 0.05 <= time.monotonic() - begin < PATIENCE


def test_clock_that_is_set_back_wakes_an_executor_and_its_timers(bench, monkeypatch):
    executor = make_executor(bench.context)
    timer = bench.tester.create_timer(
        2 * PATIENCE, lambda: None, clock=Clock(clock_type=ClockType.STEADY_TIME)
    )
    executor.add_node(bench.tester)
    executor.spin_once(timeout_sec=0.1)
    before, begin = timer.time_until_next_call(), time.monotonic()
    monkeypatch.setattr(time, "time_ns", lambda real=time.time_ns: real() - 3_600_000_000_000)
    while timer.time_until_next_call() <= before and time.monotonic() - begin < PATIENCE:
        executor.spin_once(timeout_sec=PATIENCE)
    executor.remove_node(bench.tester)
    executor.shutdown()
    bench.tester.destroy_timer(timer)
    assert time.monotonic() - begin < PATIENCE
