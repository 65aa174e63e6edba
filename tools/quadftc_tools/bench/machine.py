"""What a benchmark ran on, and what it took of it."""

from __future__ import annotations

import os
import platform
import re
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import psutil

from quadftc_ros.versions import versions

Result = dict[str, Any]  # of a benchmark, as its JSON file holds it

MEBIBYTE = 2**20


def machine() -> Result:
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
        self._before = {name: _used(process) for name, process in self._processes.items()}

    def taken(self, wall_time: float) -> dict[str, dict[str, float]]:
        """Return, by process, what it took in a time [s].

        ``cpu_share`` of a core, ``memory_mib`` now, ``memory_growth_mib``.
        """
        found: dict[str, dict[str, float]] = {}
        for name, process in self._processes.items():
            (before, memory_before), (busy, memory) = self._before[name], _used(process)
            found[name] = {
                "cpu_share": round((busy - before) / wall_time, 3),
                "memory_mib": round(memory / MEBIBYTE, 1),
                "memory_growth_mib": round((memory - memory_before) / MEBIBYTE, 2),
            }
        return found


def _used(process: psutil.Process) -> tuple[float, int]:
    """Processor time [s] and resident memory [bytes]."""
    times = process.cpu_times()
    return times.user + times.system, process.memory_info().rss


def _processor() -> str:
    models = re.findall(
        r"^model name\s*: (.*)$", Path("/proc/cpuinfo").read_text(encoding="utf-8"), re.MULTILINE
    )
    return models[0] if models else platform.processor() or "unknown"
