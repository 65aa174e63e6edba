"""What a benchmark ran on, and what it took of it."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import psutil

from quadftc_ros.versions import versions

MEBIBYTE = 2**20
MAIN = "main"  # name of the thread that a process began with


def machine() -> dict[str, Any]:
    """Describe processor, memory, system, versions, and how busy the machine is."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "usable_cores": len(os.sched_getaffinity(0)),
        "memory_mib": psutil.virtual_memory().total // MEBIBYTE,
        "system": platform.platform(),
        "load_average": list(os.getloadavg()),
        "slowness": slowness(),
        "versions": versions(),
    }


def slowness(count: int = 300) -> dict[str, float]:
    """How many times longer than at best a calculation takes (``p50``, ``p90``): 1 on a quiet machine."""
    times: list[float] = []
    for _ in range(count):
        begin = time.perf_counter()
        sum(index * index for index in range(5000))
        times.append(time.perf_counter() - begin)
    times.sort()
    return {f"p{level}": round(times[count * level // 100] / times[0], 2) for level in (50, 90)}


class Usage:
    """Processor time and memory of processes, by name and id, from construction to `taken`."""

    def __init__(self, processes: Mapping[str, int]) -> None:
        self._processes = {name: psutil.Process(pid) for name, pid in processes.items()}
        self._before = {name: _threads(process) for name, process in self._processes.items()}
        self._memory = {name: process.memory_info().rss for name, process in self._processes.items()}

    def taken(self, wall_time: float) -> dict[str, Any]:
        """Return, by process, what it took in a time [s].

        ``cpu_share`` of a core by thread (those above 0.1 %), ``memory_mib`` now, ``memory_growth_mib``.
        """
        found: dict[str, Any] = {}
        for name, process in self._processes.items():
            before, now, memory = self._before[name], _threads(process), process.memory_info().rss
            shares = {each: (used - before.get(each, 0.0)) / wall_time for each, used in now.items()}
            found[name] = {
                "cpu_share": {key: round(value, 3) for key, value in shares.items() if value > 1e-3},
                "memory_mib": round(memory / MEBIBYTE, 1),
                "memory_growth_mib": round((memory - self._memory[name]) / MEBIBYTE, 2),
            }
        return found


def _threads(process: psutil.Process) -> dict[str, float]:
    """Processor time [s] by thread."""
    found: dict[str, float] = {}
    for thread in process.threads():
        comm = Path(f"/proc/{process.pid}/task/{thread.id}/comm")
        name = MAIN if thread.id == process.pid else _read(comm).strip() or "ended"
        found[name] = found.get(name, 0.0) + thread.user_time + thread.system_time
    return found


def _processor() -> str:
    lines = _read(Path("/proc/cpuinfo")).splitlines()
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or "unknown"


def _read(path: Path) -> str:
    """Text of a file; empty if there is none."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""
