"""What a latency benchmark prints: stages, what became of the messages, what it took."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median_high
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

SHOWN = ("p50", "p90", "p99", "p99.9", "max")


def latency_table(results: Sequence[Mapping[str, Any]]) -> Table:
    """Stages of one rate; of several runs, the medians."""
    first = results[0]
    what = f"{first['graph']}, {first['executor']}" if first["graph"] == "composed" else first["graph"]
    table = Table(
        "stage", box=SIMPLE_HEAD, title=f"{first['rate']:g} Hz, {what}, {first['observer']}: latency [us]"
    )
    for name in SHOWN:
        table.add_column(name, justify="right")
    for stage in first["stages"]:
        rows = [item["stages"][stage] for item in results if stage in item["stages"]]
        table.add_row(stage, *(f"{median_high([row[name] for row in rows]):.0f}" for name in SHOWN))
    return table


def counts_line(result: Mapping[str, Any]) -> str:
    """What became of the samples and messages of one run."""
    words = f"{result['samples']} samples, {result['missed']} missed, {result['late']} late"
    words += f"; {sum(result['lost'].values())} messages lost"
    if (recorded := result.get("recorded")) is not None:
        words += (
            f"; {recorded['stored']} recorded, {recorded['dropped']} dropped, {recorded['missing']} missing"
        )
    return words


def usage_line(results: Sequence[Mapping[str, Any]]) -> str:
    """Processor time by process and thread, and memory; medians of the runs."""
    words: list[str] = []
    for name, used in results[0]["usage"].items():
        runs = [result["usage"][name] for result in results]
        shares = {
            thread: median_high([run["cpu_share"].get(thread, 0.0) for run in runs])
            for thread in used["cpu_share"]
        }
        threads = ", ".join(
            f"{thread} {100.0 * share:.0f} %" for thread, share in shares.items() if share > 5e-3
        )
        words.append(f"{name}: {threads}; {median_high([run['memory_mib'] for run in runs]):.0f} MiB")
    return "processor time and memory: " + " | ".join(words)
