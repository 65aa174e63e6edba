# pyright: basic
"""``quadftc doctor``: what is installed, what is missing, and how to mend it."""

from __future__ import annotations

import os
import platform
import shutil
import sys
import time
from collections.abc import Callable
from importlib.metadata import version

import rclpy
import typer
from rclpy.utilities import get_rmw_implementation_identifier
from std_msgs.msg import Header

from quadftc_bags.interfaces import load_message_class
from quadftc_cli.commands import CHECK_FAILED
from quadftc_cli.live import PATIENCE, LiveGraph
from quadftc_cli.screen import console
from quadftc_flight.graph.plan import EXECUTABLES, GraphError
from quadftc_flight.graph.processes import executable_path
from quadftc_flight.scenario import ScenarioError, find_scenario, load_scenario, scenario_names
from quadftc_model.vehicle import load_vehicle, vehicle_names
from quadftc_ros.leftovers import find_leftovers
from quadftc_ros.reach import LOOPBACK, PROFILE, RANGE, is_bound, open_sockets, reach
from quadftc_ros.topics import TOPICS

MIN_DISK = 500e6  # bytes; a bag of 80 s at 250 Hz takes about 20 MB
MEND_FILE = "mend the file named"
LIBRARIES = ("numpy", "scipy", "mcap", "rosbags", "pydantic", "ruamel.yaml", "typer", "rich")


def doctor() -> None:
    """Check the installation; say what is missing and how to mend it."""
    healthy = [_examine(part, *row) for part, row in CHECKS.items()]
    if not all(healthy):
        raise typer.Exit(CHECK_FAILED)


def _examine(part: str, check: Callable[[], str], mend: str) -> bool:
    screen = console()
    try:
        screen.print(f"[green]good[/] {part}: {check()}", soft_wrap=True)
    except Exception as error:  # whatever is wrong is what the doctor is asked for
        words = " ".join(str(error).split()) or type(error).__name__
        screen.print(f"[red]BAD [/] {part}: {words}", soft_wrap=True)
        screen.print(f"     {mend}")
        return False
    return True


def _python() -> str:
    if not (3, 10) <= sys.version_info[:2] <= (3, 13):
        raise RuntimeError(f"Python {platform.python_version()} is not supported")
    return f"{platform.python_version()} on {platform.system()} {platform.machine()}, {os.cpu_count()} cores"


def _ros() -> str:
    where = "/opt/ros" if "/opt/ros/" in (rclpy.__file__ or "") else "wheels"
    return f"Jazzy, rclpy {version('rclpy')} ({where}), {get_rmw_implementation_identifier()}"


def _messages() -> str:
    types = {row.type_name for row in TOPICS.values()}
    return f"{len([load_message_class(name) for name in types])} message types load"


def _executables() -> str:
    names = [*EXECUTABLES.values(), ("quadftc_ros", "recorder"), ("quadftc_cli", "quadftc")]
    return f"{len([executable_path(*name) for name in names])} installed"


def _scenarios() -> str:
    loaded = [load_scenario(find_scenario(name)) for name in scenario_names()]
    if not loaded:
        raise ScenarioError("none found")
    return f"{len(loaded)} load"


def _communication() -> str:
    """Send a message from one node to another and time it."""
    with LiveGraph() as graph:
        received: list[float] = []
        publisher = graph.node.create_publisher(Header, "~/loop", 10)
        graph.node.create_subscription(Header, "~/loop", lambda _: received.append(time.perf_counter()), 10)
        graph.until(publisher.get_subscription_count)
        sent = time.perf_counter()
        publisher.publish(Header())
        if not graph.until(lambda: received):
            raise GraphError(f"a message did not come back within {PATIENCE:g} s")
        return f"a message took {(received[0] - sent) * 1e6:.0f} us within this process"


def _reach() -> str:
    """Say who can reach nodes, and where their sockets really are."""
    with LiveGraph():
        abroad = open_sockets()
    if abroad and is_bound():
        raise RuntimeError(f"sockets {', '.join(abroad)}, though {PROFILE} is {LOOPBACK}")
    return f"{reach()}; others reach {len(abroad) or 'none'} of a node's sockets"


def _disk() -> str:
    free = shutil.disk_usage(".").free
    if free < MIN_DISK:
        raise OSError(f"{free / 1e6:.0f} MB free here")
    return f"{free / 1e9:.1f} GB free here"


def _memory() -> str:
    """Say how much killed processes left in shared memory, which the next graph of processes removes."""
    left = find_leftovers().values()
    size = sum(path.stat().st_size for paths in left for path in paths if path.exists())
    return f"{len(left)} segments and ports left by killed processes, {size / 1e6:.0f} MB"


# part: what describes it or raises, how to mend it
CHECKS: dict[str, tuple[Callable[[], str], str]] = {
    "python": (_python, "install CPython 3.10-3.13 and run scripts/setup"),
    "ROS 2": (_ros, "run scripts/setup, or source your ROS 2 Jazzy"),
    "messages": (_messages, "run scripts/setup: it builds the workspace"),
    "executables": (_executables, "run scripts/setup: it builds the workspace"),
    "libraries": (lambda: ", ".join(f"{name} {version(name)}" for name in LIBRARIES), "run scripts/setup"),
    "vehicles": (lambda: ", ".join(load_vehicle(name).name for name in vehicle_names()), MEND_FILE),
    "scenarios": (_scenarios, MEND_FILE),
    "communication": (_communication, "check ROS_DOMAIN_ID, RMW_IMPLEMENTATION and the loopback network"),
    "reach": (_reach, f"unset {RANGE} and {PROFILE}"),
    "shared memory": (_memory, "look at /dev/shm"),
    "disk": (_disk, "free some space"),
}
