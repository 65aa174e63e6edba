"""What a killed node leaves in shared memory goes; what a living one holds stays, however old it looks."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from quadftc_ros.leftovers import FILE, MEMORY, MIN_AGE, find_leftovers, remove_leftovers

NODE = "import rclpy; rclpy.init(); node = rclpy.create_node('held'); print(flush=True); input()"
pytestmark = pytest.mark.skipif(not MEMORY.is_dir(), reason="no /dev/shm")


def start_node() -> subprocess.Popen[bytes]:
    """Start a node that meets no other: who meets one maps its memory, which then stays."""
    alone = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}
    alone.pop("FASTRTPS_DEFAULT_PROFILES_FILE", None)
    return subprocess.Popen([sys.executable, "-c", NODE], env=alone, stdin=-1, stdout=-1)


def locked_by(process: subprocess.Popen[bytes]) -> set[str]:
    """Names of the segments and ports that a process holds; their files are made to look old.

    Ports below 7400 are left out. All domains share them, and the node of another test may take a free one.
    """
    files = [each.readlink() for each in Path(f"/proc/{process.pid}/fd").iterdir()]
    names = {match[1] for file in files if (match := FILE.fullmatch(file.name))}
    names = {name for name in names if not re.fullmatch("fastrtps_port7[0-3]..", name)}
    for name in names:
        for path in MEMORY.glob(f"*{name}*"):
            os.utime(path, (0, 0))
    return names


def test_leftovers_of_a_killed_node_go_and_those_of_a_living_one_stay():
    with start_node() as dead, start_node() as living:
        try:
            for each in (dead, living):
                each.stdout.readline()
            left, held = locked_by(dead), locked_by(living)
            assert len(left) >= 2  # a segment, a port
            assert held
            dead.kill()
            dead.wait()
            assert left <= set(find_leftovers())
            assert remove_leftovers() >= len(left)
            assert [path for name in left for path in MEMORY.glob(f"*{name}*")] == []
            assert all((MEMORY / f"{name}{suffix}").exists() for name in held for suffix in ("", "_el"))
        finally:
            dead.kill()
            living.kill()


def test_leftover_that_is_young_or_locked_stays():
    path = MEMORY / "fastrtps_00000000feedbeef"
    lock = path.with_name(f"{path.name}_el")
    try:
        path.touch()
        assert path.name not in find_leftovers(), f"younger than {MIN_AGE} s"
        lock.touch()
        for each in (path, lock):
            os.utime(each, (0, 0))
        with subprocess.Popen(["flock", lock, "sh", "-c", "echo; read x"], stdin=-1, stdout=-1) as holder:
            holder.stdout.readline()
            remove_leftovers()
            assert path.exists()
            holder.communicate(b"\n")
        remove_leftovers()
        assert not path.exists()
        assert not lock.exists()
    finally:
        path.unlink(missing_ok=True)
        lock.unlink(missing_ok=True)
