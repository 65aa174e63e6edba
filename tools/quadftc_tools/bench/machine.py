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
    """How many times longer than at best a fixed calculation takes: 1 on a machine that others leave alone.

    Returns
    -------
    dict
        ``p50`` and ``p90``.
    """
    times: list[float] = []
    for _ in range(count):
        begin = time.perf_counter()
        sum(index * index for index in range(5000))
        times.append(time.perf_counter() - begin)
    times.sort()
    return {f"p{level}": round(times[count * level // 100] / times[0], 2) for level in (50, 90)}


class Usage:
    """Processor time and memory of some processes, from construction to `taken`.

    Parameters
    ----------
    processes : mapping of str to int
        Names and process ids.
    """

    def __init__(self, processes: Mapping[str, int]) -> None:
        self._processes = {name: psutil.Process(pid) for name, pid in processes.items()}
        self._before = {name: _threads(process) for name, process in self._processes.items()}
        self._memory = {name: process.memory_info().rss for name, process in self._processes.items()}

    def taken(self, wall_time: float) -> dict[str, Any]:
        """Return what was taken in a time [s].

        Returns
        -------
        dict
            By process: ``cpu_share`` of a core by thread (those above 0.1 %), ``memory_mib`` now, and
            ``memory_growth_mib``.
        """
        found: dict[str, Any] = {}
        for name, process in self._processes.items():
            before = self._before[name]
            shares = {
                thread: (used - before.get(thread, 0.0)) / wall_time
                for thread, used in _threads(process).items()
            }
            memory = process.memory_info().rss
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
        name = MAIN if thread.id == process.pid else _thread_name(process.pid, thread.id)
        found[name] = found.get(name, 0.0) + thread.user_time + thread.system_time
    return found


def _thread_name(pid: int, thread: int) -> str:
    try:
        return Path(f"/proc/{pid}/task/{thread}/comm").read_text(encoding="utf-8").strip()
    except OSError:
        return "ended"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or "unknown"
