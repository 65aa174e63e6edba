"""Launch the graph, one process per node:  ``ros2 launch quadftc_bringup graph.launch.py``.

With ``plant_kind:=free_flight params_file:=.../free_flight.yaml`` the vehicle flies through space.

With ``simulate:=false`` plant and fault injector stay out. A vehicle or another simulator publishes
``imu/data`` and reads ``torque/command``; ``imu:=/mavros/imu/data`` names another topic.
"""

from __future__ import annotations

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, LogInfo, TimerAction
from launch.conditions import IfCondition
from launch.substitutions import (
    AndSubstitution,
    EqualsSubstitution,
    FindExecutable,
    IfElseSubstitution,
    LaunchConfiguration,
    NotEqualsSubstitution,
    PathJoinSubstitution,
)
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PLANT = ("quadftc_sim", "plant")  # (package, executable = node name)
FAULT_INJECTOR = ("quadftc_sim", "fault_injector")
ONBOARD = (
    ("quadftc_fdi", "fault_observer"),
    ("quadftc_fdi", "disturbance_observer"),
    ("quadftc_control", "controller"),
)
GUIDANCE = {
    "test_stand": ("quadftc_control", "reference"),
    "free_flight": ("quadftc_control", "position_controller"),
}
RECORDER = ("quadftc_ros", "recorder")
SCENE = ("quadftc_ros", "scene")
RESPAWN_DELAY = 0.1  # s; of a node that dies in flight
MOST_DEATHS = 5  # of a node, after which it stays dead
START_DELAY = 6.0  # s, for the nodes to find each other (about 4 s): messages sent before that are lost


def _shared(*path: str) -> PathJoinSubstitution:
    return PathJoinSubstitution([FindPackageShare("quadftc_bringup"), *path])


def _arguments() -> list[DeclareLaunchArgument]:
    rows = {  # name: default, what it is, choices
        "namespace": ("", "Namespace of the vehicle."),
        "frame_prefix": (
            IfElseSubstitution(
                EqualsSubstitution(LaunchConfiguration("namespace"), ""),
                if_value="",
                else_value=[LaunchConfiguration("namespace"), "/"],
            ),
            "In front of base_link and imu_link in messages and /tf; default: the namespace.",
        ),
        "params_file": (
            _shared("config", "graph.yaml"),
            "Parameter file for any of the nodes; there is one for each vehicle.",
        ),
        "mode": (
            "realtime",
            "realtime: wall clock; lockstep: the plant waits for each torque.",
            "realtime",
            "lockstep",
        ),
        "use_sim_time": (
            EqualsSubstitution(LaunchConfiguration("mode"), "lockstep"),
            "Whether the nodes follow /clock, which the plant publishes in lock-step.",
        ),
        "plant_kind": (
            "test_stand",
            "test_stand: follow attitudes; free_flight: follow positions, command rotor speeds.",
            *GUIDANCE,
        ),
        "engine": (
            "c",
            "What runs the laws: C that is generated from them, or NumPy, the reference.",
            "c",
            "numpy",
        ),
        "simulate": ("true", "Start the plant and the fault injector."),
        "start": ("true", "Call plant/start when all nodes are up."),
        "respawn": (
            "false",
            "Start a node again that dies in flight (not the plant): it resumes where it was.",
        ),
        "imu": ("imu/data", "Topic of the IMU."),
        "torque": ("torque/command", "Topic of the torque."),
        "scene": ("false", "Draw the vehicle for RViz and Foxglove, with /tf."),
        "monitor": ("false", "Group /diagnostics for rqt_robot_monitor, by diagnostic_aggregator."),
        "bag": ("", "New directory to record into; empty: none."),
    }
    return [
        DeclareLaunchArgument(name, default_value=default, description=about, choices=choices or None)
        for name, (default, about, *choices) in rows.items()
    ]


def _node(package: str, name: str, condition: IfCondition | None = None, **parameters: object) -> Node:
    common: dict[str, object] = {each: LaunchConfiguration(each) for each in ("mode", "plant_kind", "engine")}
    common["frame_prefix"] = ParameterValue(LaunchConfiguration("frame_prefix"), value_type=str)
    return Node(
        package=package,
        executable=name,
        name=name,
        namespace=LaunchConfiguration("namespace"),
        parameters=[LaunchConfiguration("params_file"), {**common, **parameters}],
        remappings=[
            ("imu/data", LaunchConfiguration("imu")),
            ("torque/command", LaunchConfiguration("torque")),
        ],
        condition=condition,
        respawn=False if (package, name) == PLANT else LaunchConfiguration("respawn"),
        respawn_delay=RESPAWN_DELAY,
        respawn_max_retries=MOST_DEATHS,
        output="screen",
    )


def _start_call(simulate: LaunchConfiguration) -> TimerAction:
    service = [LaunchConfiguration("namespace"), "/plant/start"]
    call = ExecuteProcess(
        cmd=[FindExecutable(name="ros2"), "service", "call", service, "std_srvs/srv/Trigger"],
        condition=IfCondition(AndSubstitution(simulate, LaunchConfiguration("start"))),
        output="screen",
    )
    return TimerAction(period=START_DELAY, actions=[call])


def _introduction(simulate: LaunchConfiguration) -> list[LogInfo]:
    """Say how to have a say in it; the nodes say what they run."""
    words = {
        "inject": "bias axis=roll value=3deg duration=10s",
        "watch": "",
    }
    lines = [
        LogInfo(
            msg=f"{name}: ros2 run quadftc_cli quadftc {name} {rest}".rstrip(),
            condition=IfCondition(simulate),
        )
        for name, rest in words.items()
    ]
    bag = LaunchConfiguration("bag")
    none = LogInfo(msg="bag: none (bag:=DIRECTORY)", condition=IfCondition(EqualsSubstitution(bag, "")))
    return [*lines, none, LogInfo(msg=["bag: ", bag], condition=IfCondition(NotEqualsSubstitution(bag, "")))]


def generate_launch_description() -> LaunchDescription:
    """Return the description: arguments, nodes, the optional recorder and the call that starts the plant."""
    simulate = LaunchConfiguration("simulate")
    clock = ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)
    bag = LaunchConfiguration("bag")
    recording = IfCondition(NotEqualsSubstitution(bag, ""))
    nodes = [
        _node(*RECORDER, recording, directory=ParameterValue(bag, value_type=str)),
        _node(*PLANT, IfCondition(simulate), start_when_connected=False),  # it makes the clock
        _node(*FAULT_INJECTOR, IfCondition(simulate), use_sim_time=clock),
        *(_node(*node, use_sim_time=clock) for node in ONBOARD),
        *(
            _node(
                *node,
                IfCondition(EqualsSubstitution(LaunchConfiguration("plant_kind"), kind)),
                use_sim_time=clock,
            )
            for kind, node in GUIDANCE.items()
        ),
    ]
    nodes.append(_node(*SCENE, IfCondition(LaunchConfiguration("scene")), use_sim_time=clock))
    monitor = Node(
        package="diagnostic_aggregator",
        executable="aggregator_node",
        name="analyzers",
        parameters=[_shared("diagnostics", "analyzers.yaml")],
        condition=IfCondition(LaunchConfiguration("monitor")),
    )
    nodes.append(monitor)
    return LaunchDescription([*_arguments(), *_introduction(simulate), *nodes, _start_call(simulate)])
