# pyright: basic
"""What both graphs do: wait until all nodes are connected, then follow the flight until it ends."""

from __future__ import annotations

import abc
import shutil
import time
from collections.abc import Callable, Sequence

from rclpy.node import Node
from rclpy.parameter import Parameter

from quadftc_flight.graph.plan import CONNECT_TIMEOUT, SLICE, STALL_TIMEOUT, GraphError, Progress, always
from quadftc_model.assembly import NodeParameters
from quadftc_ros.executor import Hosted, NodeHost, Slice
from quadftc_ros.recorder_node import RecorderNode
from quadftc_ros.topics import PlantKind, crowded_topics

ALONE = "another graph runs in this ROS domain; stop it, or set another ROS_DOMAIN_ID"


class Graph(NodeHost, abc.ABC):
    """A graph that is running; a context manager, which closes it."""

    def __init__(self) -> None:
        super().__init__("launcher")
        self.exit_code = 0  # the worst of the processes, once they were stopped
        self._slice = Slice(self._executor)
        self._begun = False  # whether there is anything to be kept
        self.flew_to_its_end = False  # and `progress` did not end the flight
        self._watchers: list[tuple[Node, PlantKind]] = []  # a node of each vehicle, and what it flies

    @abc.abstractmethod
    def _missing(self) -> list[str]:
        """Say which connections between the nodes are missing."""

    @abc.abstractmethod
    def _state(self) -> tuple[bool, int]:
        """Say whether the flight is over, and how many samples there were."""

    def _check_alive(self) -> None:
        """Raise a `GraphError` if a node has ended."""

    def _add_node(
        self,
        node_class: Callable[..., Hosted],
        namespace: str,
        parameters: NodeParameters,
        remaps: Sequence[str] = (),
        **options: object,
    ) -> Hosted:
        """Make a node and let the executor serve it."""
        made = node_class(
            context=self._context,
            namespace=namespace or None,
            parameter_overrides=[Parameter(name, value=value) for name, value in parameters.items()],
            use_global_arguments=False,
            **({"cli_args": remaps} if remaps else {}),
            **options,
        )
        return self._host(made)

    @property
    def recorder(self) -> RecorderNode | None:
        """The recorder of the first vehicle."""
        return next((node for node in self._nodes if isinstance(node, RecorderNode)), None)

    def close(self) -> None:
        """Close the bags, end the nodes: the recorders last. Of a start that failed, no bag remains."""
        self._nodes.sort(key=lambda node: isinstance(node, RecorderNode))
        for recorder in (node for node in self._nodes if isinstance(node, RecorderNode)):
            recorder.finish()
            if not self._begun:
                shutil.rmtree(recorder.path.parent, ignore_errors=True)
        super().close()

    def wait_until_connected(self, progress: Progress = always) -> bool:
        """Wait until every node is matched with every other; return False if ``progress(0)`` did so before.

        A GraphError says if they do not find each other, one of them ends, or another graph is there, too.
        """
        end = time.monotonic() + CONNECT_TIMEOUT
        while missing := self._missing():
            self._check_alive()
            if time.monotonic() > end:
                raise GraphError(f"not connected after {CONNECT_TIMEOUT:g} s: {'; '.join(missing)}")
            if not progress(0):
                return False
            self._slice.spin(0.05)
        for node, plant in self._watchers:
            if crowd := crowded_topics(node.count_publishers, plant):
                raise GraphError(f"{crowd[0]}: {ALONE}")
        return True

    def _serve(self, spin: Callable[[float], None], progress: Progress) -> float:
        """Spin until ``progress`` ends it; return the wall time [s]. Nobody waits for the vehicle."""
        begin, self._begun = time.monotonic(), True
        while progress(0):
            spin(SLICE)
            self._check_alive()
        return time.monotonic() - begin

    def _follow(self, spin: Callable[[float], None], progress: Progress, stalled: str) -> float:
        """Spin until the flight is over, or ``progress`` ends it; return its wall time [s]."""
        begin, self._begun = time.monotonic(), True
        moved = begin
        over, seen = self._state()
        while not over:
            spin(SLICE)
            self._check_alive()
            over, samples = self._state()
            now = time.monotonic()
            if not progress(samples):
                return now - begin
            if samples != seen:
                seen, moved = samples, now
            elif now - moved > STALL_TIMEOUT:
                raise GraphError(f"the flight stalled after {samples} samples: {stalled}")
        self.flew_to_its_end = True
        # a slice goes on after the flight: where the plant is in this process, its last sample is the end
        return (self._slice.looked or time.monotonic()) - begin
