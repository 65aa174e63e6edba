"""What all tests share: a ROS domain of their own, on this machine only, and a bench for nodes."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import pytest
from hypothesis import settings

# property tests: the same examples in every run, and no time limit for one
settings.register_profile("quadftc", derandomize=True, database=None, deadline=None)
settings.load_profile("quadftc")

DOMAINS = range(1, 81)  # those that ROS 2 can have on any Linux, less a few that tests name themselves


def _own_domain() -> IO[str]:
    """Claim a ROS domain that no other test session on this machine has, as long as the file is open."""
    for domain in DOMAINS:
        file = Path(tempfile.gettempdir(), f"quadftc_test_domain_{domain}.lock").open("w")  # noqa: SIM115
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            file.close()
            continue
        os.environ["ROS_DOMAIN_ID"] = str(domain)
        return file
    raise RuntimeError("no ROS domain is free: too many test sessions at a time")


def pytest_configure(config: pytest.Config) -> None:
    """Before anything of ROS is imported; in every worker of pytest-xdist, too."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    config.stash[DOMAIN_LOCK] = _own_domain()


DOMAIN_LOCK = pytest.StashKey[IO[str]]()


@pytest.fixture
def bench() -> Iterator[Any]:
    """A bench for nodes in real time, see `quadftc_ros.testing`."""
    from quadftc_ros.testing import NodeBench

    with NodeBench("realtime") as made:
        yield made


@pytest.fixture
def lockstep_bench() -> Iterator[Any]:
    """A bench for nodes in lock-step."""
    from quadftc_ros.testing import NodeBench

    with NodeBench("lockstep") as made:
        yield made
