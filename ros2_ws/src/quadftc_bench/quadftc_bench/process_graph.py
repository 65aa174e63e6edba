"""The graph as processes: one for each node, as ``ros2 run`` starts them, with the recorder and the watch in this one."""

from __future__ import annotations

import signal
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import rclpy
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from quadftc_bench.graph_plan import CONNECT_TIMEOUT, EXECUTABLES, STALL_TIMEOUT, GraphError, GraphPlan, drain
from quadftc_ros.executor import make_executor
from quadftc_ros.node import missing_connections
from quadftc_ros.qos import topic_profile
from quadftc_ros.recorder_node import RecorderNode

STOP_TIMEOUT = 10.0  # s; from SIGINT to SIGKILL of a process that we started


def executable_path(package: str, executable: str) -> Path:
    """Path of an installed executable, which is what ``ros2 run`` would start.

    Raises
    ------
    GraphError
        If the package or the executable is not installed.
    """
    try:
        path = Path(get_package_prefix(package), "lib", package, executable)
    except PackageNotFoundError:
        raise GraphError(f"package {package} is not installed; run scripts/setup") from None
    if not path.is_file():
        raise GraphError(f"{path} is missing; run scripts/setup")
    return path


class ProcessGraph:
    """The nodes of a plan as processes; a context manager. It ends only what it started."""

    def __init__(self, plan: GraphPlan) -> None:
        self.plan = plan
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self._counts: dict[str, dict[str, int]] = {}
        self._finished, self._samples = False, 0
        self._folder = tempfile.TemporaryDirectory(prefix="quadftc_")
        self._context = rclpy.Context()
        self._context.init()
        self._executor = make_executor("events", self._context)
        common = {"context": self._context, "namespace": plan.namespace or None, "use_global_arguments": False}
        self.recorder: RecorderNode | None = None
        self._node = Node("launch_graph", **common)
        try:
            self._node.create_subscription(
                DiagnosticArray, "/diagnostics", self._on_diagnostics, topic_profile("reliable", plan.mode)
            )
            self._starter = self._node.create_client(Trigger, "plant/start")
            self._executor.add_node(self._node)
            if plan.bag is not None:
                overrides = [Parameter(n, value=v) for n, v in plan.recorder_parameters().items()]
                self.recorder = RecorderNode(parameter_overrides=overrides, **common)
                self._executor.add_node(self.recorder)
            self._start_processes()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> ProcessGraph:
        """Return the graph."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the graph."""
        self.close()

    def run(self, progress: Callable[[int], bool] | None = None) -> float:
        """Fly until the plant's duration is over; return the wall time of the flight [s].

        Parameters
        ----------
        progress : callable, optional
            Called with the number of samples so far, often; the flight ends early when it returns False.

        Raises
        ------
        GraphError
            If the nodes do not find each other, one of them ends, or the flight stalls.
        """
        self._wait_until_connected()
        begin = moved = time.monotonic()
        self._begin_flight()
        samples = -1
        while not self._finished:
            self._executor.spin_once(timeout_sec=0.1)
            self._check_alive()
            stored = 0 if self.recorder is None else self.recorder.received
            if progress is not None and not progress(self._samples):
                break
            if stored != samples or self.recorder is None:
                samples, moved = stored, time.monotonic()
            elif time.monotonic() - moved > STALL_TIMEOUT:
                raise GraphError("the flight stalled: nothing was recorded any more")
        wall = time.monotonic() - begin
        recorder = self.recorder
        if recorder is not None:
            drain(lambda: recorder.received, lambda timeout: self._executor.spin_once(timeout_sec=timeout), self.plan.mode)
        return wall

    def stop(self) -> int:
        """Send SIGINT to every process, wait, and return the worst exit code (0: all ended well)."""
        for process in self.processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        worst = 0
        for process in self.processes.values():
            try:
                code = process.wait(STOP_TIMEOUT)
            except subprocess.TimeoutExpired:
                process.kill()
                code = process.wait()
            worst = max(worst, abs(code))
        return worst

    def close(self) -> None:
        """End the processes, close the bag."""
        self.stop()
        if self.recorder is not None:
            self.recorder.finish()
        self._executor.shutdown()
        for node in (self.recorder, self._node):
            if node is not None:
                node.destroy_node()
        self.recorder = None
        self._context.try_shutdown()
        self._folder.cleanup()

    def _start_processes(self) -> None:
        file = Path(self._folder.name, "parameters.yaml")
        file.write_text(self.plan.parameter_file(), encoding="utf-8")
        space = ["-r", f"__ns:=/{self.plan.namespace.strip('/')}"] if self.plan.namespace else []
        for name, (package, executable) in EXECUTABLES.items():
            command = [str(executable_path(package, executable)), "--ros-args", "--params-file", str(file), *space]
            # a session of its own: Ctrl-C in the terminal reaches us alone, and we pass it on
            self.processes[name] = subprocess.Popen(command, start_new_session=True)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node, _, part = status.name.partition(": ")
            name = node.rpartition("/")[2]
            if part == "connections":
                self._counts[name] = {pair.key: int(pair.value) for pair in status.values}
            elif name == "plant" and part == "flight":
                self._finished = status.message == "finished"
                self._samples = int({pair.key: pair.value for pair in status.values}["samples"])

    def _wait_until_connected(self) -> None:
        recorders = 0 if self.recorder is None else 1
        end = time.monotonic() + CONNECT_TIMEOUT
        while True:
            self._executor.spin_once(timeout_sec=0.1)
            self._check_alive()
            missing = [f"{name}: no word from it" for name in EXECUTABLES if name not in self._counts]
            missing += [
                f"{name}: {lack}"
                for name, counts in self._counts.items()
                for lack in missing_connections(name, counts, recorders)
            ]
            if not missing and self._starter.service_is_ready():
                return
            if time.monotonic() > end:
                raise GraphError(f"not connected after {CONNECT_TIMEOUT:g} s: {'; '.join(missing)}")

    def _begin_flight(self) -> None:
        future = self._starter.call_async(Trigger.Request())
        end = time.monotonic() + CONNECT_TIMEOUT
        while not future.done():
            self._executor.spin_once(timeout_sec=0.05)
            self._check_alive()
            if time.monotonic() > end:
                raise GraphError("plant/start did not answer")
        answer = future.result()
        if answer is None or not answer.success:
            raise GraphError(f"plant/start: {answer.message if answer is not None else 'no answer'}")

    def _check_alive(self) -> None:
        for name, process in self.processes.items():
            code = process.poll()
            if code is not None:
                raise GraphError(f"node {name} ended with exit code {code}")
