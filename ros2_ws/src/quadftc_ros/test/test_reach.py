"""Nodes are bound to the loopback, whatever else the environment says, until a range is asked for."""

import ast
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from quadftc_ros.reach import (
    LOOPBACK,
    PROFILE,
    RANGE,
    is_bound,
    open_sockets,
    open_to_network,
    reach,
    stay_local,
)

ROOT = Path(__file__).resolve().parents[4]
NODE = """
import rclpy
rclpy.init()
node = rclpy.create_node("alone")
print(__import__("quadftc_ros.reach").reach.open_sockets())
"""


def open_sockets_of_a_node(environment):
    """Those of a process with a node that other machines reach."""
    kept = {key: value for key, value in os.environ.items() if key not in (RANGE, PROFILE)}
    done = subprocess.run(
        [sys.executable, "-c", NODE], env=kept | environment, capture_output=True, check=True
    )
    return ast.literal_eval(done.stdout.decode())


@pytest.mark.skipif(not Path("/proc/net/udp").exists(), reason="no /proc")
def test_all_sockets_of_a_node_are_on_the_loopback():
    environment = {}
    stay_local(environment)
    assert open_sockets_of_a_node(environment) == []
    assert "127.0.0.1" in reach(environment)
    open_to_network(environment)
    assert environment == {RANGE: "SUBNET"}
    assert open_sockets_of_a_node(environment)  # what the test reads is there


def test_only_sockets_that_others_can_reach_are_named():
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as everywhere,
        socket.create_server(("0.0.0.0", 0)) as server,
    ):
        here.bind(("127.0.0.1", 0))
        everywhere.bind(("0.0.0.0", 0))
        found = open_sockets()
        assert f"udp 0.0.0.0:{everywhere.getsockname()[1]}" in found
        assert f"tcp 0.0.0.0:{server.getsockname()[1]}" in found
        assert not any(line.endswith(f":{here.getsockname()[1]}") for line in found)


@pytest.mark.parametrize(
    ("given", "bound", "wanted"),
    [
        ({}, True, "SYSTEM_DEFAULT"),
        ({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}, False, "LOCALHOST"),
        ({"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}, True, "SYSTEM_DEFAULT"),
        ({PROFILE: "mine.xml"}, False, "LOCALHOST"),
        ({RANGE: "SUBNET"}, False, "SUBNET"),
        ({RANGE: "SUBNET", PROFILE: str(LOOPBACK)}, False, "SUBNET"),
        (
            {RANGE: "SYSTEM_DEFAULT", PROFILE: str(LOOPBACK), "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"},
            False,
            "LOCALHOST",
        ),
    ],
)
def test_profile_is_for_fast_dds_and_who_asks_for_none(given, bound, wanted):
    environment = dict(given)
    stay_local(environment)
    assert (is_bound(environment), environment[RANGE]) == (bound, wanted)
    assert (environment.get(PROFILE) == str(LOOPBACK)) == bound
    if len(given) < 2:  # the shell says the same
        names = (RANGE, PROFILE, "RMW_IMPLEMENTATION")
        clean = {key: value for key, value in os.environ.items() if key not in names}
        said = f". {ROOT}/scripts/lib/env.sh; echo ${RANGE},${PROFILE}"
        done = subprocess.run(["bash", "-c", said], env=clean | given, capture_output=True, check=True)
        found = environment[RANGE], environment.get(PROFILE, "")
        assert tuple(done.stdout.decode().strip().split(",")) == found
