"""Who can reach the nodes of this process: what the environment says to the middleware, before ROS starts.

By default Fast DDS is bound to the loopback (`loopback.xml`); another middleware looks for nodes of this
machine only. scripts/lib/env.sh sets the same. Whoever sets ROS_AUTOMATIC_DISCOVERY_RANGE has his way.
"""

from __future__ import annotations

import contextlib
import os
import re
import socket
from collections.abc import MutableMapping
from pathlib import Path

RANGE, PROFILE, MIDDLEWARE = (
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "RMW_IMPLEMENTATION",
)
LOOPBACK = Path(__file__).resolve().with_name("loopback.xml")
ENCLAVE = "/quadftc"  # below it each node has its keys, by the policy in quadftc_bringup
BY_PROFILE = "SYSTEM_DEFAULT"  # the range with which Fast DDS goes by its profile alone
LISTENS = "0A"  # state of a TCP socket in /proc/net/tcp


def stay_local(environment: MutableMapping[str, str] = os.environ) -> None:
    """Keep to this machine, unless a range is set."""
    asked = environment.get(RANGE) and not is_bound(environment)
    if environment.get(PROFILE) == str(LOOPBACK):
        del environment[PROFILE]  # of a shell that env.sh has set up, and that may ask for more since
    if asked:
        return
    fast = (environment.get(MIDDLEWARE) or "rmw_fastrtps_cpp").startswith("rmw_fastrtps")
    if fast and not environment.get(PROFILE) and LOOPBACK.is_file():
        environment[RANGE], environment[PROFILE] = BY_PROFILE, str(LOOPBACK)
    else:  # another middleware, or a profile of the user's own
        environment[RANGE] = "LOCALHOST"


def open_to_network(environment: MutableMapping[str, str] = os.environ) -> None:
    """Be found by other machines."""
    environment[RANGE] = "SUBNET"
    if environment.get(PROFILE) == str(LOOPBACK):
        del environment[PROFILE]


def is_bound(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Whether Fast DDS goes by the profile of the loopback."""
    return environment.get(RANGE) == BY_PROFILE and environment.get(PROFILE) == str(LOOPBACK)


def is_enforced(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Whether nodes start with their keys only (SROS2)."""
    enabled = environment.get("ROS_SECURITY_ENABLE") == "true"
    return enabled and environment.get("ROS_SECURITY_STRATEGY") == "Enforce"


def enclave_arguments(name: str) -> list[str]:
    """Return the ROS arguments by which a process finds its keys; none without SROS2."""
    return ["--enclave", f"{ENCLAVE}/{name}"] if is_enforced() else []


def reach(environment: MutableMapping[str, str] = os.environ) -> str:
    """Say who can find nodes, by what ROS 2 goes by."""
    found = environment.get(RANGE) or "SUBNET"
    if is_bound(environment):
        found = "this machine only, sockets on 127.0.0.1"
    words = {"LOCALHOST": "this machine only", "SUBNET": "this machine and its network"}
    secured = "enforced" if is_enforced(environment) else "off"
    domain = environment.get("ROS_DOMAIN_ID") or 0
    return f"ROS domain {domain}, found by {words.get(found, found)}; SROS2 {secured}"


def open_sockets(process: int | str = "self") -> list[str]:
    """Return the sockets of a process that others than this machine can reach, such as 'udp 0.0.0.0:5501'.

    TCP sockets that listen, and UDP sockets that are bound to more than loopback and have no peer.
    """
    inodes, folder = set[str](), Path("/proc", str(process))
    with contextlib.suppress(OSError):
        for link in (folder / "fd").iterdir():
            with contextlib.suppress(OSError):
                if found := re.fullmatch(r"socket:\[(\d+)\]", str(link.readlink())):
                    inodes.add(found[1])
    opened: list[str] = []
    for table in ("tcp", "tcp6", "udp", "udp6"):
        with contextlib.suppress(OSError):
            for line in (folder / "net" / table).read_text().splitlines()[1:]:
                words = line.split()
                local, peer, state, inode = words[1], words[2], words[3], words[9]
                address, port = _address(local)
                is_open = state == LISTENS if table.startswith("tcp") else peer.endswith(":0000")
                if inode in inodes and is_open and not address.startswith(("127.", "::1")):
                    opened.append(f"{table} {address}:{port}")
    return sorted(opened)


def _address(text: str) -> tuple[str, int]:
    """Return address and port of an entry of /proc/net, words of 32 bits in the machine's byte order."""
    digits, _, port = text.partition(":")
    raw = b"".join(bytes.fromhex(digits[at : at + 8])[::-1] for at in range(0, len(digits), 8))
    family = socket.AF_INET if len(raw) == 4 else socket.AF_INET6
    return socket.inet_ntop(family, raw), int(port, 16)
