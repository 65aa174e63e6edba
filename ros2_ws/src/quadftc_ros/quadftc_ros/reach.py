"""Who can reach the nodes of this process: what the environment says to the middleware, before ROS starts.

By default Fast DDS is bound to the loopback (`loopback.xml`); another middleware looks for nodes of this
machine only. scripts/lib/env.sh sets the same. Whoever sets ROS_AUTOMATIC_DISCOVERY_RANGE has his way.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, MutableMapping
from pathlib import Path

RANGE, PROFILE, MIDDLEWARE = (
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "RMW_IMPLEMENTATION",
)
LOOPBACK = Path(__file__).resolve().with_name("loopback.xml")
ENCLAVE = "/quadftc"  # below it each node has its keys, by the policy in quadftc_bringup
BY_PROFILE = "SYSTEM_DEFAULT"  # the range with which Fast DDS goes by its profile alone


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


def open_addresses(process: int | str = "self") -> set[str]:
    """Return the local addresses to which UDP sockets of a process are bound; OSError where /proc is not."""
    files = Path(f"/proc/{process}/fd")
    sockets = {link for file in files.iterdir() if (link := _target(file)).startswith("socket:")}
    rows = (line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:])
    return {_address(row[1]) for row in rows if f"socket:[{row[9]}]" in sockets}


def outside(addresses: Iterable[str]) -> list[str]:
    """Return the addresses that are not on the loopback."""
    return sorted(address for address in addresses if not address.startswith("127."))


def _target(file: Path) -> str:
    try:
        return str(file.readlink())
    except OSError:  # closed meanwhile
        return ""


def _address(place: str) -> str:
    """Return the address of a hexadecimal ``ADDRESS:PORT``, least byte first."""
    return ".".join(str(byte) for byte in bytes.fromhex(place.partition(":")[0])[::-1])
