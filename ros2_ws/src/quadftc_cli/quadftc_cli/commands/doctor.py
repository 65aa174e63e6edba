# pyright: basic
"""``quadftc doctor``: what is installed, what is missing, and how to mend it."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import shutil
import sys
import time
from collections.abc import Callable
from typing import NamedTuple

import rclpy
import typer
from rclpy.context import Context
from rclpy.utilities import get_rmw_implementation_identifier
from std_msgs.msg import Header

from quadftc_bags.interfaces import load_message_class
from quadftc_cli.commands import CHECK_FAILED, GOOD
from quadftc_cli.tables import console
from quadftc_flight.graph.plan import EXECUTABLES, GraphError
from quadftc_flight.graph.processes import executable_path
from quadftc_flight.scenario import ScenarioError, find_scenario, load_scenario, scenario_names
from quadftc_model.vehicle import load_vehicle, vehicle_names
from quadftc_ros.executor import make_executor
from quadftc_ros.topics import TOPICS

MIN_DISK = 500e6  # bytes; a bag of 80 s at 250 Hz takes about 20 MB
LIBRARIES = ("numpy", "scipy", "mcap", "rosbags", "pydantic", "ruamel.yaml", "typer", "rich")


class Finding(NamedTuple):
    """One line of the report."""

    part: str
    good: bool
    what: str
    mend: str = ""


def doctor() -> None:
    """Check the installation; say what is missing and how to mend it."""
    findings = examine()
    screen = console()
    for finding in findings:
        mark = "[green]good[/]" if finding.good else "[red]BAD [/]"
        screen.print(f"{mark} {finding.part}: {finding.what}")
        if not finding.good:
            screen.print(f"     {finding.mend}")
    raise typer.Exit(GOOD if all(finding.good for finding in findings) else CHECK_FAILED)


def examine() -> list[Finding]:
    """Run every check; a check that fails is a finding, never an exception."""
    checks: tuple[tuple[str, Callable[[], str], str], ...] = (
        ("python", _python, "install CPython 3.10-3.13 and run scripts/setup"),
        ("ROS 2", _ros, "run scripts/setup, or source your ROS 2 Jazzy"),
        ("messages", _messages, "run scripts/setup: it builds the workspace"),
        ("executables", _executables, "run scripts/setup: it builds the workspace"),
        ("libraries", _libraries, "run scripts/setup"),
        ("vehicles", _vehicles, "mend the file named"),
        ("scenarios", _scenarios, "mend the file named"),
        ("communication", _communication, "check ROS_DOMAIN_ID, RMW_IMPLEMENTATION and the loopback network"),
        ("discovery", _discovery, "set ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"),
        ("disk", _disk, "free some space"),
    )
    return [_finding(*row) for row in checks]


def _finding(part: str, check: Callable[[], str], mend: str) -> Finding:
    try:
        return Finding(part, True, check())
    except Exception as error:  # whatever is wrong is what the doctor is asked for
        return Finding(part, False, " ".join(str(error).split()) or type(error).__name__, mend)


def _python() -> str:
    if not (3, 10) <= sys.version_info[:2] <= (3, 13):
        raise RuntimeError(f"Python {platform.python_version()} is not supported")
    return f"{platform.python_version()} on {platform.system()} {platform.machine()}, {os.cpu_count()} cores"


def _ros() -> str:
    where = "/opt/ros" if "/opt/ros/" in (rclpy.__file__ or "") else "wheels"
    return (
        f"Jazzy, rclpy {importlib.metadata.version('rclpy')} ({where}), {get_rmw_implementation_identifier()}"
    )


def _messages() -> str:
    types = {row.type_name for row in TOPICS.values()}
    for type_name in types:
        load_message_class(type_name)
    return f"{len(types)} message types load"


def _executables() -> str:
    for package, executable in (
        *EXECUTABLES.values(),
        ("quadftc_ros", "recorder"),
        ("quadftc_cli", "quadftc"),
    ):
        executable_path(package, executable)
    return f"{len(EXECUTABLES) + 2} installed"


def _libraries() -> str:
    return ", ".join(f"{name} {importlib.metadata.version(name)}" for name in LIBRARIES)


def _vehicles() -> str:
    return ", ".join(load_vehicle(name).name for name in vehicle_names())


def _scenarios() -> str:
    names = scenario_names()
    if not names:
        raise ScenarioError("none found")
    for name in names:
        load_scenario(find_scenario(name))
    return f"{len(names)} load"


def _communication() -> str:
    """Send a message from one node to another and time it."""
    context = Context()
    context.init()
    executor = make_executor("events", context)
    node = rclpy.create_node("doctor", context=context, use_global_arguments=False)
    try:
        received: list[float] = []
        publisher = node.create_publisher(Header, "~/loop", 10)
        node.create_subscription(Header, "~/loop", lambda _: received.append(time.perf_counter()), 10)
        executor.add_node(node)
        end = time.monotonic() + 5.0
        while publisher.get_subscription_count() == 0 and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.05)
        sent = time.perf_counter()
        publisher.publish(Header())
        while not received and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.05)
        if not received:
            raise GraphError("a message did not come back within 5 s")
        return f"a message took {(received[0] - sent) * 1e6:.0f} us within this process"
    finally:
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()


def _discovery() -> str:
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET (ROS 2's default)")
    domain = os.environ.get("ROS_DOMAIN_ID", "0 (default)")
    return f"ROS_AUTOMATIC_DISCOVERY_RANGE {reach}, ROS_DOMAIN_ID {domain}"


def _disk() -> str:
    free = shutil.disk_usage(".").free
    if free < MIN_DISK:
        raise OSError(f"{free / 1e6:.0f} MB free here")
    return f"{free / 1e9:.1f} GB free here"
