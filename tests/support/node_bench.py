"""A bench for nodes under test: an executor for them, topics and services around them, waiting on conditions.

Nothing here measures time or sleeps; what does not happen within `PATIENCE` is a failure.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Vector3Stamped
from rcl_interfaces.msg import ParameterDescriptor, ParameterValue, SetParametersResult
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.context import Context
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu

from message_objects import ImuWriter, VectorWriter
from quadftc_bags.interfaces import load_message_class
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import ImuSample
from quadftc_ros.executor import make_executor
from quadftc_ros.qos import service_profile, topic_profile
from quadftc_ros.topics import TOPICS

PATIENCE = 30.0  # s; for anything to happen, on a slow and busy machine
DEPTH = 10000  # messages that may wait for the test

TRUE = np.bool_(True)
N = TypeVar("N", bound=Node)


class NodeBench:
    """Nodes under test in this process, and one node of the test's own; a context manager.

    Parameters
    ----------
    mode : str
        Of the nodes, and of the quality of service around them: ``realtime`` or ``lockstep``.
    namespace : str
        Of all nodes; empty: none.
    """

    def __init__(self, mode: str = "realtime", namespace: str = "") -> None:
        self.mode = mode
        self._namespace = namespace or None
        self.context = Context()
        self.context.init()
        self._executor = make_executor(self.context)
        self._nodes: list[Node] = []
        self._links: list[Callable[[], int]] = []
        self._statuses: dict[str, DiagnosticStatus] = {}
        self.tester = self._add(Node("tester", context=self.context, namespace=self._namespace))

    def __enter__(self) -> NodeBench:
        """Return the bench."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the nodes."""
        self._executor.shutdown()
        for node in self._nodes:
            node.destroy_node()
        self.context.try_shutdown()

    def run(self, node_class: type[N], **parameters: Any) -> N:
        """Start a node with parameters."""
        given = {"mode": self.mode, **parameters}
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        try:
            node = node_class(context=self.context, namespace=self._namespace, parameter_overrides=overrides)  # type: ignore[call-arg]
        except Exception as error:
            destroy_half_made(error)
            raise
        return self._add(node)

    def listen(self, topic: str) -> list[Any]:
        """Return a list that grows by every message of a topic of the table."""
        row = TOPICS[topic]
        offered = topic_profile(row.qos, self.mode)
        wanted = QoSProfile(depth=DEPTH, reliability=offered.reliability, durability=offered.durability)
        received: list[Any] = []
        reader = self.tester.create_subscription(
            load_message_class(row.type_name), topic, received.append, wanted
        )
        self._links.append(reader.get_publisher_count)
        return received

    def talk(self, topic: str) -> Callable[[Any], None]:
        """Return what publishes on a topic of the table."""
        row = TOPICS[topic]
        writer = self.tester.create_publisher(
            load_message_class(row.type_name), topic, topic_profile(row.qos, self.mode)
        )
        self._links.append(writer.get_subscription_count)
        return writer.publish

    def connect(self) -> None:
        """Wait until everything that was made so far has somebody at the other end."""
        self.until(lambda: all(count() for count in self._links))

    def until(self, condition: Callable[[], Any]) -> None:
        """Let the nodes work until a condition holds.

        Raises
        ------
        TimeoutError
            If it does not.
        """
        if not self._holds(condition, PATIENCE):
            raise TimeoutError(f"nothing happened within {PATIENCE:g} s")

    def _holds(self, condition: Callable[[], Any], patience: float) -> bool:
        """Let the nodes work until a condition holds, for a time [s]; return whether it does."""
        end = time.monotonic() + patience
        while not condition():
            if time.monotonic() > end:
                return False
            self._executor.spin_once(timeout_sec=0.05)
        return True

    def call(self, service: type, name: str, **fields: Any) -> Any:
        """Call a service (relative name); return the response."""
        (response,) = self.call_all(service, name, [fields])
        return response

    def call_all(self, service: Any, name: str, requests: Sequence[dict[str, Any]]) -> list[Any]:
        """Send requests to a service without waiting in between; return the responses, in the same order."""
        client = self._client(service, name)
        futures = [client.call_async(service.Request(**fields)) for fields in requests]
        self.until(lambda: all(future.done() for future in futures))
        self.tester.destroy_client(client)
        return [future.result() for future in futures]

    def _client(self, service: Any, name: str) -> Any:
        """Return a client of a service; on a busy machine discovery may not show one for good.

        So the third client calls all the same: the service may be there.
        """
        for _ in range(2):
            client = self.tester.create_client(service, name, qos_profile=service_profile())
            if self._holds(client.service_is_ready, PATIENCE / 3):
                return client
            self.tester.destroy_client(client)
        client = self.tester.create_client(service, name, qos_profile=service_profile())
        self._holds(client.service_is_ready, PATIENCE / 3)
        return client

    def set_parameter(self, node: str, name: str, value: Any) -> SetParametersResult:
        """Set a parameter of a node by its service."""
        parameters = [Parameter(name, value=value).to_parameter_msg()]
        return self.call(SetParameters, f"{node}/set_parameters", parameters=parameters).results[0]

    def get_parameter(self, node: str, name: str) -> Any:
        """Return the value of a parameter of a node, by its service."""
        values: list[ParameterValue] = self.call(GetParameters, f"{node}/get_parameters", names=[name]).values
        return parameter_value_to_python(values[0])

    def describe(self, node: str, name: str) -> ParameterDescriptor:
        """Return the descriptor of a parameter of a node, by its service."""
        return self.call(DescribeParameters, f"{node}/describe_parameters", names=[name]).descriptors[0]

    def watch_diagnostics(self) -> dict[str, DiagnosticStatus]:
        """Return a mapping that follows /diagnostics: name of a status to what was last said of it."""

        def note(message: Any) -> None:
            self._statuses.update((status.name, status) for status in message.status)

        row = TOPICS["/diagnostics"]
        self.tester.create_subscription(
            load_message_class(row.type_name), row.name, note, topic_profile(row.qos, self.mode)
        )
        return self._statuses

    def _add(self, node: N) -> N:
        self._executor.add_node(node)
        self._nodes.append(node)
        return node


def imu_message(
    stamp_ns: int,
    angles: Sequence[float] = (0.0, 0.0, 0.0),
    body_rate: Sequence[float] = (0.0, 0.0, 0.0),
    force: Sequence[float] = (0.0, 0.0, 9.81),
) -> Imu:
    """Message of an IMU at Euler angles [rad] that turns [rad/s] and feels a specific force [m/s²]."""
    q_xyzw = quaternion_from_euler(np.array(angles, float))
    sample = ImuSample(q_xyzw, np.array(body_rate, float), np.array(force, float), TRUE, TRUE, TRUE)
    return ImuWriter()(stamp_ns, sample)


def vector_message(
    stamp_ns: int, vector: Sequence[float] = (0.0, 0.0, 0.0), frame: str = ""
) -> Vector3Stamped:
    """Message of a stamped vector."""
    return VectorWriter(frame)(stamp_ns, np.array(vector, float))


def destroy_half_made(error: Exception) -> None:
    """Destroy the node whose constructor raised ``error``.

    Left to the garbage collector, it may be destroyed while the next bench starts, and Fast DDS then can
    wait for ever (ros2/rmw_fastrtps, issue 666).
    """
    made = [frame.f_locals.get("self") for frame, _ in traceback.walk_tb(error.__traceback__)]
    node = next((each for each in made if isinstance(each, LifecycleNode)), None)
    if node is not None:
        LifecycleNode.destroy_node(node)  # its own class may need what was not made
        node._state_machine.destroy_when_not_in_use()
