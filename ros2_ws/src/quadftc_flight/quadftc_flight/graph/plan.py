"""What a graph is made of: its nodes with their parameters, where they run, and what is recorded."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import yaml

from quadftc_model.assembly import NodeParameters
from quadftc_model.hints import nearest
from quadftc_ros.scheduling import ORDINARY, Scheduling
from quadftc_ros.topics import NODES, TOPICS, PlantKind
from quadftc_sim.plant import plants

# node -> (package, executable), in the order in which they are made: the earlier of two readers of a topic
# gets its messages first, so those come first for whom others wait
EXECUTABLES: dict[str, tuple[str, str]] = {
    "plant": ("quadftc_sim", "plant"),
    "fault_injector": ("quadftc_sim", "fault_injector"),
    "fault_observer": ("quadftc_fdi", "fault_observer"),
    "controller": ("quadftc_control", "controller"),
    "disturbance_observer": ("quadftc_fdi", "disturbance_observer"),
    "reference": ("quadftc_control", "reference"),
    "position_controller": ("quadftc_control", "position_controller"),
}

SIMULATION = ("plant", "fault_injector")  # what a vehicle that exists takes the place of

CONNECT_TIMEOUT = 30.0  # s; to find each other
SLICE = 0.25  # s, wall time of flight between two looks at it
STALL_TIMEOUT = 15.0  # s; without a new sample
# s; real time: recorded after the end; longer, and the controller reports that the IMU has stopped
AFTERMATH = 0.05

Progress = Callable[[int], bool]  # called with the number of samples so far; False ends the flight early
Parameters = Mapping[str, NodeParameters]  # node to its parameters, name to value


class GraphError(RuntimeError):
    """The graph could not be started, stalled, or lost a node; the message says which."""


@dataclasses.dataclass(frozen=True)
class GraphPlan:
    """A graph to be run."""

    parameters: Parameters
    mode: str = "lockstep"  # or realtime
    namespace: str = ""  # of the vehicle; empty: none
    bag: Path | None = None  # directory of the bag to write
    attachments: tuple[Path, ...] = ()  # files that go into the bag
    engine: str = "c"  # what runs the laws: "c" or "numpy"
    traces: Path | None = None  # directory for the times at which messages come and go, a file for each node
    scheduling: Scheduling = ORDINARY  # in real time: how to share the machine
    respawn: bool = False  # in real time, as processes: restart a node that dies in flight, but not the plant
    onboard: bool = False  # without plant and fault injector, for a vehicle that exists; in real time
    remaps: tuple[str, ...] = ()  # ``imu/data:=/mavros/imu/data``, for every node and the recorder

    @property
    def plant(self) -> PlantKind:
        """The kind of the plant that the plant node flies; a ValueError if there is none of its name."""
        if any(values.get("plant_kind") == "free_flight" for values in self.parameters.values()):
            return "free_flight"
        name = self.parameters.get("plant", {}).get("plant", "test_stand")
        return "free_flight" if plants.get(str(name)).flies else "test_stand"

    @property
    def executables(self) -> dict[str, tuple[str, str]]:
        """Rows of `EXECUTABLES` for the nodes of this graph."""
        left_out = SIMULATION if self.onboard else ()
        names = [name for name in NODES[self.plant] if name not in left_out]
        return {name: row for name, row in EXECUTABLES.items() if name in names}

    @property
    def remap_arguments(self) -> list[str]:
        """Return the arguments of every node for what is remapped."""
        words = [word for remap in self.remaps for word in ("-r", remap)]
        return ["--ros-args", *words] if words else []

    @property
    def _common(self) -> dict[str, object]:
        """Parameters of every node."""
        more = {"plant_kind": self.plant} if self.plant != "test_stand" else {}
        return {"mode": self.mode, **more, "engine": self.engine}

    @property
    def _frames(self) -> dict[str, str]:
        """Frames of a vehicle in a namespace have it in front, so that two vehicles do not share one."""
        name = self.namespace.strip("/")
        return {"frame_prefix": f"{name}/"} if name else {}

    def node_parameters(self, node: str) -> dict[str, object]:
        """Return the parameters of one node: with the mode, less empty lists, which to ROS have no type."""
        values = {**self._frames, **self.parameters.get(node, {}), **self._common}
        if node == "fault_observer" and self.onboard:  # it feels drag; an autopilot's attitude is of its gyro
            values = {"bank.feels_gravity": False, "bank.attitude_from_gyro": True, **values}
        if node == "plant":
            values["start_when_connected"] = False
        if self.traces is not None:
            values["trace"] = str(self.traces / f"{node}.npz")
        return {name: value for name, value in values.items() if value != []}

    def parameter_file(self) -> str:
        """Return the parameters of all nodes as a ROS parameter file (YAML)."""
        prefix = f"/{self.namespace.strip('/')}" if self.namespace else ""
        nodes = {
            f"{prefix}/{node}": {"ros__parameters": self.node_parameters(node)} for node in self.executables
        }
        return yaml.safe_dump(nodes, sort_keys=False, default_flow_style=None, width=120)

    def recorder_parameters(self) -> dict[str, object]:
        """Return the parameters of the recorder."""
        attachments = [str(path) for path in self.attachments] or [""]
        return {**self._common, "directory": str(self.bag), "attachments": attachments}


def check_remaps(remaps: Sequence[str]) -> None:
    """Raise a ValueError if something is no remapping of a topic of the table."""
    for remap in remaps:
        topic, arrow, other = remap.partition(":=")
        if not (topic and arrow and other):
            raise ValueError(f"--remap {remap}: expected TOPIC:=OTHER, as imu/data:=/mavros/imu/data")
        if topic not in TOPICS:
            raise ValueError(f"--remap {remap}: no topic {topic}{nearest(topic, TOPICS)}")


def check_options(graph: str, mode: str, scheduling: Scheduling, respawn: bool = False) -> None:
    """Raise a ValueError if the machine cannot be shared so, or nodes cannot restart, in a graph and mode."""
    if mode == "lockstep" and scheduling != ORDINARY:
        raise ValueError("waiting, realtime priority and cores are for real time, not for lock-step")
    if graph == "processes" and scheduling.wait == "poll":
        raise ValueError("wait = 'poll': for the composed graph; six processes that poll need six cores")
    if respawn and (mode, graph) != ("realtime", "processes"):
        raise ValueError("respawn: for nodes that are processes, in real time")


def always(samples: int) -> bool:
    """Let the flight go on to its end."""
    return True
