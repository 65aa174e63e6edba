"""The launch file by the real launch system, where that is installed: the nodes run, and Ctrl-C ends them."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("launch_ros")

LAUNCH_FILE = Path(__file__).parents[1] / "launch" / "graph.launch.py"
NODES = {"plant", "fault_injector", "fault_observer", "disturbance_observer", "controller", "reference"}
LAUNCH = """
import sys
from launch import LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

service = LaunchService()
source = PythonLaunchDescriptionSource(sys.argv[1])
service.include_launch_description(IncludeLaunchDescription(source, launch_arguments=[("start", "false")]))
sys.exit(service.run())
"""


def test_ctrl_c_ends_every_node_with_0():
    """As in a terminal, each node gets SIGINT twice: with all of the group, and from the launcher."""
    command = [sys.executable, "-c", LAUNCH, str(LAUNCH_FILE)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    ) as process:
        said, seen = [], 0
        while seen < len(NODES):
            said.append(process.stdout.readline())
            assert said[-1], "".join(said)
            seen += "]: runs" in said[-1]
        os.killpg(process.pid, signal.SIGINT)
        output = "".join(said) + process.communicate(timeout=60)[0]
    assert process.returncode == 0, output
    assert output.count("process has finished cleanly") == len(NODES), output
    assert "Traceback" not in output
