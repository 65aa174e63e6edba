# pyright: basic
"""What the page asks the nodes for: faults to inject and to clear, setpoints. One thread talks to ROS."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar

from quadftc_cli.commands.inject import request_fields
from quadftc_cli.commands.set import SETPOINTS, setpoint_message
from quadftc_cli.live import LiveGraph
from quadftc_flight.graph.plan import GraphError
from quadftc_msgs.srv import ClearFault, InjectFault

T = TypeVar("T")


class Injected(NamedTuple):
    """A fault that the page has put on."""

    number: int  # as the injector calls it
    words: str
    end: float  # on the monotonic clock [s]; inf: until cleared


class Commander:
    """Calls services and publishes setpoints in a namespace; a ValueError or GraphError says why not."""

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="ros")
        self._graph: LiveGraph | None = None
        self._publishers: dict[str, Any] = {}
        self._injected: list[Injected] = []
        self.setpoints: dict[str, dict[str, float]] = {}  # by target: what was sent last, in SI

    @property
    def injected(self) -> list[Injected]:
        """The faults of the page that have not ended."""
        now = time.monotonic()
        self._injected = [each for each in self._injected if each.end > now]
        return self._injected

    async def inject(self, words: str) -> Injected:
        """Put a fault on, as ``quadftc inject`` takes it."""
        fields = request_fields(words)
        begin = time.monotonic()
        answer = await self._call("fault_injector/inject", InjectFault, fields)
        lasts = fields["start"] + fields["duration"] if fields["duration"] else float("inf")
        found = Injected(answer.id, words, begin + lasts)
        self._injected.append(found)
        return found

    async def clear(self, number: int = 0) -> None:
        """End a fault; 0: all, those of the scenario included."""
        await self._call("fault_injector/clear", ClearFault, {"id": number})
        self._injected = [each for each in self._injected if number not in (0, each.number)]

    async def set(self, target: str, numbers: dict[str, float]) -> None:
        """Send a setpoint in SI: attitude or position."""
        await self._in_thread(lambda graph: self._publish(graph, target, numbers))

    async def _call(self, name: str, service: Any, fields: Mapping[str, object]) -> Any:
        answer = await self._in_thread(lambda graph: graph.call(name, service, service.Request(**fields)))
        if not answer.success:
            raise ValueError(answer.message)
        return answer

    def _publish(self, graph: LiveGraph, target: str, numbers: dict[str, float]) -> None:
        topic, message = SETPOINTS[target][0], setpoint_message(target, numbers)
        publisher = self._publishers.get(topic) or graph.publisher(topic)
        if publisher is None:
            raise GraphError(f"nobody reads {topic}")
        self._publishers[topic] = publisher
        message.header.stamp = graph.node.get_clock().now().to_msg()
        publisher.publish(message)

    async def _in_thread(self, act: Callable[[LiveGraph], T]) -> T:
        def run() -> T:
            self._graph = self._graph or LiveGraph(self._namespace)
            return act(self._graph)

        return await asyncio.get_running_loop().run_in_executor(self._thread, run)

    def close(self) -> None:
        """End the node."""
        self._thread.shutdown(cancel_futures=True)
        if self._graph is not None:
            self._graph.__exit__()
